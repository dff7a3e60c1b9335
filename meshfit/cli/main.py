"""The `meshfit` command. Heavy libraries are imported by the commands that need them, not here."""

import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from meshfit.cli import (
    animate,
    chart,
    clean,
    export,
    figure,
    measure,
    render,
    report,
    run,
    schemes,
    show,
    status,
    subdivide,
    table,
    targets,
)
from meshfit.cli import config as init
from meshfit.cli import config as schema
from meshfit.cli import run as compare
from meshfit.cli import table as expect
from meshfit.cli.console import EXIT_INTERRUPTED, exit_code_of, out, print_error
from meshfit.cli.help import Command, Group, print_examples
from meshfit.cli.options import DEFAULT_RUNS

USAGE_ERROR = 2

HELP = """Fit a source mesh, refined by a subdivision scheme, to target shapes; measure it; print the table.

A config is targets × schemes × seeds over one set of settings. What is complete is never run twice.

Examples:
    meshfit run quickstart  # two targets, two schemes, in under 2 minutes

    meshfit run my.yaml  # an experiment of your own; meshfit init writes one

    meshfit table runs/my --format latex

    meshfit run --help  # the options of a command, with examples
"""

app = typer.Typer(
    name="meshfit",
    help=HELP,
    cls=Group,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
EXPERIMENTS, RUNS, MESHES, LOOK_UP = "Experiments", "Looking after runs", "Single meshes", "Look up"
for panel, name, command in (
    (EXPERIMENTS, "run", run.run),
    (EXPERIMENTS, "compare", compare.compare),
    (EXPERIMENTS, "table", table.table),
    (EXPERIMENTS, "figure", figure.figure),
    (EXPERIMENTS, "chart", chart.chart),
    (EXPERIMENTS, "report", report.report),
    (EXPERIMENTS, "expect", expect.expect),
    (EXPERIMENTS, "init", init.init),
    (RUNS, "status", status.status),
    (RUNS, "show", show.show),
    (RUNS, "animate", animate.animate),
    (RUNS, "export", export.export),
    (RUNS, "clean", clean.clean),
    (MESHES, "subdivide", subdivide.subdivide),
    (MESHES, "measure", measure.measure),
    (MESHES, "render", render.render),
    (LOOK_UP, "schemes", schemes.schemes),
    (LOOK_UP, "targets", targets.targets),
    (LOOK_UP, "schema", schema.schema),
):
    app.command(name, cls=Command, rich_help_panel=panel)(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        out.print(f"meshfit {version('meshfit')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  eager: its callback acts
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print_welcome()


def run_app() -> int:
    """Run the command line; the exit code is returned."""
    try:
        result = app(standalone_mode=False)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "meshfit"
        said = " ".join(error.format_message().replace("Value error, ", "").split())
        print_error(f"{said}{'' if said.endswith(('.', '?')) else '.'} See '{command} --help'.")
        return USAGE_ERROR
    except typer.Abort:
        return EXIT_INTERRUPTED
    if result == EXIT_INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0


def main() -> None:
    """The console script."""
    sys.exit(exit_code_of(run_app))


def print_welcome() -> None:
    """A screen for someone who sees it for the first time."""
    out.print("[bold]meshfit[/] fits a source mesh, refined by a subdivision scheme of your choice, to")
    out.print("target shapes, measures how well that went, and prints the table.")
    first = ["meshfit run quickstart  # two animals, two schemes, in under 2 minutes"]
    first += ["meshfit compare loop interp-loop --config quickstart  # two schemes compared"]
    first += ["meshfit init  # writes a config for an experiment of your own"]
    print_examples(first, "Start here")
    then = ["meshfit --help  # all commands"]
    then += ["meshfit run --help  # one of them, with examples"]
    then += ["meshfit targets  # what can be fitted to; any mesh file, too"]
    then += ["meshfit --install-completion  # let the Tab key complete all this"]
    if DEFAULT_RUNS.is_dir():
        then.insert(0, f"meshfit status  # how the experiments in {DEFAULT_RUNS}/ stand")
    print_examples(then, "Then")
