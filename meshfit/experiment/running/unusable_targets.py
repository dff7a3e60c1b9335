"""Trials whose target cannot be used: each is recorded as a failure, without a worker."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from meshfit.config.strict_yaml import dump
from meshfit.errors import MeshError, StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.storage.failure import FailureKind, failed_attempts, failure_record
from meshfit.experiment.storage.plan_file import read_plan
from meshfit.experiment.storage.run_directory import (
    CONFIG,
    FAILURE,
    LOCK,
    LOG,
    RunDirectory,
    json_text,
    now,
)
from meshfit.experiment.trial_status import Outcome, TrialStatus


def record_unusable(trial: Trial, store: RunDirectory) -> Outcome:
    """Record that a trial failed because its target cannot be used.

    Raises:
        StoreError: the run directory cannot be written to.
    """
    with store.lock(trial):
        store.write(trial, CONFIG, dump(trial.config))
        record = failure_record(trial, MeshError(trial.fault), None, failed_attempts(trial, store) + 1)
        store.append(trial, LOG, f"{now()}  failed, {record['kind']}: {record['message']}\n")
        store.write(trial, FAILURE, json_text(record))
    return Outcome(TrialStatus.FAILED, f"{record['kind']}: {record['message']}", FailureKind.INPUT)


def remove_outdated_failures(trials: Sequence[Trial], store: RunDirectory) -> None:
    """Remove the records of trials whose target could not be used when it was last planned, and now can.

    Their identity does not depend on the content of the target, so that the same trials are in other folders now.
    """
    for experiment in dict.fromkeys(trial.experiment for trial in trials):
        with suppress(StoreError):  # a damaged plan is replaced
            previous = read_plan(store.root / experiment)
            usable = [trial for trial in trials if trial.experiment == experiment and not trial.fault]
            now_usable = {(trial.target_label, trial.scheme, trial.variant, trial.seed) for trial in usable}
            for planned in previous.trials if previous else ():
                names = (planned.target, planned.scheme, planned.variant, planned.seed)
                if names in now_usable and planned.origin and "target" not in planned.origin["inputs"]:
                    _remove_record(store.root / experiment / planned.folder)


def _remove_record(folder: Path) -> None:
    """Remove the files that `record_unusable` writes, and the folder unless there are others in it."""
    with suppress(OSError):
        for name in (CONFIG, LOG, FAILURE, LOCK):
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()
