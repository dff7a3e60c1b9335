"""Options that several commands share."""

import functools
import gc
import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import err
from meshfit.errors import ConfigError, FormatError, MeshError
from meshfit.measuring.metrics import DEFAULT_METRIC, DEFAULT_METRIC_OF_CLOUDS, DEFAULT_METRIC_OF_IMAGES, metric_named

SELECTION, EXECUTION, OUTPUT = "Selection", "Execution", "Output"
FORMATS, CLEANING = "File formats", "Cleaning of mesh files"
DEFAULT_RUNS = Path("runs")
_OBJECTS_PER_COLLECTION = 200_000

Runs = Annotated[
    Path,
    typer.Option(
        "--runs", help="Run directory: one folder per trial.", metavar="DIR", autocompletion=completions.folders
    ),
]
_RunDirs = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Run directories, or folders in them.",
        metavar="RUNS",
        show_default="runs",
        autocompletion=completions.folders,
    ),
]
_RunDirsByOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--runs",
        help="The same as RUNS. May be repeated.",
        show_default=False,
        metavar="DIR",
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
SchemeConfig = Annotated[
    str | None,
    typer.Option(
        "--config",
        help="Config whose `define` section may define the scheme.",
        metavar="CONFIG",
        autocompletion=completions.configs,
    ),
]
MeshFormat = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="Format of a mesh that is read from - (standard input), a pipe, or a file whose suffix does not tell it.",
        metavar="FORMAT",
        rich_help_panel=FORMATS,
        autocompletion=completions.formats,
    ),
]
OutputFormat = Annotated[
    str | None,
    typer.Option(
        "--output-format",
        help="Format of OUT in place of its suffix; needed for - (standard output).",
        metavar="FORMAT",
        rich_help_panel=FORMATS,
        autocompletion=completions.output_formats,
    ),
]
Weld = Annotated[
    float,
    typer.Option(
        "--weld",
        min=0.0,
        help="Join boundary vertices up to this distance, in the unit of the file.",
        show_default="equal positions only",
        metavar="DISTANCE",
        rich_help_panel=CLEANING,
    ),
]
RepairMode = Annotated[
    Literal["split", "refuse"],
    typer.Option(
        "--repair",
        help="Where a mesh is not manifold: split separates the faces, refuse leaves them.",
        metavar="MODE",
        rich_help_panel=CLEANING,
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Hide progress.", rich_help_panel=OUTPUT)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.", rich_help_panel=OUTPUT)]


def split_metrics(texts: list[str] | None) -> list[str] | None:
    """Return the metrics that are given by `--metric a,b`, or by a group's name alone; None if there are none."""
    names = [metric_named(name.strip()) for text in texts or () for name in text.split(",") if name.strip()]
    return list(dict.fromkeys(names)) or None


def _one_metric(text: str | None) -> str | None:
    if text is None:
        return None
    if "," in text:
        raise ConfigError(f"--metric {text}: expected one metric here, got several")
    return metric_named(text.strip())


_DEFAULT_METRICS = f"{DEFAULT_METRIC}; {DEFAULT_METRIC_OF_CLOUDS} for points; {DEFAULT_METRIC_OF_IMAGES} for masks"

Metrics = Annotated[
    list[str] | None,
    typer.Option(
        "--metric",
        help="Metric in the cells, such as distance.mean,quality.self_intersecting_faces. May be repeated.",
        show_default=_DEFAULT_METRICS,
        metavar="NAME,...",
        rich_help_panel=OUTPUT,
        autocompletion=completions.listed_metrics,
        callback=split_metrics,
    ),
]
Metric = Annotated[
    str | None,
    typer.Option(
        "--metric",
        help="Metric to draw, such as distance.mean.",
        show_default=_DEFAULT_METRICS,
        metavar="NAME",
        rich_help_panel=OUTPUT,
        autocompletion=completions.metrics,
        callback=_one_metric,
    ),
]
AnalysedMetric = Annotated[
    str | None,
    typer.Option(
        "--metric",
        help="Metric to analyse, such as distance.mean.",
        show_default=DEFAULT_METRIC,
        metavar="NAME",
        rich_help_panel=SELECTION,
        autocompletion=completions.metrics,
        callback=_one_metric,
    ),
]
Baseline = Annotated[
    str | None,
    typer.Option(
        "--baseline",
        help="Scheme to compare the others with.",
        show_default="the first",
        metavar="SCHEME",
        rich_help_panel=OUTPUT,
        autocompletion=completions.fitted_schemes,
    ),
]


Labels = Annotated[
    list[str] | None,
    typer.Option(
        "--label",
        help="Name to print for a scheme, target or metric, such as interp-loop='Interp. Loop'. May be repeated.",
        metavar="NAME=LABEL",
        rich_help_panel=OUTPUT,
    ),
]
Partial = Annotated[
    bool,
    typer.Option("--partial", help="Exit with 0 though planned trials have no result.", rich_help_panel=OUTPUT),
]
UpAxis = Annotated[
    Literal["auto", "x", "y", "z"] | None,
    typer.Option(
        "--up",
        help="The axis that points up: x, y or z; auto is y, or z where the mesh stands on a base along z.",
        show_default="view.up of the experiment, or auto",
        metavar="AXIS",
        rich_help_panel=OUTPUT,
    ),
]
Targets = Annotated[
    str | None,
    typer.Option(
        "--targets",
        help="Targets, comma-separated; replaces the config's.",
        metavar="A,B",
        rich_help_panel=SELECTION,
        autocompletion=completions.listed_targets,
    ),
]
Schemes = Annotated[
    str | None,
    typer.Option(
        "--schemes",
        help="Schemes, comma-separated; replaces the config's.",
        metavar="A,B",
        rich_help_panel=SELECTION,
        autocompletion=completions.listed_schemes,
    ),
]
ExperimentName = Annotated[
    str | None,
    typer.Option(
        "--name",
        help="Name of the experiment, whose folder in the run directory gets the trials.",
        show_default="the config's; with other targets or schemes, one that lists them",
        metavar="NAME",
        rich_help_panel=SELECTION,
    ),
]
Seeds = Annotated[
    str | None,
    typer.Option(
        "--seeds",
        help="N for seeds 0 to N-1, or a comma-separated list such as 4,7; replaces the config's.",
        metavar="N",
        rich_help_panel=SELECTION,
    ),
]


