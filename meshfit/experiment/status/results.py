"""Scan of run directories with the results of their complete trials, each read once."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from meshfit.experiment.status.scan import ScannedExperiment, absolute, scan_experiments
from meshfit.experiment.storage.result import read_result_or_warn, read_results
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.trial_status import TrialStatus


def scan_with_results(
    roots: Sequence[Path], now: datetime, *, required: bool = True
) -> tuple[list[ScannedExperiment], list[Result]]:
    """Scan run directories as `scan_experiments` does, and read the results in them as `read_results` does.

    Damaged results are left out with a warning.

    Raises:
        StoreError: as the two functions.
    """
    results = read_results(roots, required=False)
    read = {absolute(Path(result["folder"])) for result in results}
    experiments = scan_experiments(roots, now, required=required, complete=read)
    ended_since = (
        trial.path
        for experiment in experiments
        for trial in experiment.trials
        if trial.status is TrialStatus.COMPLETE and absolute(trial.path) not in read
    )
    return experiments, [*results, *filter(None, map(read_result_or_warn, ended_since))]
