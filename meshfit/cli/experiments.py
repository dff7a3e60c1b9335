"""Run the missing trials of a plan, print the table of all trials, and list the failures."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from itertools import islice
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from meshfit.cli.console import EXIT_FAILED, err, out, print_warning, warn_once, working
from meshfit.cli.early_warnings import EarlyWarnings
from meshfit.cli.options import RunOptions
from meshfit.cli.progress import show_progress
from meshfit.cli.table import check_display, show_tables
from meshfit.errors import TrialError
from meshfit.experiment.plan import Trial
from meshfit.experiment.running.backends import LocalWorkers
from meshfit.experiment.running.scheduler import Watcher, require_runnable, run_trials
from meshfit.experiment.status.eta import Estimate, estimate
from meshfit.experiment.status.measured_otherwise import find_measured_otherwise
from meshfit.experiment.status.missing import missing_results
from meshfit.experiment.status.scan import scan_experiments
from meshfit.experiment.storage.checkpoint import snapshots_in
from meshfit.experiment.storage.copying import copy_complete, find_complete
from meshfit.experiment.storage.folder_checks import check_folders
from meshfit.experiment.storage.plan_file import in_planned_order
from meshfit.experiment.storage.result import read_result_or_warn
from meshfit.experiment.storage.run_directory import FAILURE, RESULT, Result, RunDirectory, damage, make_folder
from meshfit.experiment.trial_status import Outcome, TrialStatus
from meshfit.paths import file_stem, shell_path
from meshfit.report.tables.grouping import distinguish_definitions, without_numbers
from meshfit.units import count_text, duration_text

if TYPE_CHECKING:
    from meshfit.experiment.running.backends import Remote

_MOST_LISTED = 1000
_MOST_LISTED_PER_REASON = 20
_MOST_TARGETS = 3


def run_and_report(trials: Sequence[Trial], options: RunOptions) -> int:
    """Run the trials that are not complete, print the table of all, and list the failures.

    A dry run only prints the plan.

    Returns:
        The exit code.
    """
    store = RunDirectory(options.runs)
    check_display(trials, options.metrics, options.baseline)
    check_folders(trials, store)
    _warn_of_damage(trials, store)
    _warn_of_unusable(trials)
    if not options.force:
        _name_complete_fits(trials, store, options)
    if options.dry_run:
        _print_plan(trials, store, options)
        return 0
    external = [trial for trial in trials if trial.settings.fit.method == "external"]
    complete = [None] * len(external) if options.force else find_complete(external, store)
    to_run = [trial for trial, folder in zip(external, complete, strict=True) if folder is None]
    require_runnable(to_run, allow_commands=options.allow_commands, here=options.cluster is None)
    if not options.force:
        _copy_complete(trials, store, quiet=options.quiet)
        _warn_of_missing_snapshots(trials, store)
    early = EarlyWarnings(trials, store)
    outcomes = _run_missing(trials, store, options, None if options.as_json else early)
    results = _results_of(trials, store)
    if options.as_json:
        typer.echo(json.dumps(_plain_results(results), indent=2))
    elif results:
        _show_warnings(results, early.shown)
        records = [*results, *_missing(trials, results, store)]
        records = distinguish_definitions(in_planned_order(records))
        show_tables(records, options.metrics, baseline=options.baseline)
        folders = dict.fromkeys(str(options.runs / trial.experiment) for trial in trials)
        out.print(f"\nResults: {', '.join(folders)}", soft_wrap=True, markup=False)
        if doubtful := sum(not result.get("verdict", {}).get("sound", True) for result in results):
            text = f"Verdict: {doubtful} of {count_text(len(results), 'result')} doubtful, marked † with what is wrong"
            out.print(text, soft_wrap=True, markup=False)
    return _print_failures(trials, outcomes, store)


def _copy_complete(trials: Sequence[Trial], store: RunDirectory, *, quiet: bool) -> None:
    """Copy trials that are complete in other experiments, and say how many."""
    names = copy_complete(trials, store)
    for name, count in sorted(Counter(names).items()):
        if not quiet:
            err.print(f"copied {count_text(count, 'complete trial')} of {name}", soft_wrap=True, markup=False)


def _name_complete_fits(trials: Sequence[Trial], store: RunDirectory, options: RunOptions) -> None:
    """Name trials that other settings of the measurement make new ones, and the command that measures them instead."""
    for experiment, changes, count in find_measured_otherwise(trials, store) if not options.quiet else ():
        listed = ", ".join(f"measure.{key} was {json.dumps(before)}" for key, before, _ in changes)
        settings = " ".join(f"--set measure.{key}={value}" for key, _, value in changes)
        again = f"meshfit measure --again {shell_path(store.root / experiment)} {settings}"
        new = "is a new trial" if count == 1 else "are new trials"
        text = f"{count_text(count, 'trial')} with a complete fit {new}, as {listed}; to keep the fits: {again}"
        err.print(text, soft_wrap=True, markup=False)


def _print_plan(trials: Sequence[Trial], store: RunDirectory, options: RunOptions) -> None:
    found = find_complete(trials, store)
    complete = [folder is not None for folder in found]
    chosen = [trial for trial, done in zip(trials, complete, strict=True) if options.force or not done]
    to_run = [trial for trial in chosen if not trial.fault]
    unusable = len(chosen) - len(to_run)
    time = None if options.cluster is not None else estimated(trials, to_run, store, options.jobs, quiet=options.quiet)
    if options.as_json:
        rows = [
            {"target": trial.target, "scheme": trial.scheme, "variant": trial.variant, "seed": trial.seed}
            | {"identity": trial.identity, "folder": str(folder or store.folder(trial)), "complete": folder is not None}
            | ({"fault": trial.fault} if trial.fault else {})
            for trial, folder in zip(trials, found, strict=True)
        ]
        plain_time = None if time is None else asdict(time)
        counts = {"complete": sum(complete), "to_run": len(to_run), "unusable": unusable, "estimate": plain_time}
        typer.echo(json.dumps({"trials": rows} | counts, indent=2))
        return
    for trial, folder in islice(zip(trials, found, strict=True), _MOST_LISTED):
        mark = "[red]unusable[/]" if trial.fault else "[magenta]to run  [/]"
        mark = "[green]complete[/]" if folder is not None else mark
        out.print(f"{mark}  {escape(trial.label)}  {escape(str(folder or store.folder(trial)))}", soft_wrap=True)
    if len(trials) > _MOST_LISTED:
        out.print(f"and {len(trials) - _MOST_LISTED:,} more, which --json lists")
    targets = f", {unusable} whose target cannot be used" if unusable else ""
    out.print(f"{count_text(len(trials), 'trial')}: {sum(complete):,} complete, {len(to_run):,} to run{targets}")
    if time is not None:
        workers = count_text(time.workers, "worker")
        known = None if time.seconds is None else f"about {duration_text(time.seconds)} on {workers}"
        parts = [f"{known}, estimated from {time.basis}" if known else "time not estimated", time.left_out]
        out.print("; ".join(filter(None, parts)))


def estimated(
    trials: Sequence[Trial], to_run: Sequence[Trial], store: RunDirectory, jobs: int | None, *, quiet: bool = False
) -> Estimate | None:
    """Return about how long trials take, from complete ones or a probe; None, with a warning, if the probe fails."""
    results = [(trial, result) for trial in trials if (result := store.result(trial)) is not None]
    try:
        with working("probing how long a trial takes", quiet=quiet):
            return estimate(to_run, results, jobs=jobs)
    except TrialError as error:
        print_warning(f"no time estimate, because the probed trial failed: {error}")
        return None


def _warn_of_damage(trials: Sequence[Trial], store: RunDirectory) -> None:
    for trial in trials:
        if (reason := damage(store.folder(trial) / RESULT)) is not None:
            print_warning(f"{reason}; the trial is repeated")


def _warn_of_unusable(trials: Sequence[Trial]) -> None:
    for fault, count in Counter(trial.fault for trial in trials if trial.fault).items():
        print_warning(f"{fault} ({'1 trial fails' if count == 1 else f'{count} trials fail'}, the others run)")


def _warn_of_missing_snapshots(trials: Sequence[Trial], store: RunDirectory) -> None:
    complete = [trial for trial in trials if trial.settings.fit.snapshots is not None and store.is_complete(trial)]
    without = sum(not snapshots_in(store.folder(trial)) for trial in complete)
    if without:
        trials_have = "1 completed trial has" if without == 1 else f"{without} completed trials have"
        print_warning(f"{trials_have} none of the requested snapshots; --force reruns them and takes snapshots")


def _run_missing(
    trials: Sequence[Trial], store: RunDirectory, options: RunOptions, early: EarlyWarnings | None
) -> dict[int, Outcome]:
    make_folder(options.runs)
    with show_progress(trials, quiet=options.quiet) as watch:
        return run_trials_of(trials, store, options, watch if early is None else early.watching(watch))


def run_trials_of(
    trials: Sequence[Trial],
    store: RunDirectory,
    options: RunOptions,
    watch: Watcher,
    local: LocalWorkers | None = None,
) -> dict[int, Outcome]:
    """Run the trials that are not complete where the options say, and return the outcome of each.

    Processes of this machine are those of `local`, or new ones.
    """
    with _remote(options) as remote:
        return run_trials(
            trials,
            store,
            jobs=options.jobs,
            force=options.force,
            remote=remote,
            local=local,
            allow_commands=options.allow_commands,
            watch=watch,
        )


@contextmanager
def _remote(options: RunOptions) -> Iterator["Remote | None"]:
    if options.cluster is None:
        yield None
        return
    from meshfit.experiment.running.dask_backend import DaskRemote

    remote = DaskRemote(options.cluster, transfer=options.transfer)
    try:
        yield remote
    finally:
        remote.close()


def _results_of(trials: Sequence[Trial], store: RunDirectory) -> list[Result]:
    results = [read_result_or_warn(store.folder(trial)) for trial in trials]
    return distinguish_definitions(in_planned_order(result for result in results if result is not None))


def _missing(trials: Sequence[Trial], results: Sequence[Result], store: RunDirectory) -> list[Result]:
    """Return a record of each trial without a result."""
    if len(results) == len(trials):
        return []
    folders = {str(store.folder(trial)) for trial in trials}
    experiments = dict.fromkeys(store.root / trial.experiment for trial in trials)
    scanned = scan_experiments(list(experiments), datetime.now(UTC), required=False)
    return [record for record in missing_results(scanned, results) if record["folder"] in folders]


def _show_warnings(results: Sequence[Result], shown: Set[tuple[str, str]]) -> None:
    """Show the warnings of trials, each once; those that differ in numbers alone are the same one.

    Shortfalls are left to the notes of the table.

    Args:
        results: of the trials.
        shown: the target and the text, without numbers, of warnings that have been shown.
    """
    trials = Counter(result["target"] for result in results)
    alike: dict[str, list[tuple[str, str]]] = {}
    for result in results:
        for text in dict.fromkeys(result.get("warnings", ())):
            if text in result.get("shortfalls", ()) or (result["target"], without_numbers(text)) in shown:
                continue
            if file_stem(text.partition(": ")[0]) == result["target"]:
                warn_once(text)  # it names the target's file
            else:
                alike.setdefault(without_numbers(text), []).append((result["target"], text))
    for cases in alike.values():
        targets = list(dict.fromkeys(target for target, _ in cases))
        more = len(targets) - _MOST_TARGETS
        named = ", ".join(targets[:_MOST_TARGETS]) + (f" and {count_text(more, 'more target')}" if more > 0 else "")
        total = sum(trials[target] for target in targets)
        share = f" ({len(cases)} of {total} trials)" if len(cases) < total else ""
        warn_once(f"{named}: {cases[0][1]}{share}")


def _plain_results(results: Sequence[Result]) -> list[Result]:
    """Return results without what was added when they were read."""
    return [
        {key: value for key, value in result.items() if key not in ("folder", "place", "target_key")}
        for result in results
    ]


def _print_failures(trials: Sequence[Trial], outcomes: Mapping[int, Outcome], store: RunDirectory) -> int:
    """List failed trials by reason, each with the file that records it, and return the exit code."""
    failed = [i for i, outcome in sorted(outcomes.items()) if outcome.status is TrialStatus.FAILED]
    if not failed:
        return 0
    err.print(f"[bold red]{len(failed)} of {len(trials)} trials failed[/]")
    width = max(len(trials[i].label) for i in failed)
    for message in dict.fromkeys(outcomes[i].message for i in failed):
        same = [i for i in failed if outcomes[i].message == message]
        err.print(escape(message), soft_wrap=True)
        for i in same[:_MOST_LISTED_PER_REASON]:
            record = escape(str(store.folder(trials[i]) / FAILURE))
            err.print(f"  {escape(trials[i].label.ljust(width))}  {record}", soft_wrap=True)
        if len(same) > _MOST_LISTED_PER_REASON:
            where = escape(shell_path(store.root / trials[same[0]].experiment))
            err.print(f"  and {len(same) - _MOST_LISTED_PER_REASON} more: meshfit status {where} --all", soft_wrap=True)
    return EXIT_FAILED
