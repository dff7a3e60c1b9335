"""`meshfit render`: a picture of meshes or trials side by side."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out


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
) -> int:
    """Draw meshes or trials side by side.

    The folder of a trial gives its source, its result and its target. Each mesh is drawn in the best three-quarter view
    of its target, y up. Named targets are in their tutorial frame. Mesh files are assumed to share one frame, and share
    the view of --against or of the first file. Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit render bunny mousehead -o targets.png
        meshfit render runs/table1/bunny/loop/seed-0-* -o fit.png --edges
        meshfit render loop.ply interp-loop.ply --against bunny -o distances.png
    """
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.render import collect_meshes, write_render

    require_suffix(output)
    meshes, label = collect_meshes(meshes_or_trials, against)
    write_render(meshes, output, edges=edges, label=label)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0