@dataclass(frozen=True)
class RunOptions:
    """The options of commands that run trials, each declared as Typer reads it."""

    runs: Runs = DEFAULT_RUNS
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Override a setting; the value is YAML, or a list such as a.obj,b.obj; paths are relative to the "
            "current directory. May be repeated.",
            metavar="KEY=VALUE",
            rich_help_panel=SELECTION,
            autocompletion=completions.settings,
        ),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Rerun completed trials.", rich_help_panel=SELECTION)] = False
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Print the plan and what is complete; run nothing.", rich_help_panel=SELECTION),
    ] = False
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            help="Trials that run in parallel on the CPU; replaces the config's `jobs`.",
            metavar="N",
            rich_help_panel=EXECUTION,
        ),
    ] = None
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            help="Send trials to a Dask cluster: tcp://HOST:PORT or the scheduler file. Requires the extra `dask`.",
            metavar="ADDRESS",
            rich_help_panel=EXECUTION,
        ),
    ] = None
    transfer: Annotated[
        Literal["auto", "shared", "returned"],
        typer.Option(
            "--transfer",
            help="With --cluster: workers write to a `shared` directory, or files are `returned`; `auto` decides.",
            metavar="MODE",
            rich_help_panel=EXECUTION,
        ),
    ] = "auto"
    allow_commands: Annotated[
        bool,
        typer.Option(
            "--allow-commands",
            help="Run the programs that the config names in fit.command. They may do what you may.",
            rich_help_panel=EXECUTION,
        ),
    ] = False
    metrics: Metrics = None
    baseline: Baseline = None
    quiet: Quiet = False
    as_json: AsJson = False


def say_turned(titles: Sequence[str]) -> None:
    """Say which meshes are drawn with z up because they seem to stand that way."""
    if titles:
        names = ", ".join(dict.fromkeys(titles))
        remedy = "to change it: --up y, or view.up in the config"
        err.print(f"z up, guessed by the base: {names}; {remedy}", soft_wrap=True, markup=False)


@contextmanager
def suggest_option(option: str) -> Iterator[None]:
    """Let errors about the format of a mesh file name an option that gives it."""
    try:
        yield
    except FormatError as error:
        if error.file_format is None:
            raise
        raise MeshError(f"{error}{', or' if error.remedy else ';'} give {option} {error.file_format}") from None


def takes_run_options(*omitted: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Add the options of `RunOptions` to a command, which gets them as one parameter named `options`.

    Args:
        *omitted: names of those that the command does without, or declares itself.
    """

    def decorate(command: Callable[..., int]) -> Callable[..., int]:
        every = inspect.signature(RunOptions).parameters.values()
        shared = [parameter for parameter in every if parameter.name not in omitted]
        own = [parameter for parameter in inspect.signature(command).parameters.values() if parameter.name != "options"]

        @functools.wraps(command)
        def with_options(**values: Any) -> int:  # noqa: ANN401  as declared above
            options = RunOptions(**{parameter.name: values.pop(parameter.name) for parameter in shared})
            return command(**values, options=options)

        _declare(with_options, [parameter.replace(kind=parameter.KEYWORD_ONLY) for parameter in (*own, *shared)])
        return with_options

    return decorate


def takes_run_dirs(command: Callable[..., int]) -> Callable[..., int]:
    """Let a command take its `runs` as arguments or by `--runs`, with `runs` as the default; it gets a list."""
    declared = [
        parameter.replace(kind=parameter.KEYWORD_ONLY)
        for parameter in inspect.signature(command).parameters.values()
        if parameter.name != "runs"
    ]
    by_argument, by_option = (
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
        for name, annotation in (("runs", _RunDirs), ("runs_option", _RunDirsByOption))
    )

    @functools.wraps(command)
    def with_run_dirs(**values: Any) -> int:  # noqa: ANN401  as declared above
        runs, option = values.pop("runs"), values.pop("runs_option")
        if runs and option:
            raise ConfigError("expected run directories as arguments or by --runs, got both")
        with _rare_collection():
            return command(**values, runs=runs or option or [DEFAULT_RUNS])

    _declare(with_run_dirs, [by_argument, *declared, by_option])
    return with_run_dirs


@contextmanager
def _rare_collection() -> Iterator[None]:
    """Look for cycles of garbage rarely: thousands of results have none, and the search takes a fifth of the time."""
    thresholds = gc.get_threshold()
    gc.set_threshold(_OBJECTS_PER_COLLECTION, *thresholds[1:])
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)


def _declare(command: Callable[..., int], parameters: Sequence[inspect.Parameter]) -> None:
    """Give a command the parameters that Typer is to read."""
    setattr(command, "__signature__", inspect.Signature(parameters))  # noqa: B010  mypy does not know it
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
