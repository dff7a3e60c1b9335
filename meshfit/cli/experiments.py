"""What `run` and `compare` share: run the trials that are missing, say what failed, and print tables."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from meshfit.cli.console import err, out, say_warning
from meshfit.cli.plan import print_plan
from meshfit.cli.progress import shown_progress
from meshfit.experiment.progress import Outcome, Phase
from meshfit.experiment.store import FAILURE, Result, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.remote import Remote, Transfer

FAILED = 1
_MOST_ALIKE = 20


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


def run_missing(
    trials: Sequence["Trial"], runs: Path, *, workers: Workers, force: bool, quiet: bool
) -> dict[int, Outcome]:
    """Run what is not complete, with progress shown."""
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
    store = RunDirectory(runs)
    return [result for trial in trials if (result := store.result(trial)) is not None]


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
            err.print(f"  {escape(trials[i].label.ljust(width))}  [dim]{record}[/]", soft_wrap=True)
        if len(alike) > _MOST_ALIKE:
            where = escape(str(runs / trials[alike[0]].experiment))
            err.print(f"  and {len(alike) - _MOST_ALIKE} more: meshfit status {where} --all", soft_wrap=True)
    return FAILED


def show_tables(
    results: Sequence[Result],
    metric: str,
    *,
    baseline: str | None = None,
    format_name: str = "rich",
    planned: bool = False,
) -> None:
    """Print the tables of some results to stdout."""
    from meshfit.report.formats import FORMATS
    from meshfit.report.formats.rich_text import TablesView
    from meshfit.report.gather import target_key
    from meshfit.report.table import build_tables

    # The config's order, which is the order that trials were planned in.
    schemes = dict.fromkeys(result["scheme"] for result in results) if planned else ()
    targets = dict.fromkeys(map(target_key, results)) if planned else ()
    tables = build_tables(results, metric, baseline=baseline, schemes=list(schemes), targets=list(targets))
    if format_name == "rich":
        out.print(TablesView(tables))
    else:
        typer.echo(FORMATS[format_name](tables), nl=False)


def run_and_report(
    trials: Sequence["Trial"],
    runs: Path,
    metric: str,
    *,
    workers: Workers,
    force: bool,
    dry_run: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run what is missing, print the table of all trials, name those that failed; the exit code is returned.

    A dry run only says what would be run.
    """
    from meshfit.report.table import require_metric

    if dry_run:
        print_plan(trials, runs, jobs=workers.jobs, elsewhere=workers.elsewhere, force=force, as_json=as_json)
        return 0
    require_metric(metric)  # now, and not when all has been run
    outcomes = run_missing(trials, runs, workers=workers, force=force, quiet=quiet)
    results = results_of(trials, runs)
    if as_json:
        typer.echo(json.dumps(results, indent=2))
    elif results:
        for note in dict.fromkeys(f"{result['target']}: {text}" for result in results for text in result["warnings"]):
            say_warning(note)
        show_tables(results, metric, planned=True)
        folders = dict.fromkeys(str(runs / trial.experiment) for trial in trials)
        out.print(f"\nResults: {', '.join(folders)}", style="dim", soft_wrap=True, markup=False)
    return print_failures(trials, outcomes, runs)
