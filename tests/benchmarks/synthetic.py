"""Run directories of many complete trials without a fit, written as runs write them, to time commands on.

    python -m tests.benchmarks.synthetic DIR --trials 500

makes one: the trials of a sweep, each with a plausible trace, meshes of 80 faces and measurements with random changes.
"""

import argparse
import dataclasses
import math
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from meshfit.config.loading import Experiment, load_experiment
from meshfit.config.strict_yaml import dump
from meshfit.experiment.plan import Trial, plan
from meshfit.experiment.storage.frame import frame_record
from meshfit.experiment.storage.plan_file import write_plan
from meshfit.experiment.storage.result import result_record
from meshfit.experiment.storage.run_directory import (
    CONFIG,
    LOCK,
    RESULT,
    TIMES,
    TRACE,
    Result,
    RunDirectory,
    json_text,
    make_folder,
)
from meshfit.experiment.storage.targets import carried_path, carry
from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Trace
from meshfit.measuring.measure import Measurement, measure
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.io.files import encode_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, frame_of
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide

_TARGETS = ("bunny", "mousehead", "cow", "bone", "airplane")
_SCHEMES = ("midpoint", "loop", "interp-loop", "butterfly", "modified-butterfly", "sqrt3")
_SEEDS = 5
_STEPS = 2000
_TRACED_EVERY = 10
_WORK: Result = {
    "source": {"verts": 42, "faces": 80, "area": 11.7},
    "seconds": {"prepare": 0.123456789, "fit": 12.3456789, "measure": 1.23456789},
    "peak_memory_mb": 421.904384,
    "warnings": [],
    "shortfalls": [],
    "verdict": {
        "sound": True,
        "checks": [
            {"name": name, "passed": True, "value": 0.987654321, "threshold": 2.0, "text": ""}
            for name in ("coverage", "vertices", "size", "place", "progress")
        ],
    },
}


def write_runs(root: Path, trials: int = 3000, *, apart: bool = False) -> None:
    """Write a run directory of some trials, a multiple of 150: five targets, six schemes and five seeds of a sweep.

    If they are `apart`, each trial has a target of its own, an ellipsoid.
    """
    generator = np.random.default_rng(0)
    planned = plan([_apart(root.parent / f"{root.name}-targets", trials, generator) if apart else _experiment(trials)])
    store = RunDirectory(root)
    write_plan(planned, store, workers=2)
    for trial in planned:
        _write_trial(trial, store, generator)


def _experiment(trials: int) -> Experiment:
    points = math.ceil(trials / (len(_TARGETS) * len(_SCHEMES) * _SEEDS))
    weights = [round(0.1 * 1.05**power, 6) for power in range(points)]
    changes = {
        "targets": f"[{', '.join(_TARGETS)}]",
        "schemes": f"[{', '.join(_SCHEMES)}]",
        "seeds": str(list(range(_SEEDS))),
        "source.levels": "1",
        "fit.steps": str(_STEPS),
        "sweep.fit.losses.edge": str(weights),
    }
    return load_experiment("tutorial", [f"{key}={value}" for key, value in changes.items()])


def _apart(folder: Path, trials: int, generator: np.random.Generator) -> Experiment:
    make_folder(folder)
    sphere = subdivide(icosahedron(), "loop", 1)
    paths = [folder / f"shape-{number}.ply" for number in range(trials)]
    for path in paths:
        verts = sphere.verts * generator.uniform(0.5, 1.5, 3)
        path.write_bytes(encode_mesh(Mesh(verts, sphere.faces), ".ply"))
    changes = {"targets": f"[{', '.join(map(str, paths))}]", "schemes": "[loop]", "source.levels": "1"}
    return load_experiment("tutorial", [f"{key}={value}" for key, value in changes.items()])


def _write_trial(trial: Trial, store: RunDirectory, generator: np.random.Generator) -> None:
    frame, fitted, measured, encoded = _fit_to(trial.target)
    carry(carried_path(trial, store), lambda: load_target(trial.target))
    fitted = dataclasses.replace(fitted, trace=_trace(generator))
    record = frame_record(frame, trial.settings.normalise, trial.settings.write_frame)
    result = result_record(trial, record, fitted, _varied(measured, generator), _WORK)
    make_folder(store.folder(trial))
    (store.folder(trial) / LOCK).touch()
    files = {CONFIG: dump(trial.config), TRACE: fitted.trace.to_csv(), TIMES: fitted.trace.times_to_csv()}
    files |= {RESULT: json_text(result)}
    for name, content in (files | encoded).items():
        store.write(trial, name, content, lasting=False)


@cache
def _fit_to(target: str) -> tuple[Frame, FitResult, Measurement, dict[str, Any]]:
    """A sphere in place of a fit to a target, its measurements, and its files."""
    mesh = load_target(target)
    frame = frame_of(mesh.verts, "tutorial")
    placed = frame.normalise(mesh)
    sphere = subdivide(icosahedron(), "loop", 1)
    shrunk = Mesh(0.5 * sphere.verts, sphere.faces)
    measured = measure(shrunk, placed, MeasureSettings(samples=1000, points=1000))
    encoded = {"source.ply": encode_mesh(sphere, ".ply"), "result.ply": encode_mesh(shrunk, ".ply")}
    return frame, FitResult(shrunk, Trace(), "cpu"), measured, encoded


def _trace(generator: np.random.Generator) -> Trace:
    """A trace whose terms fall to a tenth."""
    trace = Trace()
    steps = range(0, _STEPS + 1, _TRACED_EVERY)
    for step in steps:
        fall = 0.1 + 0.9 * math.exp(-5 * step / _STEPS)
        terms = {name: fall * float(generator.uniform(0.9, 1.1)) for name in trace.columns[2:-1]}
        trace.append(step, sum(terms.values()), terms, 1.0)
        trace.seconds.append(step / 100)
    return trace


def _varied(record: Any, generator: np.random.Generator) -> Any:
    """Change every number of a measurement that has decimals by up to a tenth."""
    if isinstance(record, float):
        return record * float(generator.uniform(0.9, 1.0))
    if isinstance(record, Measurement) or (dataclasses.is_dataclass(record) and not isinstance(record, type)):
        parts = {field.name: getattr(record, field.name) for field in dataclasses.fields(cast("Any", record))}
        return dataclasses.replace(record, **{name: _varied(part, generator) for name, part in parts.items()})
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("root", type=Path, help="the run directory to write")
    parser.add_argument("--trials", type=int, default=3000)
    parser.add_argument("--apart", action="store_true", help="a target for each trial")
    options = parser.parse_args()
    write_runs(options.root, options.trials, apart=options.apart)


if __name__ == "__main__":
    main()
