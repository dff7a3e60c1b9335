"""Trial runner: load and place the meshes of a trial, measure its fit, and write all files of its folder."""

import platform
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

from meshfit.config.source_settings import SourceSettings
from meshfit.config.strict_yaml import dump
from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.guidance import guidance_of, read_landmarks
from meshfit.experiment.plan import Trial, command_files
from meshfit.experiment.running.trial_source import prepare_source
from meshfit.experiment.running.trial_target import TrialTarget, check_unchanged, load_trial_target, warning_texts
from meshfit.experiment.running.trial_verdict import judge
from meshfit.experiment.source import (
    is_own_mesh,
    relocated,
    source_files,
)
from meshfit.experiment.storage.attributes import attributes_file, encode_attributes
from meshfit.experiment.storage.checkpoint import (
    keep_snapshots,
    read_checkpoint,
    snapshot_steps,
    write_checkpoint,
    write_snapshot,
)
from meshfit.experiment.storage.failure import LAST_GOOD, failed_attempts, failure_record
from meshfit.experiment.storage.frame import frame_record
from meshfit.experiment.storage.mesh_files import FILES, file_record
from meshfit.experiment.storage.result import result_record
from meshfit.experiment.storage.run_directory import (
    CHECKPOINT,
    CONFIG,
    CORRESPONDENCE,
    FAILURE,
    RESULT,
    TIMES,
    TRACE,
    Result,
    RunDirectory,
    json_text,
)
from meshfit.experiment.storage.targets import carried_path, carry_target, file_numbers, present_target
from meshfit.experiment.storage.trial_log import TrialLog
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus
from meshfit.experiment.truth import source_with_faces_of, vertex_counts
from meshfit.fitting.callbacks import Step
from meshfit.fitting.differences import IN_CONFIG, warn_of_differences
from meshfit.fitting.external.tools import ToolError, ToolRun
from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Checkpoint, Diverged, Problem, Trace
from meshfit.fitting.registration.guidance import Guidance
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.measuring.correspondence import Correspondence
from meshfit.measuring.measure import Measurement, measure
from meshfit.measuring.vertex_error import Truth
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.io.files import encode_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.registry import Scheme


