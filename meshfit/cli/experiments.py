"""What failed: by the reason, with the place where it is recorded."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from meshfit.cli.console import err, out, print_warning
from meshfit.cli.table import check_display, show_tables
from meshfit.errors import TrialError
from meshfit.experiment.storage.checkpoint import snapshots_in
from meshfit.experiment.storage.run_directory import FAILURE, Result, RunDirectory, make_folder
from meshfit.experiment.trial_status import Outcome, Phase
from meshfit.units import duration_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import Remote, Transfer
    from meshfit.experiment.status.eta import Estimate


FAILED = 1
_MOST_ALIKE = 20


def print_failures(trials: Sequence["Trial"], outcomes: Mapping[int, Outcome], runs: Path) -> int:
    """A table of what failed, by the reason, and where that is recorded; the exit code is returned."""
    store = RunDirectory(runs)
    failed = [i for i, outcome in sorted(outcomes.items()) if outcome.phase is Phase.FAILED]
    if not failed:
        return 0
    err.print(f"[bold red]{len(failed)} of {len(trials)} trials failed[/]")
    width = max(len(trials[i].label) for i in failed)
    for message in dict.fromkeys(outcomes[i].message for i in failed):
        alike = [i for i in failed if outcomes[i].message == message]
        err.print(escape(message), soft_wrap=True)
        for i in alike[:_MOST_ALIKE]:
            record = escape(str(store.folder(trials[i]) / FAILURE))
            err.print(f"  {escape(trials[i].label.ljust(width))}  {record}", soft_wrap=True)
        if len(alike) > _MOST_ALIKE:
            where = escape(str(runs / trials[alike[0]].experiment))
            err.print(f"  and {len(alike) - _MOST_ALIKE} more: meshfit status {where} --all", soft_wrap=True)
    return FAILED


def print_plan(
    trials: Sequence["Trial"], runs: Path, *, jobs: int | None, elsewhere: bool, force: bool, as_json: bool
) -> None:
    """Say what would be run.

    Args:
        trials: the plan.
        runs: the run directory.
        jobs: how many processes; None leaves it to the settings.
        elsewhere: they would run on a cluster, whose speed is not known.
        force: complete ones would run again.
        as_json: as an object to stdout.
    """
    store = RunDirectory(runs)
    complete = [store.is_complete(trial) for trial in trials]
    left = [trial for trial, done in zip(trials, complete, strict=True) if force or not done]
    found = None if elsewhere else _estimate(trials, left, store, jobs)
    if as_json:
        rows = [
            {"target": trial.target, "scheme": trial.scheme, "variant": trial.variant, "seed": trial.seed}
            | {"identity": trial.identity, "folder": str(store.folder(trial)), "complete": done}
            for trial, done in zip(trials, complete, strict=True)
        ]
        estimated = (
            None if found is None else {"seconds": found.seconds, "workers": found.workers, "basis": found.basis}
        )
        counts = {"complete": sum(complete), "to_run": len(left), "estimate": estimated}
        typer.echo(json.dumps({"trials": rows} | counts, indent=2))
        return
    for trial, done in zip(trials, complete, strict=True):
        mark = "[green]complete[/]" if done else "[magenta]to run  [/]"
        out.print(f"{mark}  {escape(trial.label)}  {escape(str(store.folder(trial)))}", soft_wrap=True)
    out.print(f"{len(trials)} trials: {sum(complete)} complete, {len(left)} to run")
    if found is not None:
        workers = "1 worker" if found.workers == 1 else f"{found.workers} workers"
        out.print(f"about {duration_text(found.seconds)} on {workers}, going by {found.basis}")


def _estimate(
    trials: Sequence["Trial"], left: Sequence["Trial"], store: RunDirectory, jobs: int | None
) -> "Estimate | None":
    from meshfit.experiment.status.eta import estimate

    results = [(trial, result) for trial in trials if (result := store.result(trial)) is not None]
    try:
        with err.status("probing how long a trial takes"):
            return estimate(left, results, jobs=jobs)
    except TrialError as error:
        print_warning(f"no estimate of time, since the trial that was probed failed: {error}")
        return None


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
    from meshfit.cli.progress import show_progress
    from meshfit.experiment.running.scheduler import run_trials

    make_folder(runs)
    with _remote(workers) as remote, show_progress(trials, quiet=quiet) as watch:
        return run_trials(trials, RunDirectory(runs), jobs=workers.jobs, force=force, remote=remote, watch=watch)


@contextmanager
def _remote(workers: Workers) -> "Iterator[Remote | None]":
    if workers.cluster is None:
        yield None
        return
    from meshfit.experiment.running.dask_backend import DaskRemote

    remote = DaskRemote(workers.cluster, transfer=workers.transfer)
    try:
        yield remote
    finally:
        remote.close()


def results_of(trials: Sequence["Trial"], runs: Path) -> list[Result]:
    """The results of those trials that are complete."""
    from meshfit.report.tables.grouping import distinguish_definitions

    store = RunDirectory(runs)
    results = [(trial, store.result(trial)) for trial in trials]
    # A trial may have been run before its point of a sweep had the name that it has now.
    return distinguish_definitions(
        [result | {"variant": trial.variant} for trial, result in results if result is not None]
    )


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
            print_warning(note)
        show_tables(results, display.metrics, baseline=display.baseline, planned=True)
        folders = dict.fromkeys(str(runs / trial.experiment) for trial in trials)
        out.print(f"\nResults: {', '.join(folders)}", soft_wrap=True, markup=False)
    return print_failures(trials, outcomes, runs)


def _warn_of_missing_snapshots(trials: Sequence["Trial"], store: RunDirectory) -> None:
    wanted = [trial for trial in trials if trial.settings.fit.snapshots is not None and store.is_complete(trial)]
    without = sum(not snapshots_in(store.folder(trial)) for trial in wanted)
    if without:
        trials_are = "1 trial is" if without == 1 else f"{without} trials are"
        print_warning(
            f"{trials_are} complete without the snapshots that are wanted; --force runs them anew, and takes some"
        )
