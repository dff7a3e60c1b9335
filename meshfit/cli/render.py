"""`meshfit render`: a picture of meshes, or of trials, side by side."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out


def render(
    what: Annotated[
        list[str],
        typer.Argument(
            help="Mesh files, names of targets, or folders of trials; TITLE=… gives a title.",
            metavar="WHAT...",
            autocompletion=completions.meshes_or_trials,
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The picture to write: .png, .pdf or .svg.", metavar="FILE")
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
) -> int:
    """Draw meshes, or trials, side by side.

    The folder of a trial stands for its source, its result and its target. Each mesh is seen from three quarters, y up,
    from where its target looks best; named targets are in their tutorial frame, mesh files are taken to share one, and
    the view of --against, or of the first. Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit render bunny mousehead -o targets.png

        meshfit render runs/table1/bunny/loop/seed-0-* -o fit.png --edges

        meshfit render loop.ply interp-loop.ply --against bunny -o distances.png
    """
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.render import draw_row, scene_of

    require_suffix(output)
    row, label = scene_of(what, against)
    draw_row(row, output, edges=edges, label=label)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0