class TrialRunner:
    """Runner of one trial: `start`, `prepare`, a fit, and `finish`; after `start`, `fail` or `stop` at any time.

    Attributes:
        outcome: the outcome of the trial; None until it has ended.
    """

    def __init__(self, trial: Trial, store: RunDirectory, on_progress: Callable[[Progress], None]) -> None:
        self.trial, self.store, self.on_progress = trial, store, on_progress
        self.outcome: Outcome | None = None
        self._step = Step(0, trial.settings.fit.steps, float("nan"))
        self._seconds: Callable[[], float] = lambda: 0.0
        self._frame: Frame | None = None
        self._files: dict[str, Result] = {}
        self._write_frame = trial.settings.write_frame

    def start(self) -> None:
        """Open the log; the trial's lock must be held from here on."""
        self._log = TrialLog(self.trial, self.store)
        self._report(TrialStatus.FITTING)

    def prepare(self, seconds: Callable[[], float]) -> Problem:
        """Load and place the meshes.

        Args:
            seconds: returns the seconds that the fit has taken.
        """
        start = time.perf_counter()
        settings, scheme = self.trial.settings, self.trial.named_scheme.resolve()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", MeshfitWarning)
            inputs = dict(self.trial.inputs)
            self._target_name = name = present_target(self.trial, self.store)
            carried = carried_path(self.trial, self.store)
            target = load_trial_target(
                name, inputs.get("target"), settings.normalise, settings.cleaning, settings.target, carried
            )
            carry_target(carried, name, settings.cleaning)  # removed since it was loaded
            self._frame, self._target, self._images = target.frame, target.mesh, target.images
            self._reference = target.mesh if target.reference is None else target.reference
            source_settings = relocated(settings.source, self.trial.current_path)
            for role, name in source_files(source_settings).items():
                check_unchanged(name, inputs.get(role))
            for role, path in command_files(settings.fit).items():
                check_unchanged(path, inputs.get(role))
            self._truth = self._read_truth(inputs.get("truth"))
            guidance = self._guidance(source_settings, scheme, target, inputs)
            if source_settings.is_made_from_target:
                self._report(TrialStatus.PREPARING)
            views = None if self._images is None else self._images.views
            source = prepare_source(source_settings, scheme, target, settings.target.surface)
            self._source, self._built, self._source_record = source.mesh, source.built, source.record
            fills = source_settings.mesh == "closed"
            warn_of_differences(
                self._source, self._target, settings.fit, settings.target.surface, fills=fills, remedies=IN_CONFIG
            )
        self._warnings = [*target.warnings, *warning_texts(caught)]
        is_copy = self.store.carries_targets and self._target_name != self.trial.target
        copy = f"target: {self._target_name}, the copy of a missing file" if is_copy else ""
        for line in (copy, target.note, *source.notes):
            if line:
                self._log.note(line)
        for text in self._warnings:
            self._log.note(f"warning: {text}")
        self.store.write(self.trial, CONFIG, dump(self.trial.config))
        self._report(TrialStatus.FITTING)  # with the warnings so far, before the first step
        checkpoint = self._checkpoint()
        before = checkpoint.get("seconds", 0.0) if checkpoint is not None else 0.0
        if checkpoint is not None:
            self._log.note("resuming from a checkpoint")
            # Snapshots of earlier steps are in this frame.
            self._write_frame = checkpoint.get("write_frame", self._write_frame)
        self._write_mesh("source.ply", self._built)
        self._seconds, self._prepared_in = lambda: before + seconds(), time.perf_counter() - start
        return Problem(
            self._source,
            self._target,
            self.trial.seed,
            on_step=self._on_step,
            resume=checkpoint,
            scheme=scheme,
            on_snapshot=lambda step, mesh: write_snapshot(self.trial, self.store, step, self._encoded(mesh)),
            save=self._save_checkpoint,
            polygons=source.polygons,
            own=is_own_mesh(source_settings),
            guidance=guidance,
            images=views,
        )

    def finish(self, fitted: FitResult) -> None:
        """Measure the fit, and write it and the result."""
        name = self._target_name
        carry_target(carried_path(self.trial, self.store), name, self.trial.settings.cleaning)  # removed since
        seconds, memory = {"fit": self._seconds()}, peak_memory_mb()
        if fitted.tool is not None:
            seconds, memory = {"fit": fitted.tool.seconds}, fitted.tool.peak_memory_mb
            self._log_tool(fitted.tool)
        seconds = {"prepare": self._prepared_in} | seconds
        self._write_mesh("result.ply", fitted.polygons or fitted.mesh)
        if fitted.control is not None:
            self._write_mesh("control.ply", fitted.control)
        if fitted.tool is None:
            self._write_trace(fitted.trace)
        if fitted.registered is not None:
            self._log.note(fitted.registered.line)
        self._report(TrialStatus.MEASURING)
        start = time.perf_counter()
        with self.warnings_recorded():
            measured = self._measured(fitted)
            self._write_correspondence(fitted)
        short, verdict = judge(
            (fitted.mesh, self._source, self._reference),
            self.trial.settings,
            measured.distance,
            measured.iou,
            of_fit=fitted.shortfalls,
            compared_with="" if self._images is None else self._images.compared_with,
        )
        for text in (*fitted.notes, *short):
            self.warn(text)
        seconds["measure"] = time.perf_counter() - start
        source = self._source_record | {"area": float(face_areas(self._source).sum())}
        source |= {"verts": self._source.num_verts, "faces": self._source.num_faces}
        work = {"source": source, "seconds": seconds, "peak_memory_mb": memory, "warnings": self._warnings}
        work["shortfalls"], work["verdict"] = short, verdict.to_dict()
        work[FILES] = self._files
        if self._images is not None:
            work["images"] = self._images.record
        result = result_record(self.trial, self._frame_record, fitted, measured, work)
        self.store.write(self.trial, RESULT, json_text(result))
        self.store.remove(self.trial, CHECKPOINT, FAILURE, LAST_GOOD)
        self._log.close(f"complete: {seconds['fit']:.1f} s of fitting, {seconds['measure']:.1f} s of measuring")
        self.outcome = Outcome(TrialStatus.COMPLETE)

    def _measured(self, fitted: FitResult) -> Measurement:
        """Measure a result against its target, and if it has the faces of the source, against that too."""
        settings, scheme = self.trial.settings, self.trial.named_scheme.resolve()
        source = source_with_faces_of(fitted.mesh, self._built, scheme, settings.fit, self._source)
        truth = self._truth
        if truth is not None and (source is None or int(truth.verts.max()) >= fitted.mesh.num_verts):
            warnings.warn(
                "no vertex error: the result has other vertices than the source", MeshfitWarning, stacklevel=2
            )
            truth = None
        is_registered = fitted.registered is not None and fitted.registered.register != "off"
        scaled = is_registered and fitted.pose_scale != 1.0
        images = self._images
        return measure(
            fitted.mesh,
            self._reference,
            settings.measure,
            images=None if images is None else images.views,
            held_out=None if images is None else images.held_out,
            source=source,
            truth=truth,
            landmarks=fitted.landmarks,
            scaled=scaled,
        )

    def _write_correspondence(self, fitted: FitResult) -> None:
        """Write the partner of each vertex on the target, where the vertices are those of the source."""
        fit = self.trial.settings.fit
        if not isinstance(fit, GaussNewtonSettings) or fit.connectivity != "fixed" or self._images is not None:
            return
        assert self._frame is not None  # noqa: S101  set by `prepare`
        found = Correspondence.of(fitted.mesh, self._target).restored(self._frame)
        sha256 = dict(self.trial.inputs).get("target")
        numbered = found.numbered_as(*file_numbers(self._target_name, sha256))
        self.store.write(self.trial, CORRESPONDENCE, numbered.to_csv())

    def _guidance(
        self, source: SourceSettings, scheme: Scheme, target: TrialTarget, inputs: Mapping[str, str]
    ) -> Guidance | None:
        """Read what is known of the source."""
        trial, places = self.trial, self.trial.target_landmarks
        if places is not None:
            places = trial.current_path(places)
            check_unchanged(places, inputs.get("target-landmarks"))
        landmarks = read_landmarks(source, places)
        is_numbered = landmarks is not None and landmarks.goals_are_numbered  # in the file itself
        name = trial.current_path(trial.target) if is_numbered else self._target_name
        return guidance_of(source, scheme, landmarks, (name, target.frame.restore(target.mesh), target.frame))

    def _read_truth(self, sha256: str | None) -> Truth | None:
        """Read where vertices of the result belong, in the normalised frame."""
        trial = self.trial
        if trial.truth is None:
            return None
        path = trial.current_path(trial.truth)
        check_unchanged(path, sha256)
        source = relocated(trial.settings.source, trial.current_path)
        truth = vertex_counts(source, trial.named_scheme, trial.settings.fit).truth(path, trial.truth)
        assert self._frame is not None  # noqa: S101  set by `prepare`
        return replace(truth, positions=(truth.positions - self._frame.centre) / self._frame.scale)

    def fail(self, error: Exception) -> None:
        """Record why the trial failed."""
        if isinstance(error, ToolError):
            self._log_output(error.output)
        if isinstance(error, Diverged):
            self._write_mesh(LAST_GOOD, error.last_good)
            self._write_trace(error.trace)
        record = failure_record(self.trial, error, self._step.done or None, failed_attempts(self.trial, self.store) + 1)
        if self._frame is not None:
            record |= {"frame": self._frame_record}
        self.store.write(self.trial, FAILURE, json_text(record))
        self.store.remove(self.trial, CHECKPOINT)
        message = f"{record['kind']}: {record['message']}"
        self._log.close("".join([f"failed, {message}\n", *record.get("traceback", [])]).rstrip())
        self.outcome = Outcome(TrialStatus.FAILED, message, record["kind"])

    def warn(self, text: str) -> None:
        """Add a warning to the result and the log."""
        if text not in self._warnings:
            self._warnings.append(text)
            self._log.note(f"warning: {text}")

    @contextmanager
    def warnings_recorded(self) -> Iterator[None]:
        """Add the warnings that are given within the block, instead of showing them."""
        with recorded_warnings() as texts:
            yield
        for text in texts:
            self.warn(text)

    def _log_tool(self, tool: ToolRun) -> None:
        version = f", version {tool.version}" if tool.version else ""
        self._log.note(f"{tool.name}{version}: {tool.seconds:.1f} s")
        self._log_output(tool.output)
        for text in tool.warnings:
            self.warn(text)

    def _log_output(self, output: str) -> None:
        if output.strip():
            self._log.note("\n".join(["output of the tool:", *(f"  | {line}" for line in output.splitlines())]))

    def stop(self) -> None:
        """Stop, so that a later attempt resumes from the last checkpoint."""
        self._log.close("interrupted; the next run resumes it")

    def _checkpoint(self) -> Checkpoint | None:
        """The last checkpoint, unless it is not one of this trial, or a snapshot up to it is missing."""
        checkpoint = None
        try:
            checkpoint = read_checkpoint(self.trial, self.store)
        except StoreError as error:
            self._log.note(f"starting over: {error}")
        done = 0 if checkpoint is None else int(checkpoint["done"])
        if keep_snapshots(self.trial, self.store, snapshot_steps(self.trial, done)):
            return checkpoint
        self._log.note("starting over: snapshots of earlier steps are missing")
        keep_snapshots(self.trial, self.store, ())
        return None

    def _on_step(self, step: Step) -> None:
        self._step = step
        self._report(TrialStatus.FITTING)

    def _report(self, status: TrialStatus) -> None:
        progress = Progress(status, self._step)
        self._log.update(progress)
        self.on_progress(progress)

    def _write_trace(self, trace: Trace) -> None:
        """Write the trace, and its times to a file of their own, since they differ from run to run."""
        self.store.write(self.trial, TRACE, trace.to_csv())
        self.store.write(self.trial, TIMES, trace.times_to_csv())

    def _write_mesh(self, name: str, mesh: Mesh | PolygonMesh) -> None:
        if mesh.attributes:
            self.store.write(self.trial, attributes_file(name), encode_attributes(mesh.attributes))
        else:  # of an earlier attempt
            self.store.remove(self.trial, attributes_file(name))
        content = self._encoded(mesh)
        self._files[name] = file_record(content)
        self.store.write(self.trial, name, content)

    def _encoded(self, mesh: Mesh | PolygonMesh) -> bytes:
        assert self._frame is not None  # noqa: S101  set by `prepare`
        return encode_mesh(self._frame.restore(mesh) if self._write_frame == "target" else mesh, ".ply")

    @property
    def _frame_record(self) -> Result:
        assert self._frame is not None  # noqa: S101  set by `prepare`
        return frame_record(self._frame, self.trial.settings.normalise, self._write_frame)

    def _save_checkpoint(self, state: Checkpoint) -> None:
        state = state | {"seconds": self._seconds(), "write_frame": self._write_frame}
        write_checkpoint(self.trial, self.store, state)


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """Collect meshfit's own warnings within the block, and drop all others."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        yield texts
    texts += warning_texts(caught)


def peak_memory_mb(*, of_children: bool = False) -> float | None:
    """Return the peak memory of this process in MB; None where the system does not report it.

    Args:
        of_children: return that of the largest child process that has ended instead; 0 where there was none.
    """
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if platform.system() == "Darwin" else 1024
    usage = resource.getrusage(resource.RUSAGE_CHILDREN if of_children else resource.RUSAGE_SELF)
    return usage.ru_maxrss * unit / 1e6
