"""Benchmark cases on a CUDA device."""

from collections.abc import Callable
from functools import partial

import torch

from meshfit.config.loading import load_experiment
from meshfit.experiment.source import build_source
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from tests.benchmarks.timing import Benchmark
from tests.fits import fit

_NAMES = ("bunny", "cow", "bone", "airplane")


def _target(name: str) -> Mesh:
    mesh = load_target(name)
    return frame_of(mesh.verts, "tutorial").normalise(mesh)


def _engine(members: int, device: str = "cuda") -> FirstOrder:
    source, targets = subdivide(icosahedron(), "loop", 4), [_target(name) for name in _NAMES]
    problems = [Problem(source, targets[seed % len(targets)], seed) for seed in range(members)]
    engine = FirstOrder(problems, FirstOrderSettings(samples=5000), torch.device(device), torch.float32)
    for _ in range(10):
        engine.step()
    return engine


def _step() -> Benchmark:
    eager = _engine(1)
    eager._evaluate = eager._evaluate_eagerly
    return Benchmark(
        _engine(1).step, 30, eager.step, "without a CUDA graph", target=1, clock="wall", limit=0.001, calls=10
    )


def _batch() -> Benchmark:
    return Benchmark(
        _engine(64).step, 10, _engine(1).step, "one problem", "growth", 8, clock="wall", calls=2, other_calls=10
    )


def _accurate() -> Benchmark:
    settings = load_experiment("accurate").settings
    source = build_source(settings.source, "loop")
    one = partial(fit, source, _target("bunny"), settings.fit, scheme="loop")
    return Benchmark(partial(one, device="cuda"), 3, partial(one, device="cpu"), "on the CPU", clock="wall")


CUDA_CASES: dict[str, Callable[[], Benchmark]] = {
    "CUDA: step, 2,562 verts, 5,000 samples": _step,
    "CUDA: step of 64 problems in one batch": _batch,
    "CUDA: an accurate fit of the bunny": _accurate,
}
