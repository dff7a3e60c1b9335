"""Trials on their way to workers that see none of this machine's files, and back."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from meshfit.errors import ClusterError, StoreError
from meshfit.experiment.plan import SCHEMA_VERSION, Trial
from meshfit.experiment.running.environment import ONE_THREAD
from meshfit.experiment.running.process_pool import board_of_worker
from meshfit.experiment.storage.checkpoint import SNAPSHOTS, keep_snapshots, snapshots_in
from meshfit.experiment.storage.run_directory import (
    CHECKPOINT,
    FAILURE,
    LOCK,
    PROGRESS,
    RESULT,
    RunDirectory,
    make_folder,
)
from meshfit.experiment.trial_status import Outcome, Phase, Progress
from meshfit.fitting.callbacks import Interrupted

if TYPE_CHECKING:
    from meshfit.experiment.running.backends import StopSign


Files = Mapping[str, bytes]
"""The content of files by name; those under `inputs/` are what a trial reads, the others lie in its folder."""

_INPUTS = "inputs/"


def parcel_for(trial: Trial, store: RunDirectory) -> Files:
    """What a worker needs to begin with a trial: its mesh files, and where an earlier attempt got to.

    Raises:
        StoreError: a file cannot be read.
    """
    files = {f"{_INPUTS}{role}/{Path(path).name}": _content(Path(path)) for role, path in trial.files.items()}
    for name in (CHECKPOINT, FAILURE):
        if (path := store.folder(trial) / name).is_file():
            files[name] = _content(path)
    snapshots = snapshots_in(store.folder(trial)).values()
    return files | {f"{SNAPSHOTS}/{path.name}": _content(path) for path in snapshots}


def open_parcel(trial: Trial, files: Files, store: RunDirectory, inputs: Path) -> Trial:
    """Lay a parcel's files out; the trial is returned with the places where its mesh files are now."""
    copies = {}
    for name, content in files.items():
        if name.startswith(_INPUTS):
            path = inputs / name.removeprefix(_INPUTS)
            copies[trial.files[path.parent.name]] = str(path)
        else:
            path = store.folder(trial) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return replace(trial, copies=tuple(copies.items()))


def parcel_of(trial: Trial, store: RunDirectory) -> Files:
    """The files of a trial that a worker has done with."""
    folder = store.folder(trial)
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in (LOCK, PROGRESS)]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def put_back(trial: Trial, files: Files, store: RunDirectory, *, force: bool = False) -> None:
    """Write what came back into the trial's folder, the result last.

    Args:
        trial: whose files.
        files: what came back.
        store: where its folder is.
        force: write over what is complete there, which else stays as it is.

    Raises:
        StoreError: it cannot be written.
    """
    with store.lock(trial):
        if store.is_complete(trial) and not force:
            return
        keep_snapshots(trial, store, ())
        if any(name.startswith(SNAPSHOTS) for name in files):
            make_folder(store.folder(trial) / SNAPSHOTS)
        for name in sorted(files, key=lambda name: (name == RESULT, name)):
            store.write(trial, name, files[name])
        if RESULT in files:
            store.remove(trial, CHECKPOINT, FAILURE)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error


_SECONDS_BETWEEN_LOOKS = 1.0

# A worker of a cluster may have several threads; what is caught as a warning, and memory, belong to the whole process.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Errand:
    """What a worker that is no child of this process has to know besides.

    Attributes:
        stop: tells whether to write checkpoints and stop.
        parcels: by trial, the files that it starts from; None where the run directory is shared.
        schema_version: that of the one who sends it.
    """

    stop: "StopSign"
    parcels: Mapping[int, Files] | None = None
    schema_version: int = SCHEMA_VERSION


@dataclass(frozen=True)
class Job:
    """What a worker is given: trials to fit together, by their numbers, and where their files go."""

    trials: Mapping[int, Trial]
    store: RunDirectory
    device: str
    threads: int
    force: bool
    errand: Errand | None = None


@dataclass(frozen=True)
class Done:
    """What a worker gives back: outcomes by trial, and the files of trials that it had in a directory of its own."""

    outcomes: Mapping[int, Outcome]
    files: Mapping[int, Files] = field(default_factory=dict)


def work(job: Job) -> Done:
    """Run a job.

    Raises:
        ClusterError: the worker has another version of meshfit than the one who sent the job.
        StoreError: the run directory cannot be written to.
    """
    if job.errand is None:
        return Done(_run(job, *_board_contact()))
    if job.errand.schema_version != SCHEMA_VERSION:
        raise ClusterError("a worker has another version of meshfit; install the same one everywhere")
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    contact = (lambda *_: None), _seldom(job.errand.stop.is_set)
    with _one_at_a_time:
        if job.errand.parcels is None:
            return Done(_run(job, *contact))
        with TemporaryDirectory(prefix="meshfit-") as folder:
            store = RunDirectory(Path(folder))
            trials = {
                number: open_parcel(trial, job.errand.parcels[number], store, Path(folder, "inputs", str(number)))
                for number, trial in job.trials.items()
            }
            outcomes = _run(replace(job, trials=trials, store=store), *contact)
            return Done(outcomes, {number: parcel_of(trial, store) for number, trial in trials.items()})


def _run(job: Job, post: Callable[[int, Progress], None], stopped: Callable[[], bool]) -> dict[int, Outcome]:
    numbers = list(job.trials)

    def on_progress(at: int, progress: Progress) -> None:
        post(numbers[at], progress)
        if progress.phase is not Phase.MEASURING and stopped():
            raise Interrupted

    if stopped():
        return dict.fromkeys(numbers, Outcome(Phase.INTERRUPTED))
    from meshfit.experiment.running.batch_runner import run_together

    for number in numbers:
        post(number, Progress(Phase.FITTING))
    trials = list(job.trials.values())
    found = run_together(trials, job.store, on_progress, device=job.device, threads=job.threads, force=job.force)
    for number, outcome in zip(numbers, found, strict=True):
        post(number, Progress(outcome.phase))
    return dict(zip(numbers, found, strict=True))


def _board_contact() -> tuple[Callable[[int, Progress], None], Callable[[], bool]]:
    board = board_of_worker()
    if board is None:
        raise RuntimeError("the worker was not started by a LocalExecutor")
    return board.post, lambda: board.stopped


def _seldom(ask: Callable[[], bool]) -> Callable[[], bool]:
    """The same question, put once a second at most, since its answer comes from another machine."""
    due, answer = 0.0, False

    def latest() -> bool:
        nonlocal due, answer
        if not answer and time.monotonic() >= due:
            answer = ask()
            due = time.monotonic() + _SECONDS_BETWEEN_LOOKS
        return answer

    return latest
