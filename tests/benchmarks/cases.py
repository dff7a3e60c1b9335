"""What is benchmarked."""

from collections.abc import Iterator
from functools import partial

import torch
import trimesh

from meshfit.fitting.first_order import FirstOrder, Problem
from meshfit.fitting.settings import FitSettings
from meshfit.measuring.measure import measure
from meshfit.mesh.frames import frame_of
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from tests.benchmarks.plain_twin import PlainTwin
from tests.benchmarks.timing import Benchmark


def cases() -> Iterator[Benchmark]:
    """Every benchmark, made when its turn comes."""
    bunny = load_target("bunny")
    yield from _subdivision("icosahedron, 5 levels", icosahedron(), 5, repeat=15)
    yield from _subdivision("bunny, 2 levels", bunny, 2, repeat=5)
    target = frame_of(bunny.verts, "tutorial").normalise(bunny)
    yield _step(target)
    result = decimate(target, 20_000)
    yield Benchmark("measure, 10,002 verts against the bunny", partial(measure, result, target), repeat=3)


def _subdivision(name: str, mesh: Mesh, levels: int, repeat: int) -> Iterator[Benchmark]:
    twin = partial(trimesh.remesh.subdivide_loop, mesh.verts, mesh.faces, iterations=levels)
    for scheme in ("loop", "interp-loop"):
        ours = partial(subdivide, mesh, scheme, levels)
        yield Benchmark(f"{scheme}: {name}", ours, repeat, twin, "trimesh subdivide_loop", target=1.0)


def _step(target: Mesh) -> Benchmark:
    source = subdivide(icosahedron(), "loop", 4)
    problem = Problem(source, target, FitSettings(), 0, torch.device("cpu"), torch.float32)
    engine, twin = FirstOrder(problem), PlainTwin(problem)
    name = "one step at the tutorial's setting, one thread"
    return Benchmark(name, engine.step, 20, twin.step, "plain torch loop, brute force", target=20.0)
