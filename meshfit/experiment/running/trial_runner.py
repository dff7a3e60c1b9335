"""How much memory a process has taken."""

import platform
import time
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

from meshfit.config.strict_yaml import dump
from meshfit.errors import MeshError, MeshfitWarning
from meshfit.experiment.plan import Trial
from meshfit.experiment.source import build_source, relocated, source_files
from meshfit.experiment.storage.checkpoint import (
    keep_snapshots,
    read_checkpoint,
    steps_before,
    write_checkpoint,
    write_snapshot,
)
from meshfit.experiment.storage.failure import LAST_GOOD, failed_attempts, failure_of
from meshfit.experiment.storage.result import result_of
from meshfit.experiment.storage.run_directory import CHECKPOINT, FAILURE, RESULT, RunDirectory, write_json
from meshfit.experiment.storage.trial_log import Journal
from meshfit.experiment.trial_status import Outcome, Phase, Progress
from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.measuring.measure import measure
from meshfit.mesh.alignment import align, boxes_are_disjoint
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.io.files import encode_mesh
from meshfit.mesh.manifold import describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, Normalisation, frame_of
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.targets import file_sha256, load_target, target_path
from meshfit.mesh.topology import Topology


def peak_memory_mb(*, of_children: bool = False) -> float | None:
    """The most memory that this process has held so far, in MB; None where the system does not tell.

    Args:
        of_children: that of the largest child that has ended, in its place; 0 where there was none.
    """
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if platform.system() == "Darwin" else 1024
    whose = resource.RUSAGE_CHILDREN if of_children else resource.RUSAGE_SELF
    return resource.getrusage(whose).ru_maxrss * unit / 1e6


