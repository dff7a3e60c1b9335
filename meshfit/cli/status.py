"""`meshfit status`: how experiments stand, and about how long they still take."""

import json
from datetime import UTC, datetime
from typing import Annotated

import typer

from meshfit.cli.options import DEFAULT_RUNS, AsJson, OptionalRunDirs

MOST_LISTED = 20


def status(
    runs: OptionalRunDirs = None,
    every: Annotated[
        bool, typer.Option("--all", help=f"List all that run and all that failed, not just {MOST_LISTED} of a kind.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Say how experiments stand, and about how long is left.

    It tells what is complete, running, failed, interrupted or waiting. It reads the run directory alone, at any
    time, while others write there. Interrupted trials are those that were begun and have not ended: the command that
    ran them goes on with them.

    Examples:
        meshfit status

        meshfit status runs/table1 --all

        watch -n 5 meshfit status  # again every 5 seconds
    """
    from meshfit.cli.status_view import plain_overview, print_overview
    from meshfit.experiment.overview import overview

    now = datetime.now(UTC)
    found = overview(runs or [DEFAULT_RUNS], now)
    if as_json:
        typer.echo(json.dumps([plain_overview(experiment) for experiment in found], indent=2))
    else:
        print_overview(found, now, None if every else MOST_LISTED)
    return 0
