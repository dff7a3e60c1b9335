"""`meshfit subdivide`: refine one mesh file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.errors import DomainError

if TYPE_CHECKING:
    from meshfit.subdivision.scheme import Scheme

_PARAMETERS = "Parameters of schemes"


def subdivide(
    source: Annotated[
        str,
        typer.Argument(
            help="Mesh or curve file, or name of a target.", metavar="IN", autocompletion=completions.targets
        ),
    ],
    destination: Annotated[
        Path,
        typer.Argument(
            help="File to write; its suffix names the format.", metavar="OUT", autocompletion=completions.meshes
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
        typer.Option("--tension", help="For butterfly, four-point: w.", metavar="W", rich_help_panel=_PARAMETERS),
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
    """Refine a mesh, or curves, by a subdivision scheme.

    A scheme on curves, such as four-point, takes polylines: the `l` lines of an OBJ, or the edges of a PLY.

    Schemes on polygons take faces as they are in the file, and write polygons; the others take them as triangles.

    Examples:
        meshfit subdivide head.obj fine.ply --scheme interp-loop --levels 2

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha 0.5

        meshfit subdivide cube.obj fine.obj -s catmull-clark -n 3

        meshfit subdivide curve.obj smooth.obj -s four-point -n 4
    """
    from meshfit.subdivision.choose import SURFACES, domain_of, scheme_of, schemes_on

    declared = scheme_of(scheme, alpha=alpha, weights=weights, tension=tension, valence3=valence3)
    on_curves = domain_of(declared) == "curves"
    refined = _refined_curves if on_curves else _refined_mesh
    try:
        counts = refined(source, destination, declared, levels)
    except DomainError as error:
        others = f"surfaces: {schemes_on(*SURFACES)}" if on_curves else f"curves: {schemes_on('curves')}"
        raise DomainError(f"{error}; schemes on {others}") from None
    out.print(f"{destination}: {counts}", soft_wrap=True, markup=False)
    return 0


def _refined_mesh(source: str, destination: Path, scheme: "Scheme", levels: int) -> str:
    from meshfit.mesh.files import save_mesh
    from meshfit.mesh.targets import load_polygon_target, load_target
    from meshfit.subdivision.polygon_scheme import PolygonScheme
    from meshfit.subdivision.refine import subdivide

    mesh = load_polygon_target(source) if isinstance(scheme, PolygonScheme) else load_target(source)
    finer = subdivide(mesh, scheme, levels)
    save_mesh(finer, destination)
    return f"{mesh.num_faces:,} faces → {finer.num_faces:,} faces, {finer.num_verts:,} verts"


def _refined_curves(source: str, destination: Path, scheme: "Scheme", levels: int) -> str:
    from meshfit.mesh.curve_files import load_curves, save_curves
    from meshfit.mesh.targets import target_path
    from meshfit.subdivision.refine import subdivide

    curves = load_curves(target_path(source))
    finer = subdivide(curves, scheme, levels)
    save_curves(finer, destination)
    return f"{curves.num_segments:,} segments → {finer.num_segments:,} segments, {finer.num_verts:,} verts"