class Attempt:
    """A trial on its way: `start`, `prepare`, a fit, `finish`; or at any time after the start `fail` or `stop`.

    Attributes:
        outcome: how it ended; None while it has not.
    """

    def __init__(self, trial: Trial, store: RunDirectory, on_progress: Callable[[Progress], None]) -> None:
        self.trial, self.store, self.on_progress = trial, store, on_progress
        self.outcome: Outcome | None = None
        self._journal: Journal | None = None
        self._seconds: Callable[[], float] = lambda: 0.0

    def start(self) -> None:
        """Begin to keep a journal; the trial's lock has to be held from here on."""
        self._journal = Journal(self.trial, self.store)
        self._tell(Progress(Phase.FITTING))

    def prepare(self, seconds: Callable[[], float]) -> Problem:
        """Load and place the meshes.

        Args:
            seconds: that the fit has taken since its start.
        """
        settings, scheme = self.trial.settings, self.trial.named_scheme.resolve()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", MeshfitWarning)
            inputs = dict(self.trial.inputs)
            placed = _placed(self.trial.where(self.trial.target), inputs.get("target"), settings.normalise)
            self._frame, self._target = placed.frame, placed.target
            placed_source = relocated(settings.source, self.trial.where)
            for role, name in source_files(placed_source).items():
                _check_unchanged(name, inputs.get(role))
            built = build_source(placed_source, scheme)
            triangles = built.triangulated() if isinstance(built, PolygonMesh) else built
            source = align(triangles, self._target, settings.source.align)
            _warn_of_differences(source, self._target)
        self._notes = [*placed.notes, *_texts(caught)]
        for note in self._notes:
            self._note(f"warning: {note}")
        self.store.write(self.trial, "config.yaml", dump(self.trial.plain_settings))
        self._source = source
        polygons = built.with_verts(source.verts) if isinstance(built, PolygonMesh) else None
        self._write_mesh("source.ply", polygons or source)
        checkpoint = self._checkpoint()
        before = checkpoint.get("seconds", 0.0) if checkpoint is not None else 0.0
        if checkpoint is not None:
            self._note("going on from a checkpoint")
        self._seconds = lambda: before + seconds()
        return Problem(
            source,
            self._target,
            self.trial.seed,
            on_step=lambda step: self._tell(Progress(Phase.FITTING, step)),
            resume=checkpoint,
            scheme=scheme,
            on_snapshot=lambda step, mesh: write_snapshot(self.trial, self.store, step, self._encoded(mesh)),
            save=lambda state: write_checkpoint(self.trial, self.store, state | {"seconds": self._seconds()}),
            polygons=polygons,
        )

    def _checkpoint(self) -> Checkpoint | None:
        """Where to go on, if nothing is missing of what has been made until there."""
        checkpoint = read_checkpoint(self.trial, self.store)
        done = 0 if checkpoint is None else int(checkpoint["done"])
        if keep_snapshots(self.trial, self.store, steps_before(self.trial, done)):
            return checkpoint
        self._note("starting over, since snapshots are wanted of steps that were made without")
        keep_snapshots(self.trial, self.store, ())
        return None

    def finish(self, fitted: FitResult) -> None:
        """Measure and write."""
        seconds = {"fit": self._seconds()}
        self._write_mesh("result.ply", fitted.polygons or fitted.mesh)
        if fitted.control is not None:
            self._write_mesh("control.ply", fitted.control)
        self.store.write(self.trial, "trace.csv", fitted.trace.to_csv())
        self._tell(Progress(Phase.MEASURING))
        start = time.perf_counter()
        measured = measure(fitted.mesh, self._target, self.trial.settings.measure)
        seconds["measure"] = time.perf_counter() - start
        source = {"area": float(face_areas(self._source).sum())}
        source |= {"verts": self._source.num_verts, "faces": self._source.num_faces}
        work = {"source": source, "seconds": seconds, "peak_memory_mb": peak_memory_mb(), "warnings": self._notes}
        result = result_of(self.trial, self._frame, fitted, measured, work)
        self.store.write(self.trial, RESULT, write_json(result))
        self.store.remove(self.trial, CHECKPOINT, FAILURE, LAST_GOOD)
        self._close(f"complete: {seconds['fit']:.1f} s of fitting, {seconds['measure']:.1f} s of measuring")
        self.outcome = Outcome(Phase.COMPLETE)

    def fail(self, error: Exception) -> None:
        """Record why it failed."""
        if isinstance(error, Diverged):
            self.store.write(self.trial, LAST_GOOD, encode_mesh(error.last_good, ".ply"))
            self.store.write(self.trial, "trace.csv", error.trace.to_csv())
        step = self._journal.step.done if self._journal and self._journal.step else None
        record = failure_of(self.trial, error, step, failed_attempts(self.trial, self.store) + 1)
        self.store.write(self.trial, FAILURE, write_json(record))
        self.store.remove(self.trial, CHECKPOINT)
        message = f"{record['kind']}: {record['message']}"
        self._close("".join([f"failed, {message}\n", *record.get("traceback", [])]).rstrip())
        self.outcome = Outcome(Phase.FAILED, message, record["kind"])

    def stop(self) -> None:
        """Leave it to a later attempt to go on."""
        self._close("stopped, to go on later")

    def _tell(self, progress: Progress) -> None:
        if self._journal is not None:
            self._journal.tell(progress)
        self.on_progress(progress)

    def _note(self, text: str) -> None:
        if self._journal is not None:
            self._journal.note(text)

    def _close(self, text: str) -> None:
        if self._journal is not None:
            self._journal.close(text)

    def _write_mesh(self, name: str, mesh: Mesh | PolygonMesh) -> None:
        self.store.write(self.trial, name, self._encoded(mesh))

    def _encoded(self, mesh: Mesh | PolygonMesh) -> bytes:
        own = self.trial.settings.write_frame == "target"
        return encode_mesh(mesh.with_verts(self._frame.restored(mesh.verts)) if own else mesh, ".ply")


class _Placed(NamedTuple):
    """A target in its frame, and what was found worth a warning when it was loaded."""

    frame: Frame
    target: Mesh
    notes: tuple[str, ...]


@lru_cache(maxsize=2)  # a worker runs trials of one target one after the other, and loading takes longer than measuring
def _placed(name: str, sha256: str | None, normalise: Normalisation) -> _Placed:
    _check_unchanged(name, sha256)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        mesh = load_target(name)
    frame = frame_of(mesh.verts, normalise)
    return _Placed(frame, frame.normalise(mesh), tuple(_texts(caught)))


def _check_unchanged(name: str, sha256: str | None) -> None:
    """A result is filed under the content that its files had when it was planned."""
    if sha256 is not None and file_sha256(target_path(name)) != sha256:
        raise MeshError(f"{name}: the file has changed since the run began; start it again")


def _texts(caught: Sequence[warnings.WarningMessage]) -> list[str]:
    return [str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning)]


def _warn_of_differences(source: Mesh, target: Mesh) -> None:
    ours, theirs = (describe_topology(Topology.of(mesh)) for mesh in (source, target))
    if ours != theirs:
        text = f"source and target differ in topology ({ours}; {theirs}): the fit keeps the source's"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    if boxes_are_disjoint(source, target):
        text = "source and target have nothing in common, not even their boxes; set source.align or source.centre"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
