"""Options that several commands have, declared once."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

Runs = Annotated[Path, typer.Option("--runs", help="Run directory: one folder a trial.", metavar="DIR")]
RunDirs = Annotated[list[Path], typer.Argument(help="Run directories, or folders in them.", metavar="RUNS...")]
OptionalRunDirs = Annotated[
    list[Path] | None,
    typer.Argument(help="Run directories, or folders in them.", metavar="[RUNS...]", show_default="runs"),
]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override a setting; the value is YAML. May be repeated.", metavar="KEY=VALUE"),
]
Force = Annotated[bool, typer.Option("--force", help="Run trials anew that are complete already.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print the plan, and what of it is complete; run nothing.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress; errors and the table only.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON to stdout, and nothing else there.")]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", min=1, help="Trials side by side on the CPU, in place of the config's `jobs`."),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Send trials to a Dask cluster: tcp://HOST:PORT, or the scheduler's file. Needs the extra `dask`.",
        metavar="ADDRESS",
    ),
]


class TransferChoice(StrEnum):
    """What `meshfit.experiment.remote.Transfer` allows, as Typer wants it."""

    AUTO = "auto"
    SHARED = "shared"
    RETURNED = "returned"


Transfer = Annotated[
    TransferChoice,
    typer.Option(
        "--transfer", help="For --cluster: workers write to a shared directory, or return files; auto looks which."
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
    ),
]
Baseline = Annotated[
    str | None,
    typer.Option("--baseline", help="Scheme to compare the others with; by default the first.", metavar="SCHEME"),
]
