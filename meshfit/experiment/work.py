"""What a worker does: run the trials of a job, in the run directory or, if it does not see that, in one of its own."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from meshfit.errors import ClusterError
from meshfit.experiment.interrupts import ONE_THREAD
from meshfit.experiment.local import board_of_worker
from meshfit.experiment.parcels import Files, open_parcel, parcel_of
from meshfit.experiment.plan import SCHEMA_VERSION, Trial
from meshfit.experiment.progress import Outcome, Phase, Progress
from meshfit.experiment.store import RunDirectory
from meshfit.fitting.progress import Interrupted

if TYPE_CHECKING:
    from meshfit.experiment.remote import StopSign

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
    from meshfit.experiment.trial import run_together

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
