"""The plan that `--dry-run` prints: what would be run, what of it is complete, and how long the rest will take."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from meshfit.cli.console import err, out, say_warning
from meshfit.errors import TrialError
from meshfit.experiment.store import RunDirectory
from meshfit.report.amounts import duration

if TYPE_CHECKING:
    from meshfit.experiment.estimate import Estimate
    from meshfit.experiment.plan import Trial


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
        out.print(f"about {duration(found.seconds)} on {workers}, going by {found.basis}")


def _estimate(
    trials: Sequence["Trial"], left: Sequence["Trial"], store: RunDirectory, jobs: int | None
) -> "Estimate | None":
    from meshfit.experiment.estimate import estimate

    results = [(trial, result) for trial in trials if (result := store.result(trial)) is not None]
    try:
        with err.status("probing how long a trial takes"):
            return estimate(left, results, jobs=jobs)
    except TrialError as error:
        say_warning(f"no estimate of time, since the trial that was probed failed: {error}")
        return None
