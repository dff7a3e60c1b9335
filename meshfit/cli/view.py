"""`meshfit view`: meshes and results in 3D, in the web browser."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import UpAxis, say_turned


def view(
    runs_or_meshes: Annotated[
        list[str],
        typer.Argument(
            help="Run directories, folders of trials, mesh files or named targets, the latter optionally as TITLE=….",
            metavar="RUN_OR_MESH",
            autocompletion=completions.meshes_or_trials,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="HTML file to write, rather than to open it.",
            show_default="a temporary file, opened in the browser",
            metavar="FILE",
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            help="Colour meshes by their distance to this target.",
            metavar="TARGET",
            autocompletion=completions.targets,
        ),
    ] = None,
    up: UpAxis = None,
) -> int:
    """Look at meshes and results in 3D, in the web browser.

    Views turn together. A run directory gives each target with the result of every scheme; meshes are side by side. The
    page is a single file that loads nothing from the network. Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit view scan.ply result.ply
        meshfit view result.ply --against scan.ply
        meshfit view runs/table1 -o table1.html
    """
    import tempfile
    import webbrowser

    from meshfit.errors import ConfigError
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.html.view_page import collect_scenes, render_view
    from meshfit.units import size_text

    if output is not None and not output.parent.is_dir():
        raise ConfigError(f"{output}: cannot be written: no folder {output.parent}")
    scenes = collect_scenes(runs_or_meshes, against, up)
    if not scenes:
        raise ConfigError(f"{', '.join(runs_or_meshes)}: no mesh to show; no trial is complete")
    title = ", ".join(Path(name.rpartition("=")[2]).name for name in runs_or_meshes)
    page = render_view(scenes, title).encode()
    path = output if output is not None else Path(tempfile.mkdtemp(prefix="meshfit-")) / "view.html"
    write_atomically(path, page)
    say_turned([scene.turned for scene in scenes if scene.turned])
    opened = output is None and webbrowser.open(path.resolve().as_uri())
    remedy = "" if opened or output is not None else "; open it in a browser"
    out.print(f"wrote {path}: {size_text(len(page))}{remedy}", soft_wrap=True, markup=False)
    return 0
