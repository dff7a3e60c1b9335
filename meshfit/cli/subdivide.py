"""`meshfit subdivide`: refine one mesh file."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out

_PARAMETERS = "Parameters of schemes"


def subdivide(
    source: Annotated[
        str,
        typer.Argument(help="Mesh file or name of a target.", metavar="IN", autocompletion=completions.targets),
    ],
    destination: Annotated[
        Path,
        typer.Argument(
            help="Mesh file to write; its suffix names the format.", metavar="OUT", autocompletion=completions.meshes
        ),
    ],
    scheme: Annotated[
        str,
        typer.Option(
            "--scheme",
            "-s",
            help="Subdivision scheme; see `meshfit schemes`.",
            metavar="SCHEME",
            autocompletion=completions.schemes,
        ),
    ] = "loop",
    levels: Annotated[
        int, typer.Option("--levels", "-n", min=0, max=10, help="How many times, 0 to 10.", metavar="N")
    ] = 1,
    alpha: Annotated[
        float | None,
        typer.Option(
            "--alpha",
            help="For interpolatory schemes: from 0, approximating, to 1.",
            metavar="A",
            rich_help_panel=_PARAMETERS,
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights", help="For Loop's vertex rule: loop or warren.", metavar="NAME", rich_help_panel=_PARAMETERS
        ),
    ] = None,
    tension: Annotated[
        float | None,
        typer.Option("--tension", help="For butterfly: w.", metavar="W", rich_help_panel=_PARAMETERS),
    ] = None,
    valence3: Annotated[
        str | None,
        typer.Option(
            "--valence3",
            help="For interp-loop: displacement or zorin.",
            metavar="NAME",
            rich_help_panel=_PARAMETERS,
        ),
    ] = None,
) -> int:
    """Refine a mesh by a subdivision scheme.

    Schemes on polygons take faces as they are in the file, and write polygons; the others take them as triangles.

    Examples:
        meshfit subdivide head.obj fine.ply --scheme interp-loop --levels 2

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha 0.5

        meshfit subdivide cube.obj fine.obj -s catmull-clark -n 3
    """
    from meshfit.mesh.files import save_mesh
    from meshfit.mesh.targets import load_polygon_target, load_target
    from meshfit.subdivision.choose import scheme_of
    from meshfit.subdivision.polygon_scheme import PolygonScheme
    from meshfit.subdivision.refine import subdivide as refined

    declared = scheme_of(scheme, alpha=alpha, weights=weights, tension=tension, valence3=valence3)
    mesh = load_polygon_target(source) if isinstance(declared, PolygonScheme) else load_target(source)
    finer = refined(mesh, declared, levels)
    save_mesh(finer, destination)
    counts = f"{mesh.num_faces:,} faces → {finer.num_faces:,} faces, {finer.num_verts:,} verts"
    out.print(f"{destination}: {counts}", soft_wrap=True, markup=False)
    return 0
