"""The `meshfit` command. Heavy libraries are imported by the commands that need them, not here."""

import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from meshfit.cli import (
    clean,
    compare,
    expect,
    export,
    figure,
    init,
    measure,
    render,
    report,
    run,
    schema,
    schemes,
    show,
    status,
    subdivide,
    table,
    targets,
)
from meshfit.cli.console import EXIT_INTERRUPTED, exit_code_of, out, say_error

USAGE_ERROR = 2

app = typer.Typer(
    name="meshfit",
    help="Batch mesh-deformation experiments: fit a subdivided source mesh to a target, measure it, print the table.",
    epilog="Start here:  meshfit run quickstart   ·   meshfit compare loop interp-loop   ·   meshfit init",
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
EXPERIMENTS, RUNS, MESHES, LOOK_UP = "Experiments", "Looking after runs", "Single meshes", "Look up"
for panel, name, command in (
    (EXPERIMENTS, "run", run.run),
    (EXPERIMENTS, "compare", compare.compare),
    (EXPERIMENTS, "table", table.table),
    (EXPERIMENTS, "figure", figure.figure),
    (EXPERIMENTS, "report", report.report),
    (EXPERIMENTS, "expect", expect.expect),
    (EXPERIMENTS, "init", init.init),
    (RUNS, "status", status.status),
    (RUNS, "show", show.show),
    (RUNS, "export", export.export),
    (RUNS, "clean", clean.clean),
    (MESHES, "subdivide", subdivide.subdivide),
    (MESHES, "measure", measure.measure),
    (MESHES, "render", render.render),
    (LOOK_UP, "schemes", schemes.schemes),
    (LOOK_UP, "targets", targets.targets),
    (LOOK_UP, "schema", schema.schema),
):
    app.command(name, rich_help_panel=panel)(command)


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
        out.print(context.get_help())


def run_app() -> int:
    """Run the command line; the exit code is returned."""
    try:
        result = app(standalone_mode=False)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "meshfit"
        say_error(f"{' '.join(error.format_message().split())} See '{command} --help'.")
        return USAGE_ERROR
    except typer.Abort:
        return EXIT_INTERRUPTED
    if result == EXIT_INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0


def main() -> None:
    """The console script."""
    sys.exit(exit_code_of(run_app))
