"""The `meshfit` command line. Each command's module is imported only when the command is used."""

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from meshfit.cli.console import EXIT_INTERRUPTED, EXIT_USAGE, exit_code_of, out, print_error
from meshfit.cli.fit_command import fit_command, is_config_name, is_mesh_name
from meshfit.cli.options import DEFAULT_RUNS
from meshfit.cli.streams import make_streams_safe
from meshfit.errors import ConfigError
from meshfit.images.folders import is_image_folder
from meshfit.paths import is_folder, path_text, shell_path

COMMANDS = {
    "Experiments": {
        "run": "Run experiments and print their table.",
        "compare": "Compare subdivision schemes, paired by seed.",
        "tune": "Search for the settings that are best by a metric.",
        "sensitivity": "Show which settings move a metric, and by how much.",
        "table": "Print the result table of run directories.",
        "figure": "Draw a figure of some runs for a paper, with its caption.",
        "chart": "Draw the results of some runs as a chart, and print the means.",
        "report": "Write some runs as one self-contained HTML page.",
        "expect": "Write expected values for `meshfit table --check`.",
        "init": "Write a starter config that explains every setting.",
    },
    "Run management": {
        "status": "Show experiment status and time remaining.",
        "show": "Show one trial: status, metrics, settings, files, failure.",
        "save": "Write the result of a trial in any mesh format.",
        "animate": "Write a video of a fit, or from shape to shape.",
        "export": "Export one row per trial with all metrics and settings.",
        "clean": "Remove failed and interrupted trials.",
    },
    "Single meshes": {
        "fit": "Fit a mesh to a target, from file to file.",
        "subdivide": "Refine a mesh, or curves, by a subdivision scheme.",
        "measure": "Measure a mesh against a target.",
        "render": "Draw meshes or trials side by side.",
        "view": "Look at meshes and results in 3D, in the web browser.",
        "views": "Render views of a mesh, as a folder of images to fit to.",
    },
    "Reference": {
        "schemes": "List the subdivision schemes, or show or analyse one.",
        "targets": "List the named targets.",
        "schema": "Print the JSON Schema of a config, for editors.",
    },
}
"""Commands by panel of the help, each with a summary. A command is the function in the module of its name."""

_PANELS = {name: panel for panel, summaries in COMMANDS.items() for name in summaries}

_WORDS_FOR_FIT = (
    *("fti", "ift", "fits", "fitt", "fitting", "deform", "register", "registration", "wrap", "shrinkwrap", "morph"),
    *("remesh", "warp", "match", "nricp"),
)

HELP = """Fit a subdivided source mesh to target shapes, measure it, print the table.

A config is targets × schemes × seeds over one set of settings.
Completed trials are never run twice.

Examples:
    meshfit fit bunny -o fitted.obj  # one mesh, and a verdict on it
    meshfit run quickstart   # two targets, two schemes, in under 2 minutes
    meshfit init my.yaml     # writes a config for an experiment of your own
    meshfit table runs/my --format latex
    meshfit run --help       # the options of a command, with examples
"""

WELCOME = """\
[bold]meshfit[/] fits a source mesh, refined by a subdivision scheme of your choice, to
target shapes, measures the result, and prints the table.

[bold]Start here[/]
  meshfit fit bunny -o fitted.obj  # fits one mesh; any mesh file works too
  meshfit run quickstart  # two animals, two schemes, in under 2 minutes
  meshfit compare loop interp-loop --config quickstart  # compares two schemes
  meshfit init  # writes a config for an experiment of your own

[bold]Then[/]
  meshfit --help  # all commands
  meshfit run --help  # one command, with examples
  meshfit targets  # the named targets; any mesh file works too
  meshfit --install-completion  # lets the Tab key complete all this"""


