"""`meshfit subdivide`: refine one mesh file."""

from math import inf
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import DefinedIn
from meshfit.errors import DomainError

_PARAMETERS, _CREASES, _LIMIT = "Parameters of schemes", "Creases", "The limit surface of loop"


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
            help="Subdivision scheme; see `meshfit schemes`. Or a file that defines one.",
            metavar="SCHEME",
            autocompletion=completions.schemes,
        ),
    ] = "loop",
    config: DefinedIn = None,
    levels: Annotated[
        int, typer.Option("--levels", "-n", min=0, max=10, help="How many times, 0 to 10.", metavar="N")
    ] = 1,
    alpha: Annotated[
        str | None,
        typer.Option(
            "--alpha",
            help="From 0, approximating, to 1, interpolatory, for schemes that have it: one number; or one for each "
            "vertex of IN, from a text file with a number a line or, as attribute:NAME, from a property of IN, a PLY.",
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
    creases: Annotated[
        str | None,
        typer.Option(
            "--creases",
            help="For loop, interp-loop and midpoint. A number: edges stay sharp whose faces make more than so many "
            "degrees. Else a text file, a line each: 'a b' or 'a b sharpness' for an edge, 'a' for a corner; verts are "
            "counted from 0 as IN has them.",
            metavar="ANGLE|FILE",
            rich_help_panel=_CREASES,
        ),
    ] = None,
    sharpness: Annotated[
        float,
        typer.Option(
            "--sharpness",
            help="Levels that creases stay sharp for, such as 1.5, where the file has no other number.",
            metavar="S",
            show_default="for ever",
            rich_help_panel=_CREASES,
        ),
    ] = inf,
    limit: Annotated[
        bool,
        typer.Option(
            "--limit", help="Put verts where Loop subdivision would lead them for ever on.", rich_help_panel=_LIMIT
        ),
    ] = False,
    normals: Annotated[
        bool,
        typer.Option(
            "--normals",
            help="Write the normals of Loop's limit surface with the verts, to PLY or OBJ.",
            rich_help_panel=_LIMIT,
        ),
    ] = False,
) -> int:
    """Refine a mesh, or curves, by a subdivision scheme.

    A scheme on curves, such as four-point, takes polylines: the `l` lines of an OBJ, or the edges of a PLY.

    Schemes on polygons take faces as they are in the file, and write polygons; the others take them as triangles.

    Examples:
        meshfit subdivide head.obj fine.ply --scheme interp-loop --levels 2

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha 0.5

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha alphas.txt  # one for each vertex

        meshfit subdivide part.obj fine.ply -n 3 --creases 40 --sharpness 2  # edges above 40 degrees

        meshfit subdivide part.obj fine.ply -n 3 --creases edges.txt --limit --normals

        meshfit subdivide cube.obj fine.obj -s catmull-clark -n 3

        meshfit subdivide curve.obj smooth.obj -s four-point -n 4

        meshfit subdivide head.obj fine.obj -s my-scheme.yaml
    """
    from meshfit.cli.refining import Wishes, check, number_in, refined_curves, refined_mesh
    from meshfit.config.load import defined_in
    from meshfit.config.scheme_files import adopted
    from meshfit.subdivision.catalogue import catalogue_of
    from meshfit.subdivision.choose import SURFACES, domain_of, scheme_of, schemes_on

    number = number_in(alpha)
    each = alpha if number is None else None
    shared = {"alpha": number if each is None else 1.0, "weights": weights, "tension": tension, "valence3": valence3}
    (spec,), own = adopted([scheme], defined_in(config))
    declared = scheme_of(spec, catalogue_of(own), **shared)
    wishes = Wishes(each, creases, sharpness, limit=limit, normals=normals)
    check(spec, declared, wishes)
    on_curves = domain_of(declared) == "curves"
    try:
        if on_curves:
            counts = refined_curves(source, destination, declared, levels)
        else:
            counts = refined_mesh(source, destination, declared, levels, wishes)
    except DomainError as error:
        others = f"surfaces: {schemes_on(*SURFACES)}" if on_curves else f"curves: {schemes_on('curves')}"
        raise DomainError(f"{error}; schemes on {others}") from None
    out.print(f"{destination}: {counts}", soft_wrap=True, markup=False)
    return 0
