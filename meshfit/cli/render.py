"""`meshfit render`: a picture of meshes or trials side by side."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import OUTPUT, UpAxis, say_turned


def render(
    meshes_or_trials: Annotated[
        list[str],
        typer.Argument(
            help="Mesh files, named targets, or folders of trials, each optionally as TITLE=….",
            metavar="MESH_OR_TRIAL",
            autocompletion=completions.meshes_or_trials,
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Picture to write: .png, .pdf or .svg.", metavar="FILE")
    ],
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            help="Colour meshes by their distance to this target.",
            metavar="TARGET",
            autocompletion=completions.targets,
        ),
    ] = None,
    edges: Annotated[bool, typer.Option("--edges", help="Draw the edges of faces too.")] = False,
    size: Annotated[
        str | None,
        typer.Option(
            "--size",
            help="Size of each picture in pixels.",
            show_default="2.6 inches square, 520 pixels in a PNG",
            metavar="WIDTHxHEIGHT",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option(
            "--columns",
            min=1,
            help="Pictures side by side.",
            show_default="up to 4",
            metavar="N",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    view: Annotated[
        str,
        typer.Option(
            "--view",
            help="best, front, back, left, right, top, bottom, or AZIMUTH,ELEVATION in degrees.",
            metavar="VIEW",
            rich_help_panel=OUTPUT,
        ),
    ] = "best",
    up: UpAxis = None,
    background: Annotated[
        str,
        typer.Option("--background", help="A colour, or transparent.", metavar="COLOUR", rich_help_panel=OUTPUT),
    ] = "white",
) -> int:
    """Draw meshes or trials side by side.

    The folder of a trial gives its source, its result and its target. Each mesh is drawn in the best three-quarter view
    of its target, with y up, or z where it stands on a base along z. Named targets are in their tutorial frame. Mesh
    files are assumed to share one frame, and share the view of --against or of the first file.
    Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit render bunny mousehead -o targets.png
        meshfit render runs/table1/bunny/loop/seed-0-* -o fit.png --edges
        meshfit render loop.ply interp-loop.ply --against bunny -o distances.png
        meshfit render scan.stl -o scan.png --up z --view 30,20 --size 1200x900 --background transparent
    """
    from meshfit.report.figures.layout import parse_background, require_suffix
    from meshfit.report.figures.render import RenderStyle, collect_meshes, parse_size, turned_meshes, write_render

    require_suffix(output)
    pixels = None if size is None else parse_size(size)
    style = RenderStyle(edges, pixels, columns, view, up, parse_background(background))
    meshes, label = collect_meshes(meshes_or_trials, against)
    write_render(meshes, output, style=style, label=label)
    say_turned(turned_meshes(meshes, up))
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0
