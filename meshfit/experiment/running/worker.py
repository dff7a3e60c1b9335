"""Jobs as a worker runs them, and the transfer of files to workers that do not share the run directory."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from meshfit.errors import ClusterError, StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.running.commands import has_command, require_permission, require_worker_permission
from meshfit.experiment.running.process_pool import ONE_THREAD, worker_progress
from meshfit.experiment.storage.checkpoint import SNAPSHOTS, keep_snapshots, snapshots_in
from meshfit.experiment.storage.run_directory import (
    CHECKPOINT,
    FAILURE,
    LOCK,
    LOG,
    PROGRESS,
    RESULT,
    RunDirectory,
    make_folder,
)
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus
from meshfit.fitting.callbacks import Interrupted
from meshfit.images.folders import PACK_SUFFIX
from meshfit.images.packing import pack_target
from meshfit.images.specs import is_image_target, label_of_target
from meshfit.images.targets import load_images
from meshfit.mesh.targets import companion_files

Files = Mapping[str, bytes]
"""Content of files by name: a trial reads those under `inputs/`; the others belong in its folder."""

_INPUTS = "inputs/"
_SECONDS_BETWEEN_CHECKS = 1.0
_SECONDS_BETWEEN_MESSAGES = 10.0

# A worker of a cluster may have several threads, but caught warnings and memory belong to the whole process.
_one_job_at_a_time = threading.Lock()


class CancellationFlag(Protocol):
    """A flag that asks workers to write checkpoints and stop; it travels with each job."""

    def set(self) -> None:
        """Ask workers to stop."""

    def is_set(self) -> bool:
        """Whether workers are asked to stop."""

    def clear(self) -> None:
        """Remove the flag."""


class Channel(Protocol):
    """A way to send files of a trial while it runs; it travels with each job."""

    def send(self, trial: int, files: Files) -> None:
        """Send the present content of files of a trial, by its number; nothing is raised if they cannot be sent."""


@dataclass(frozen=True)
class RemoteOptions:
    """Additions to a job for a worker that is not a child of this process.

    Attributes:
        cancellation: the flag to watch.
        inputs: by trial, the files that it starts from; None where the run directory is shared.
        channel: for the log and the progress of running trials that return their files; None if these come at the end.
        version: the sender's `RESULTS_VERSION`.
    """

    cancellation: CancellationFlag
    inputs: Mapping[int, Files] | None = None
    channel: Channel | None = None
    version: int = RESULTS_VERSION


@dataclass(frozen=True)
class Job:
    """Trials to fit in one batch, by number, with their run directory, device and options."""

    trials: Mapping[int, Trial]
    store: RunDirectory
    device: str
    threads: int
    force: bool
    remote: RemoteOptions | None = None
    allow_commands: bool = False


@dataclass(frozen=True)
class JobResult:
    """Outcomes by trial, and the files of trials that ran in the worker's own directory."""

    outcomes: Mapping[int, Outcome]
    files: Mapping[int, Files] = field(default_factory=dict)


def run_job(job: Job) -> JobResult:
    """Run a job in this process.

    Raises:
        ClusterError: the worker has another version of meshfit than the sender of the job, or runs no commands.
        ConfigError: the sender has not allowed the commands of the job.
        StoreError: the run directory cannot be written to.
    """
    require_permission(job.trials.values(), allowed=job.allow_commands)
    if job.remote is None:
        shared = worker_progress()
        return JobResult(_run(job, shared.__setitem__, lambda: shared.cancelled))
    if job.remote.version != RESULTS_VERSION:
        raise ClusterError("a worker has another version of meshfit; install the same one everywhere")
    if any(has_command(trial) for trial in job.trials.values()):
        require_worker_permission()
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    cancelled = _polled(job.remote.cancellation.is_set)
    with _one_job_at_a_time:
        if job.remote.inputs is None:  # the progress is read from files
            return JobResult(_run(job, lambda *_: None, cancelled))
        with TemporaryDirectory(prefix="meshfit-") as folder:
            store = RunDirectory(Path(folder), carries_targets=False)  # the sender has them
            trials = {
                number: unpack_inputs(trial, job.remote.inputs[number], store, Path(folder, "inputs", str(number)))
                for number, trial in job.trials.items()
            }
            sender = _Sender(trials, store, job.remote.channel)
            outcomes = _run(replace(job, trials=trials, store=store), sender.update, cancelled)
            return JobResult(outcomes, {number: pack_outputs(trial, store) for number, trial in trials.items()})


