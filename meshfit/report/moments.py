"""The moments of a fit that snapshots have kept: the source, the surface step by step, and the result."""

import csv
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.snapshots import snapshots_in
from meshfit.experiment.store import Result
from meshfit.fitting.gauss_newton.stages import stage_at
from meshfit.fitting.settings import METHODS, GaussNewtonSettings
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.report.trial_meshes import TrialMeshes, trial_meshes
from meshfit.settings import build

_METRIC = "hausdorff.symmetric"


@dataclass(frozen=True)
class Moment:
    """The surface at one moment, and what is said of it."""

    mesh: Mesh
    said: str


@dataclass(frozen=True)
class Course:
    """A fit from its source to its result.

    Attributes:
        target: what it aimed at.
        moments: the source, the snapshots, and the result, in the target's normalised frame.
    """

    target: Mesh
    moments: tuple[Moment, ...]

    @property
    def changes_faces(self) -> bool:
        """Whether the connectivity changes on the way."""
        return len({moment.mesh.num_faces for moment in self.moments}) > 1


def course_of(folder: Path) -> Course:
    """Read the course of a complete trial; a surface that did not move is told of once.

    Raises:
        StoreError: a file cannot be read.
        MeshError: a mesh cannot be read, or the target is no longer there.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)  # of meshes that meshfit wrote itself
        meshes = trial_meshes(folder)
        said = _words(meshes.facts, folder)
        found = [Moment(mesh, said(step, mesh)) for step, mesh in _surfaces(meshes, folder)]
    moved = [found[0], *(now for before, now in pairwise(found) if not _same(before, now))]
    return Course(meshes.target, (*moved, Moment(meshes.result, _end(meshes.facts, meshes.result))))


def _surfaces(meshes: TrialMeshes, folder: Path) -> Iterator[tuple[int, Mesh]]:
    """The source, and each snapshot with the number of steps before it."""
    yield 0, meshes.source
    own = meshes.facts["settings"]["write_frame"] == "target"
    for step, path in snapshots_in(folder).items():
        mesh = load_mesh(path)
        yield step, meshes.frame.normalise(mesh) if own else mesh


def _same(before: Moment, now: Moment) -> bool:
    first, second = before.mesh, now.mesh
    return first.verts.tobytes() == second.verts.tobytes() and first.faces.tobytes() == second.faces.tobytes()


def _words(facts: Result, folder: Path) -> Callable[[int, Mesh], str]:
    """What is said of a surface: step, figure and verts; with several stages, the one that the step was a part of."""
    plain = facts["settings"]["fit"]
    settings = build(METHODS[plain.get("method", "first-order")], plain)
    name, values = _trace(folder)

    def said(step: int, mesh: Mesh) -> str:
        at = max((row for row in values if row <= step), default=None)
        stage = stage_at(settings, step - 1).name if isinstance(settings, GaussNewtonSettings) and step else ""
        where = f"step {step} of {settings.steps}" if step else "source"
        return _joined([stage, where, "" if at is None else f"{name} {values[at]:.2g}", f"{mesh.num_verts:,} verts"])

    return said


def _end(facts: Result, mesh: Mesh) -> str:
    group, _, key = _METRIC.partition(".")
    return _joined(["result", f"{METRICS[_METRIC].title} {facts[group][key]:.4g}", f"{mesh.num_verts:,} verts"])


def _joined(parts: Sequence[str]) -> str:
    return "  ·  ".join(filter(None, parts))


def _trace(folder: Path) -> tuple[str, Mapping[int, float]]:
    """What falls, by its name, and its value before each step that was traced."""
    path = folder / "trace.csv"
    try:
        head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        return head[1], {int(row[0]): float(row[1]) for row in rows}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, IndexError) as error:
        raise StoreError(f"{path}: not a trace: {error}; run the trial again with --force") from None
