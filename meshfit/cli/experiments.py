"""What `run` and `compare` share: run the trials that are missing, say what failed, and print tables."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from meshfit.cli.console import out, say_warning
from meshfit.cli.failures import print_failures
from meshfit.cli.plan import print_plan
from meshfit.cli.tables import check_display, show_tables
from meshfit.experiment.progress import Outcome
from meshfit.experiment.snapshots import snapshots_in
from meshfit.experiment.store import Result, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.remote import Remote, Transfer


@dataclass(frozen=True)
class Workers:
    """Who runs trials: processes of this machine, or the workers of a cluster.

    Attributes:
        jobs: how many processes; None leaves it to the config.
        cluster: the address of a Dask scheduler.
        transfer: how files travel to and from the cluster.
    """

    jobs: int | None = None
    cluster: str | None = None
    transfer: "Transfer" = "auto"

    @property
    def elsewhere(self) -> bool:
        """Whether they are on other machines."""
        return self.cluster is not None


@dataclass(frozen=True)
class Display:
    """What is shown of experiments.

    Attributes:
        metrics: what cells hold; None for the Hausdorff distance.
        baseline: the scheme that others are compared with; None for the first.
        quiet: no progress.
        as_json: results as JSON in place of tables.
    """

    metrics: Sequence[str] | None = None
    baseline: str | None = None
    quiet: bool = False
    as_json: bool = False


def run_missing(
    trials: Sequence["Trial"], runs: Path, *, workers: Workers, force: bool, quiet: bool
) -> dict[int, Outcome]:
    """Run what is not complete, with progress shown."""
    from meshfit.cli.progress import shown_progress
    from meshfit.experiment.executor import run_trials

    make_folder(runs)
    with _remote(workers) as remote, shown_progress(trials, quiet=quiet) as watch:
        return run_trials(trials, RunDirectory(runs), jobs=workers.jobs, force=force, remote=remote, watch=watch)


@contextmanager
def _remote(workers: Workers) -> "Iterator[Remote | None]":
    if workers.cluster is None:
        yield None
        return
    from meshfit.experiment.dask_cluster import DaskRemote

    remote = DaskRemote(workers.cluster, transfer=workers.transfer)
    try:
        yield remote
    finally:
        remote.close()


def results_of(trials: Sequence["Trial"], runs: Path) -> list[Result]:
    """The results of those trials that are complete."""
    from meshfit.report.own_schemes import told_apart

    store = RunDirectory(runs)
    results = [(trial, store.result(trial)) for trial in trials]
    # A trial may have been run before its point of a sweep had the name that it has now.
    return told_apart([result | {"variant": trial.variant} for trial, result in results if result is not None])


def run_and_report(
    trials: Sequence["Trial"], runs: Path, workers: Workers, display: Display, *, force: bool, dry_run: bool
) -> int:
    """Run what is missing, print the table of all trials, name those that failed; the exit code is returned.

    A dry run only says what would be run.
    """
    check_display(trials, display.metrics, display.baseline)
    if dry_run:
        elsewhere, as_json = workers.elsewhere, display.as_json
        print_plan(trials, runs, jobs=workers.jobs, elsewhere=elsewhere, force=force, as_json=as_json)
        return 0
    if not force:
        _warn_of_missing_snapshots(trials, RunDirectory(runs))
    outcomes = run_missing(trials, runs, workers=workers, force=force, quiet=display.quiet)
    results = results_of(trials, runs)
    if display.as_json:
        typer.echo(json.dumps(results, indent=2))
    elif results:
        for note in dict.fromkeys(f"{result['target']}: {text}" for result in results for text in result["warnings"]):
            say_warning(note)
        show_tables(results, display.metrics, baseline=display.baseline, planned=True)
        folders = dict.fromkeys(str(runs / trial.experiment) for trial in trials)
        out.print(f"\nResults: {', '.join(folders)}", soft_wrap=True, markup=False)
    return print_failures(trials, outcomes, runs)


def _warn_of_missing_snapshots(trials: Sequence["Trial"], store: RunDirectory) -> None:
    wanted = [trial for trial in trials if trial.settings.fit.snapshots is not None and store.is_complete(trial)]
    without = sum(not snapshots_in(store.folder(trial)) for trial in wanted)
    if without:
        trials_are = "1 trial is" if without == 1 else f"{without} trials are"
        say_warning(
            f"{trials_are} complete without the snapshots that are wanted; --force runs them anew, and takes some"
        )
