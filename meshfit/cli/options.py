"""Options that several commands have, declared once."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions

SELECTION, EXECUTION, OUTPUT = "Selection", "Execution", "Output"

Runs = Annotated[
    Path,
    typer.Option(
        "--runs", help="Run directory: one folder a trial.", metavar="DIR", autocompletion=completions.folders
    ),
]
RunDirs = Annotated[
    list[Path],
    typer.Argument(help="Run directories, or folders in them.", metavar="RUNS...", autocompletion=completions.folders),
]
OptionalRunDirs = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Run directories, or folders in them.",
        metavar="[RUNS...]",
        show_default="runs",
        autocompletion=completions.folders,
    ),
]
TrialName = Annotated[
    str,
    typer.Argument(
        help="A trial's folder, a file in it, or the first digits of its identity (4 or more).",
        metavar="TRIAL",
        autocompletion=completions.trials,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Override a setting; the value is YAML. May be repeated.",
        metavar="KEY=VALUE",
        rich_help_panel=SELECTION,
        autocompletion=completions.settings,
    ),
]
SchemeConfig = Annotated[
    str | None,
    typer.Option(
        "--config",
        help="Config under whose `define` the scheme may stand.",
        metavar="CONFIG",
        autocompletion=completions.configs,
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Run trials anew that are complete already.", rich_help_panel=SELECTION)
]
DryRun = Annotated[
    bool,
    typer.Option("--dry-run", help="Print the plan and what is complete; run nothing.", rich_help_panel=SELECTION),
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="No progress; errors and the table only.", rich_help_panel=OUTPUT)
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print JSON to stdout, and nothing else there.", rich_help_panel=OUTPUT)
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        min=1,
        help="Trials side by side on the CPU, in place of the config's `jobs`.",
        metavar="N",
        rich_help_panel=EXECUTION,
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Send trials to a Dask cluster: tcp://HOST:PORT, or the scheduler's file. Needs the extra `dask`.",
        metavar="ADDRESS",
        rich_help_panel=EXECUTION,
    ),
]


class TransferChoice(StrEnum):
    """What `meshfit.experiment.running.backends.Transfer` allows, as Typer wants it."""

    AUTO = "auto"
    SHARED = "shared"
    RETURNED = "returned"


Transfer = Annotated[
    TransferChoice,
    typer.Option(
        "--transfer",
        help="For --cluster: workers write to a `shared` directory, or files are `returned`; `auto` looks which.",
        metavar="HOW",
        rich_help_panel=EXECUTION,
    ),
]
DEFAULT_RUNS = Path("runs")
DEFAULT_METRIC = "hausdorff.symmetric"
Metrics = Annotated[
    list[str] | None,
    typer.Option(
        "--metric",
        help="What cells hold, such as distance.mean or quality.self_intersecting_faces. May be repeated.",
        show_default=DEFAULT_METRIC,
        metavar="NAME",
        rich_help_panel=OUTPUT,
        autocompletion=completions.metrics,
    ),
]
Baseline = Annotated[
    str | None,
    typer.Option(
        "--baseline",
        help="Scheme to compare the others with; by default the first.",
        metavar="SCHEME",
        rich_help_panel=OUTPUT,
        autocompletion=completions.fitted_schemes,
    ),
]
