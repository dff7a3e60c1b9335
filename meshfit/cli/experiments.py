"""What `run` and `compare` share: run the trials that are missing, say what failed, and print tables."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from meshfit.cli.console import err, out, say_warning
from meshfit.cli.options import DEFAULT_METRIC
from meshfit.errors import ConfigError
from meshfit.experiment.progress import Outcome, Phase
from meshfit.experiment.store import Result, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

FAILED = 1


def run_missing(
    trials: Sequence["Trial"], runs: Path, *, jobs: int | None, force: bool, quiet: bool
) -> dict[int, Outcome]:
    """Run what is not complete, with progress shown."""
    from meshfit.cli.progress import shown_progress
    from meshfit.experiment.executor import run_trials

    make_folder(runs)
    with shown_progress(trials, quiet=quiet) as watch:
        return run_trials(trials, RunDirectory(runs), jobs=jobs, force=force, watch=watch)


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
    metrics: Sequence[str] | None,
    *,
    baseline: str | None = None,
    format_name: str = "rich",
    planned: bool = False,
) -> None:
    """Print the tables of some results to stdout."""
    from meshfit.report.formats import FORMATS
    from meshfit.report.formats.rich_text import SheetsView
    from meshfit.report.gather import target_key
    from meshfit.report.sheet import arrange
    from meshfit.report.table import build_tables

    # The config's order, which is the order that trials were planned in.
    schemes = dict.fromkeys(result["scheme"] for result in results) if planned else ()
    targets = dict.fromkeys(map(target_key, results)) if planned else ()
    order = {"schemes": list(schemes), "targets": list(targets)}
    wanted = dict.fromkeys(metrics or [DEFAULT_METRIC])
    tables = [table for metric in wanted for table in build_tables(results, metric, baseline=baseline, **order)]
    sheets = arrange(tables, planned=planned)
    if format_name == "rich":
        out.print(SheetsView(sheets))
    else:
        typer.echo(FORMATS[format_name](sheets), nl=False)


def check_display(trials: Sequence["Trial"], metrics: Sequence[str] | None, baseline: str | None) -> None:
    """Refuse, before anything is run, what could not be shown once it has been.

    Raises:
        ConfigError: no such metric, or a baseline that is not among the planned schemes.
        SchemeError: the baseline is not a scheme.
    """
    from meshfit.report.table import require_metric
    from meshfit.specs import suggest
    from meshfit.subdivision.choose import canonical

    for metric in metrics or ():
        require_metric(metric)
    planned = dict.fromkeys(trial.scheme for trial in trials)
    if baseline is not None and canonical(baseline) not in planned:
        raise ConfigError(f"baseline '{baseline}' is not among the schemes: {suggest(canonical(baseline), planned)}")


def run_and_report(
    trials: Sequence["Trial"],
    runs: Path,
    metrics: Sequence[str] | None,
    *,
    baseline: str | None,
    jobs: int | None,
    force: bool,
    dry_run: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run what is missing, print the table of all trials, name those that failed; the exit code is returned.

    A dry run only says what would be run.
    """
    check_display(trials, metrics, baseline)
    if dry_run:
        print_plan(trials, runs, as_json=as_json)
        return 0
    outcomes = run_missing(trials, runs, jobs=jobs, force=force, quiet=quiet)
    results = results_of(trials, runs)
    if as_json:
        typer.echo(json.dumps(results, indent=2))
    elif results:
        for note in dict.fromkeys(f"{result['target']}: {text}" for result in results for text in result["warnings"]):
            say_warning(note)
        show_tables(results, metrics, baseline=baseline, planned=True)
        folders = dict.fromkeys(str(runs / trial.experiment) for trial in trials)
        out.print(f"\nResults: {', '.join(folders)}", style="dim", soft_wrap=True, markup=False)
    return print_failures(trials, outcomes, runs)
