"""Benchmark cases: one function per line of the table, each called in its own process."""

import itertools
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
import trimesh

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import Trial, plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.nearest_neighbours import match_nearest
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.measuring.measure import measure
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.normalisation import frame_of
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from tests.benchmarks.cuda_cases import CUDA_CASES
from tests.benchmarks.fit_cases import FIT_CASES
from tests.benchmarks.loading_cases import LOADING_CASES
from tests.benchmarks.plain_twin import PlainTwin
from tests.benchmarks.timing import Benchmark
from tests.fits import fit

_STEPS_UNTIL_NEAR = 300


def _subdivision(scheme: str, mesh: Callable[[], Mesh], levels: int, repeat: int) -> Benchmark:
    verts, faces = mesh().verts, mesh().faces
    twin = partial(trimesh.remesh.subdivide_loop, verts, faces, iterations=levels)
    ours = partial(subdivide, mesh(), scheme, levels)
    return Benchmark(ours, repeat, twin, "trimesh subdivide_loop", target=1)


def _bunny() -> Mesh:
    mesh = load_target("bunny")
    return frame_of(mesh.verts, "tutorial").normalise(mesh)


def _engine(levels: int = 4, samples: int = 5000, steps: int = _STEPS_UNTIL_NEAR) -> FirstOrder:
    """The tutorial's fit, after so many steps."""
    problem = Problem(subdivide(icosahedron(), "loop", levels), _bunny())
    engine = FirstOrder([problem], FirstOrderSettings(samples=samples), torch.device("cpu"), torch.float32)
    for _ in range(steps):
        engine.step()
    return engine


def _step(steps: int) -> Benchmark:
    engine = _engine(steps=steps)
    twin = PlainTwin(engine.problems[0], engine.settings, torch.float32)
    with torch.no_grad():
        twin.offsets.copy_(torch.tensor(engine.mesh(0).verts) - twin.start)
    # Ten in a row, as they are in a fit; one after a step of the twin would find none of its numbers in the cache.
    name = "plain torch loop, brute force"
    return Benchmark(engine.step, 20, twin.step, name, target=20, limit=0.010, calls=10)


def _floor() -> Benchmark:
    """The nearest points of a step alone, of other samples each time: what is left if all else took no time."""
    engine = _engine()
    states = itertools.cycle([engine._evaluate_eagerly().state for _ in range(40)])

    def nearest() -> None:
        state = next(states)
        match_nearest(state.source.points, state.target.points)

    return Benchmark(nearest, 80)


def _growth(target: int, *, levels: int = 4, samples: int = 5000) -> Benchmark:
    base, larger = _engine(), _engine(levels, samples)
    name = "2,562 verts, 5,000 samples"
    return Benchmark(larger.step, 20, base.step, name, "growth", target, calls=5, other_calls=10)


def _batch() -> Benchmark:
    source, target = subdivide(icosahedron(), "loop", 2), decimate(_bunny(), 2000)
    problems = [Problem(source, target, seed) for seed in range(16)]
    options = {"steps": 50, "samples": 500, "device": "cpu"}

    def one_by_one() -> None:
        for problem in problems:
            fit(problem.source, problem.target, seed=problem.seed, **options)

    return Benchmark(partial(fit_batch, problems, **options), 5, one_by_one, "one after the other", target=1)


def _trials(*overrides: str) -> list[Trial]:
    return plan([load_experiment("tutorial", ["targets=[bunny]", "schemes=[loop]", "device=cpu", *overrides])])


def _side_by_side() -> Benchmark:
    trials = _trials("seeds=[0,1,2,3,4,5,6,7]", "jobs=2")
    folders = itertools.count()
    root = tempfile.TemporaryDirectory()
    bytes_of: set[bytes] = set()

    def workers() -> None:
        store = RunDirectory(Path(root.name, str(next(folders))))
        run_trials(trials, store)
        _note(store)

    def one_process() -> None:
        store = RunDirectory(Path(root.name, str(next(folders))))
        for trial in trials:
            run_batch([trial], store, lambda *_: None)
        _note(store)

    def _note(store: RunDirectory) -> None:
        names = ("result.ply", "trace.csv")
        bytes_of.add(b"".join((store.folder(trial) / name).read_bytes() for trial in trials for name in names))
        if len(bytes_of) > 1:
            raise AssertionError("the same trials left other bytes")

    return Benchmark(workers, 1, one_process, "one after the other", target=1.8, clock="wall", memory_limit_mb=600)


def _overhead() -> Benchmark:
    (trial,) = _trials("fit.steps=0")
    root = tempfile.TemporaryDirectory()
    store = RunDirectory(Path(root.name))
    return Benchmark(lambda: run_batch([trial], store, lambda *_: None, force=True), 3, limit=5)


CASES: dict[str, Callable[[], Benchmark]] = (
    {
        "loop: icosahedron, 5 levels": lambda: _subdivision("loop", icosahedron, 5, 15),
        "interp-loop: icosahedron, 5 levels": lambda: _subdivision("interp-loop", icosahedron, 5, 15),
        "loop: bunny, 2 levels": lambda: _subdivision("loop", lambda: load_target("bunny"), 2, 5),
        "interp-loop: bunny, 2 levels": lambda: _subdivision("interp-loop", lambda: load_target("bunny"), 2, 5),
        "step, 2,562 verts, 5,000 samples: far from the target": lambda: _step(0),
        "step, 2,562 verts, 5,000 samples: near the target": lambda: _step(_STEPS_UNTIL_NEAR),
        "of such a step, the nearest points": _floor,
        "step, 50,000 samples": lambda: _growth(12, samples=50_000),
        "step, 40,962 verts": lambda: _growth(6, levels=6),
        "16 small fits in one batch": _batch,
        "8 trials of the tutorial on 2 workers": _side_by_side,
        "a trial on the bunny but for its steps": _overhead,
        "measure 10,002 verts against the bunny": lambda: Benchmark(
            partial(measure, decimate(_bunny(), 20_000), _bunny()), 3
        ),
    }
    | FIT_CASES
    | LOADING_CASES
)
if torch.cuda.is_available():
    CASES |= CUDA_CASES
