"""`meshfit show`: all that is known of one trial."""

import json
from datetime import UTC, datetime
from typing import Annotated

import typer

from meshfit.cli.options import DEFAULT_RUNS, AsJson, OneTrial, Runs


def show(
    trial: OneTrial,
    runs: Runs = DEFAULT_RUNS,
    every: Annotated[bool, typer.Option("--all", help="Every setting, not only those not at their defaults.")] = False,
    as_json: AsJson = False,
) -> int:
    """Show one trial: state, figures, settings, files, why it failed.

    Examples:
        meshfit show runs/table1/bunny/loop/seed-0-*

        meshfit show 3f9a  # the trial whose identity begins so

        meshfit show 3f9a --all --runs elsewhere
    """
    from meshfit.cli.show_view import plain_trial, print_trial
    from meshfit.experiment.find_trial import find_trial

    now = datetime.now(UTC)
    experiment, found = find_trial(trial, runs, now)
    if as_json:
        typer.echo(json.dumps(plain_trial(experiment, found), indent=2))
    else:
        print_trial(experiment, found, every=every)
    return 0