def _run(job: Job, report: Callable[[int, Progress], None], cancelled: Callable[[], bool]) -> dict[int, Outcome]:
    numbers = list(job.trials)

    def on_progress(index: int, progress: Progress) -> None:
        report(numbers[index], progress)
        if progress.status is not TrialStatus.MEASURING and cancelled():
            raise Interrupted

    if cancelled():
        return dict.fromkeys(numbers, Outcome(TrialStatus.INTERRUPTED))
    from meshfit.experiment.running.batch_runner import run_batch

    for number in numbers:
        report(number, Progress(TrialStatus.FITTING))
    trials = list(job.trials.values())
    outcomes = run_batch(
        trials,
        job.store,
        on_progress,
        device=job.device,
        threads=job.threads,
        force=job.force,
        allow_commands=job.allow_commands,
    )
    for number, outcome in zip(numbers, outcomes, strict=True):
        report(number, Progress(outcome.status))
    return dict(zip(numbers, outcomes, strict=True))


class _Sender:
    """Sender of the logs and the progress of trials that run in a worker's own directory."""

    def __init__(self, trials: Mapping[int, Trial], store: RunDirectory, channel: Channel | None) -> None:
        self._folders = {number: store.folder(trial) for number, trial in trials.items()}
        self._channel, self._logged, self._due = channel, dict[int, int](), dict[int, float]()

    def update(self, number: int, _: Progress) -> None:
        """Send the files of a trial if its log has grown, else about every ten seconds."""
        log = self._folders[number] / LOG
        if self._channel is None or not log.is_file():
            return
        size, now = log.stat().st_size, time.monotonic()
        if size == self._logged.get(number) and now < self._due.get(number, 0.0):
            return
        self._logged[number], self._due[number] = size, now + _SECONDS_BETWEEN_MESSAGES
        paths = [path for path in (log, log.with_name(PROGRESS)) if path.is_file()]
        self._channel.send(number, {path.name: path.read_bytes() for path in paths})


def _polled(is_set: Callable[[], bool]) -> Callable[[], bool]:
    """Limit a query to one per second, since another machine answers it."""
    due, answer = 0.0, False

    def latest() -> bool:
        nonlocal due, answer
        if not answer and time.monotonic() >= due:
            answer = is_set()
            due = time.monotonic() + _SECONDS_BETWEEN_CHECKS
        return answer

    return latest


def pack_inputs(trial: Trial, store: RunDirectory) -> Files:
    """Read the files that a worker needs to start a trial: meshes, and what an earlier attempt left.

    Raises:
        StoreError: a file cannot be read.
    """
    files = {}
    for role, name in trial.files.items():
        present = trial.current_path(name)
        if role == "target" and is_image_target(present):
            files[f"{_INPUTS}{role}/{_packed_name(present)}"] = pack_target(load_images(present))
            continue
        path = Path(present)
        # Of targets, and of tables such as those of creases, no materials are read.
        for file in (path, *companion_files(path, looks=role == "source")):
            files[f"{_INPUTS}{role}/{file.relative_to(path.parent).as_posix()}"] = _content(file)
    for name in (CHECKPOINT, FAILURE):
        if (path := store.folder(trial) / name).is_file():
            files[name] = _content(path)
    snapshots = snapshots_in(store.folder(trial)).values()
    return files | {f"{SNAPSHOTS}/{path.name}": _content(path) for path in snapshots}


def unpack_inputs(trial: Trial, files: Files, store: RunDirectory, inputs: Path) -> Trial:
    """Write packed files, with meshes in `inputs`, and return the trial with the new paths of its meshes."""
    for name, content in files.items():
        path = inputs / name.removeprefix(_INPUTS) if name.startswith(_INPUTS) else store.folder(trial) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return replace(
        trial,
        copies=tuple(
            (name, str(inputs / role / _packed_name(trial.current_path(name)))) for role, name in trial.files.items()
        ),
    )


def _packed_name(name: str) -> str:
    """The name of a file among packed ones; images are one file."""
    return f"{label_of_target(name)}{PACK_SUFFIX}" if is_image_target(name) else Path(name).name


def pack_outputs(trial: Trial, store: RunDirectory) -> Files:
    """Read the files of a trial that a worker has run."""
    folder = store.folder(trial)
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in (LOCK, PROGRESS)]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def store_outputs(trial: Trial, files: Files, store: RunDirectory, *, force: bool = False) -> None:
    """Write the files that a worker returned into the trial's folder, the result last.

    Args:
        trial: the trial.
        files: the returned files.
        store: the run directory.
        force: overwrite a complete trial, which otherwise stays as it is.

    Raises:
        StoreError: they cannot be written.
    """
    with store.lock(trial):
        if store.is_complete(trial) and not force:
            return
        keep_snapshots(trial, store, ())
        if any(name.startswith(SNAPSHOTS) for name in files):
            make_folder(store.folder(trial) / SNAPSHOTS)
        for name in sorted(files, key=lambda name: (name == RESULT, name)):
            store.write(trial, name, files[name])
        store.remove(trial, PROGRESS)  # that it sent while it ran
        if RESULT in files:
            store.remove(trial, CHECKPOINT, FAILURE)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
