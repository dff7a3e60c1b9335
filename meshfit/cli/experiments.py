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
from meshfit.cli.progress import shown_progress
from meshfit.experiment.progress import Outcome, Phase
from meshfit.experiment.store import Result, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.experiment.remote import Remote, Transfer

FAILED = 1


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


def print_plan(trials: Sequence["Trial"], runs: Path, *, as_json: bool) -> None:
    """Say what would be run, and what of it is complete."""
    store = RunDirectory(runs)
    complete = [store.result(trial) is not None for trial in trials]
    if as_json:
        rows = [
            {"target": trial.target, "scheme": trial.scheme, "seed": trial.seed, "identity": trial.identity}
            | {"folder": str(store.folder(trial)), "complete": done}
            for trial, done in zip(trials, complete, strict=True)
        ]
        typer.echo(json.dumps(rows, indent=2))
        return
    for trial, done in zip(trials, complete, strict=True):
        mark = "[green]complete[/]" if done else "[yellow]to run  [/]"
        out.print(f"{mark}  {escape(trial.label)}  [dim]{escape(str(store.folder(trial)))}[/]", soft_wrap=True)
    out.print(f"{len(trials)} trials: {sum(complete)} complete, {len(trials) - sum(complete)} to run")


def results_of(trials: Sequence["Trial"], runs: Path) -> list[Result]:
    """The results of those trials that are complete."""
    store = RunDirectory(runs)
    return [result for trial in trials if (result := store.result(trial)) is not None]


def print_failures(trials: Sequence["Trial"], outcomes: Mapping[int, Outcome], runs: Path) -> int:
    """Name every trial that failed, and where its record is; the exit code is returned."""
    store = RunDirectory(runs)
    failed = {i: outcome for i, outcome in outcomes.items() if outcome.phase is Phase.FAILED}
    for i, outcome in sorted(failed.items()):
        folder = escape(str(store.folder(trials[i])))
        err.print(f"[bold red]failed:[/] {escape(trials[i].label)}: {escape(outcome.message)}", soft_wrap=True)
        err.print(f"        see [bold]{folder}/failure.json[/]", soft_wrap=True)
    if failed:
        say_warning(f"{len(failed)} of {len(trials)} trials failed")
    return FAILED if failed else 0


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
        print_plan(trials, runs, as_json=as_json)
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
