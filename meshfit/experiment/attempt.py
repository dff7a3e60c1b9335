"""Run one trial: load, place, fit, measure, write; or record why that failed."""

import io
import platform
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import torch
from filelock import FileLock, Timeout

from meshfit.config.strict_yaml import dump
from meshfit.errors import MeshfitError, MeshfitWarning, StoreError
from meshfit.experiment.plan import SCHEMA_VERSION, Trial, target_label
from meshfit.experiment.progress import Outcome, Phase, Progress
from meshfit.experiment.source import build_source
from meshfit.experiment.store import CHECKPOINT, FAILURE, RESULT, Result, RunDirectory, write_json
from meshfit.fitting.first_order import Checkpoint, Diverged
from meshfit.fitting.fit import FitResult, fit
from meshfit.fitting.progress import Interrupted
from meshfit.measuring.measure import Measurement, measure
from meshfit.mesh.files import encode_mesh
from meshfit.mesh.frames import Frame, frame_of
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import load_target, target_title

LAST_GOOD = "last_good.ply"
_LOCK_SECONDS = 0.5
_PACKAGES = ("meshfit", "torch", "numpy", "scipy", "trimesh", "pymeshlab", "pykdtree")


def run_trial(
    trial: Trial, store: RunDirectory, on_progress: Callable[[Progress], None], *, force: bool = False
) -> Outcome:
    """Run a trial that is not complete yet, from its last checkpoint if there is one.

    A lock on its folder keeps two processes from running it at once; the second waits, and finds it complete.

    Args:
        trial: what to run.
        store: where its files go.
        on_progress: called at every step; it may raise `Interrupted`, upon which a checkpoint is written.
        force: run it anew, whatever is there.

    Returns:
        The outcome; a failure is recorded in the folder and returned, not raised.

    Raises:
        StoreError: the run directory cannot be written to.
    """
    try:
        with _held(store.lock(trial), on_progress):
            if not force and store.result(trial) is not None:
                return Outcome(Phase.COMPLETE)
            if force:
                store.remove(trial, RESULT, CHECKPOINT)
            store.write(trial, RESULT, write_json(_run(trial, store, on_progress)))
            store.remove(trial, CHECKPOINT, FAILURE, LAST_GOOD)
            return Outcome(Phase.COMPLETE)
    except Interrupted:
        return Outcome(Phase.INTERRUPTED)
    except StoreError:
        raise
    except Exception as error:  # noqa: BLE001  whatever a trial raises, the others go on
        return _record_failure(trial, store, error)


@contextmanager
def _held(lock: FileLock, on_progress: Callable[[Progress], None]) -> Iterator[None]:
    while not lock.is_locked:
        try:
            lock.acquire(timeout=_LOCK_SECONDS)
        except Timeout:
            on_progress(Progress(Phase.WAITING))
    try:
        yield
    finally:
        lock.release()


def _run(trial: Trial, store: RunDirectory, on_progress: Callable[[Progress], None]) -> Result:
    settings = trial.settings
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        target_file = load_target(trial.target)
        frame = frame_of(target_file.verts, settings.normalise)
        target = frame.normalise(target_file)
        source = build_source(settings.source, trial.scheme)
    store.write(trial, "config.yaml", dump(settings.model_dump(mode="json")))
    _write_mesh(trial, store, "source.ply", source, frame)
    fitted, fit_seconds = _fit(trial, store, source, target, on_progress)
    _write_mesh(trial, store, "result.ply", fitted.mesh, frame)
    store.write(trial, "trace.csv", fitted.trace.to_csv())
    on_progress(Progress(Phase.MEASURING))
    start = time.perf_counter()
    measured = measure(fitted.mesh, target, settings.measure)
    seconds = {"fit": fit_seconds, "measure": time.perf_counter() - start}
    notes = [str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning)]
    work = {"seconds": seconds, "peak_memory_mb": _peak_memory_mb(), "warnings": notes}
    return _result(trial, frame, fitted, measured) | work | _provenance()


def _fit(
    trial: Trial, store: RunDirectory, source: Mesh, target: Mesh, on_progress: Callable[[Progress], None]
) -> tuple[FitResult, float]:
    """The fit, and the seconds it took, those before an interruption included."""
    settings, checkpoint, start = trial.settings, _read_checkpoint(trial, store), time.perf_counter()
    before = checkpoint.get("seconds", 0.0) if checkpoint is not None else 0.0

    def seconds() -> float:
        return before + time.perf_counter() - start

    fitted = fit(
        source,
        target,
        settings.fit,
        seed=trial.seed,
        device=settings.device,
        dtype=settings.dtype,
        on_step=lambda step: on_progress(Progress(Phase.FITTING, step)),
        resume=checkpoint,
        save=lambda state: store.write(trial, CHECKPOINT, _pack(state | {"seconds": seconds()})),
    )
    return fitted, seconds()


def _pack(checkpoint: Checkpoint) -> bytes:
    buffer = io.BytesIO()
    torch.save(checkpoint, buffer)
    return buffer.getvalue()


def _read_checkpoint(trial: Trial, store: RunDirectory) -> Checkpoint | None:
    path = store.folder(trial) / CHECKPOINT
    if not path.is_file():
        return None
    try:
        # weights_only: a checkpoint holds tensors and numbers, and nothing in it is ever executed.
        checkpoint: Checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # noqa: BLE001  a damaged file makes torch raise anything; the trial then starts over
        return None
    return checkpoint


def _write_mesh(trial: Trial, store: RunDirectory, name: str, mesh: Mesh, frame: Frame) -> None:
    own = trial.settings.write_frame == "target"
    store.write(trial, name, encode_mesh(frame.restore(mesh) if own else mesh, ".ply"))


def _result(trial: Trial, frame: Frame, fitted: FitResult, measured: Measurement) -> Result:
    last = fitted.trace.rows[-1] if fitted.trace.rows else ()
    return {
        "schema_version": SCHEMA_VERSION,
        "identity": trial.identity,
        "experiment": trial.experiment,
        "target": target_label(trial.target),
        "target_title": target_title(trial.target),
        "scheme": trial.scheme,
        "seed": trial.seed,
        **measured.to_dict(),
        "fit": {"steps": trial.settings.fit.steps, "device": fitted.device, "final_loss": last[1] if last else None},
        "frame": asdict(frame) | {"normalise": trial.settings.normalise},
        "inputs": dict(trial.inputs),
        "settings": trial.settings.model_dump(mode="json"),
    }


def _provenance() -> Result:
    packages = {name: version(name) for name in _PACKAGES}
    machine: dict[str, Any] = {"system": platform.platform(), "machine": platform.machine()}
    return {"versions": {"python": platform.python_version()} | packages, "platform": machine}


def _peak_memory_mb() -> float | None:
    """The most memory that this process has held so far, in MB; None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if platform.system() == "Darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _record_failure(trial: Trial, store: RunDirectory, error: Exception) -> Outcome:
    record: Result = {"kind": type(error).__name__, "message": str(error), "identity": trial.identity}
    if isinstance(error, Diverged):
        record |= {"step": error.step, "term": error.term, "last_good": LAST_GOOD}
        store.write(trial, LAST_GOOD, encode_mesh(error.last_good, ".ply"))
        store.write(trial, "trace.csv", error.trace.to_csv())
    elif not isinstance(error, MeshfitError):
        record["traceback"] = traceback.format_exception(error)
    store.write(trial, FAILURE, write_json(record))
    store.remove(trial, CHECKPOINT)
    return Outcome(Phase.FAILED, f"{record['kind']}: {record['message']}")
