"""`meshfit render`: a picture of meshes side by side."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out


def render(
    meshes: Annotated[
        list[str], typer.Argument(help="Mesh files or names of targets; TITLE=FILE gives a title.", metavar="MESH...")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The PNG to write.")],
    edges: Annotated[bool, typer.Option("--edges", help="Draw the edges of faces too.")] = False,
    normalise: Annotated[
        bool,
        typer.Option("--normalise", help="Put each mesh in its own tutorial frame, to set targets beside results."),
    ] = False,
) -> int:
    """Draw meshes side by side from one view, y up. Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit render bunny -o bunny.png

        meshfit render source.ply result.ply target=bunny.obj -o fit.png --edges
    """
    from meshfit.mesh.frames import frame_of
    from meshfit.mesh.targets import load_target, target_title
    from meshfit.report.pictures import draw_row

    titled = {}
    for text in meshes:
        title, equals, name = text.rpartition("=")
        mesh = load_target(name)
        titled[title if equals else target_title(name)] = (
            frame_of(mesh.verts, "tutorial").normalise(mesh) if normalise else mesh
        )
    draw_row(titled, output, edges=edges)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0