_SETTINGS: dict[str, Any] = {
    "rich_markup_mode": "rich",
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def _style_help() -> None:
    """Remove dim text and yellow, unreadable on some backgrounds, from Typer's help, and limit its width."""
    from typer import rich_utils

    for name, style in vars(rich_utils).copy().items():
        if name.startswith("STYLE_") and isinstance(style, str):
            setattr(rich_utils, name, style.replace("dim", "").replace("yellow", "magenta").strip())
    rich_utils.MAX_WIDTH = min(out.width, 110)
    rich_utils.FORCE_TERMINAL = None  # as everywhere else: a terminal, or FORCE_COLOR


class Command(TyperCommand):
    """A command whose help is readable on every background."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  Typer's types are not public
        """Print the help."""
        _style_help()
        super().format_help(ctx, formatter)


class Group(TyperGroup):
    """The group of all commands, of which only the one used is imported."""

    def __init__(self, **attributes: Any) -> None:  # noqa: ANN401  passed on to Typer
        super().__init__(**attributes | {"commands": Commands()})

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002  Typer's signature
        """Return the names of all commands."""
        return list(_PANELS)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401  Typer's types are not public
        """Find the command; a mesh, or another word for a fit, in place of one gets the command to type.

        Raises:
            ConfigError: it is one of those.
        """
        name = args[0]
        if name not in _PANELS:
            if is_mesh_name(name):
                raise ConfigError(f"{path_text(name)} is a mesh, not a command; to fit it: {fit_command(args)}")
            if is_config_name(name):
                command = f"meshfit run {shell_path(name)}"
                raise ConfigError(f"{path_text(name)} is a config, not a command; to run it: {command}")
            if is_folder(name):
                raise ConfigError(f"{path_text(name)} is a folder, not a command; {_for_folder(name)}")
            if name.lower() in _WORDS_FOR_FIT:
                raise ConfigError(f"no command '{name}'; to fit a mesh: {fit_command(args[1:])}")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  Typer's types are not public
        """Print the help from the summaries of commands, without importing them."""
        self.commands = {
            name: TyperCommand(name, short_help=summary, rich_help_panel=panel)
            for panel, summaries in COMMANDS.items()
            for name, summary in summaries.items()
        }
        _style_help()
        super().format_help(ctx, formatter)


class Commands(Mapping[str, Any]):
    """All commands by name, each imported when it is looked up."""

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401  Typer's types are not public
        panel = _PANELS[name]
        function = getattr(import_module(f"meshfit.cli.{name}"), name)
        app = typer.Typer(**_SETTINGS, add_completion=False)
        decorate = app.command(
            name, cls=Command, help=help_text(function), short_help=COMMANDS[panel][name], rich_help_panel=panel
        )
        decorate(function)
        return typer.main.get_command(app)

    def __iter__(self) -> Iterator[str]:
        return iter(_PANELS)

    def __len__(self) -> int:
        return len(_PANELS)


def _for_folder(name: str) -> str:
    if any(is_mesh_name(str(path)) for path in Path(name).iterdir()):
        return f"to fit its meshes: meshfit fit {shell_path(name.rstrip('/'))}/* -o fitted/"
    if is_image_folder(Path(name)):
        return f"to fit a mesh to its images: meshfit fit {shell_path(name)} -o fitted.obj"
    return f"to show its trials: meshfit status {shell_path(name)}"


def _finding(command: str, message: str) -> str:
    """Return the message of a usage error; one of `fit` without its mesh or file names the whole command to type."""
    if command.endswith(" fit") and message.startswith(("Missing argument", "Missing option")):
        words = sys.argv[sys.argv.index("fit") + 1 :] if "fit" in sys.argv else []
        if configs := [word for word in words if is_config_name(word)]:
            command = f"meshfit run {shell_path(configs[0])}"
            return f"{path_text(configs[0])} is a config, not a mesh; to run it: {command}."
        missing = "give the mesh to fit" if message.startswith("Missing argument") else "give the file to write"
        return f"{missing}: {fit_command([word for word in words if not word.startswith('-')])}."
    return f"{message}{'' if message.endswith(('.', '?')) else '.'}"


def help_text(command: Callable[..., int]) -> str:
    """Return a command's docstring as rich markup: paragraphs on one line each, examples as they are."""
    paragraphs = escape(inspect.getdoc(command) or "").split("\n\n")
    return "\n\n".join(text if text.startswith(("Example", " ")) else text.replace("\n", " ") for text in paragraphs)


app = typer.Typer(name="meshfit", help=HELP, cls=Group, **_SETTINGS)


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
        out.print(WELCOME)
        if DEFAULT_RUNS.is_dir():
            out.print(f"  meshfit status  # progress of the experiments in {DEFAULT_RUNS}/")


def run_app() -> int:
    """Run the command line and return the exit code."""
    try:
        result = app(standalone_mode=False)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "meshfit"
        message = " ".join(error.format_message().replace("Value error, ", "").split())
        print_error(f"{_finding(command, message)} See '{command} --help'.")
        return EXIT_USAGE
    except typer.Abort:
        return EXIT_INTERRUPTED
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):  # which Typer takes for a failure
            raise error.__context__ from None
        raise
    if result == EXIT_INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0


def main() -> None:
    """Run the console script."""
    make_streams_safe()
    sys.exit(exit_code_of(run_app))
