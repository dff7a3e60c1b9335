"""`meshfit subdivide`: refine one mesh file."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.errors import ConfigError

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Indices, Topology
    from meshfit.mesh.vertex_values import Values
    from meshfit.subdivision.creases import Creases

_PARAMETERS, _CREASES, _LIMIT = "Parameters of schemes", "Creases", "The limit surface of loop"


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
    """Refine a mesh by a subdivision scheme.

    Examples:
        meshfit subdivide head.obj fine.ply --scheme interp-loop --levels 2

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha 0.5

        meshfit subdivide head.obj fine.obj -s interp-loop --alpha alphas.txt  # one for each vertex

        meshfit subdivide part.obj fine.ply -n 3 --creases 40 --sharpness 2  # edges above 40 degrees

        meshfit subdivide part.obj fine.ply -n 3 --creases edges.txt --limit --normals
    """
    from meshfit.mesh.files import save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.targets import load_numbered_target, target_path
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.choose import scheme_of
    from meshfit.subdivision.limit import loop_limit
    from meshfit.subdivision.limit_normals import loop_limit_normals
    from meshfit.subdivision.refine import refine, require_takes_creases

    number = _number(alpha)
    each = alpha is not None and number is None
    declared = scheme_of(scheme, alpha=1.0 if each else number, weights=weights, tension=tension, valence3=valence3)
    if creases is not None:
        require_takes_creases(declared, f"--creases: {scheme}")
    elif sharpness != inf:
        raise ConfigError("--sharpness: goes with --creases, which says where")
    mesh, numbering = load_numbered_target(source)
    if alpha is not None and each:
        declared = declared.with_alpha(_alphas(alpha, target_path(source), numbering))
    topology = Topology.of(mesh)
    tagged = None if creases is None else _creases(creases, sharpness, mesh, numbering)
    refinement = refine(topology, declared, levels, tagged)
    finer = Mesh(refinement(mesh.verts), refinement.faces)
    directions = loop_limit_normals(finer, declared, refinement.creases) if normals else None
    if limit:
        at_limit = loop_limit(Topology.of(finer), declared, refinement.creases) @ finer.verts
        finer = Mesh(at_limit, finer.faces)
    save_mesh(finer, destination, directions)
    counts = f"{mesh.num_faces:,} faces → {finer.num_faces:,} faces, {finer.num_verts:,} verts"
    found = "" if tagged is None else f"; {_counted(tagged, topology)}"
    out.print(f"{destination}: {counts}{found}", soft_wrap=True, markup=False)
    return 0


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _alphas(text: str, mesh_path: Path, numbering: "Indices") -> "Values":
    from meshfit.mesh.vertex_values import read_attribute, read_values

    prefix, colon, name = text.partition(":")
    if colon and prefix == "attribute":
        return read_attribute(mesh_path, name, numbering, (0.0, 1.0))
    if not Path(text).is_file():
        raise ConfigError(f"--alpha: '{text}' is no number, no file, and no attribute:NAME")
    return read_values(text, numbering, (0.0, 1.0))


def _creases(text: str, sharpness: float, mesh: "Mesh", numbering: "Indices") -> "Creases":
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.crease_files import read_creases
    from meshfit.subdivision.creases import creases_by_angle

    if not sharpness >= 0:
        raise ConfigError(f"--sharpness: {sharpness:g} is not allowed: 0 or more is")
    degrees = _number(text)
    if degrees is not None:
        return creases_by_angle(mesh, degrees, sharpness)
    if not Path(text).is_file():
        raise ConfigError(f"--creases: '{text}' is no number of degrees and no file")
    return read_creases(text, Topology.of(mesh), numbering, sharpness)


def _counted(creases: "Creases", topology: "Topology") -> str:
    edges = int(((creases.sharpness > 0) & ~topology.boundary_edges).sum())
    corners = int((creases.rules(topology).corner > 0).sum())
    return f"{edges:,} sharp edge{'' if edges == 1 else 's'}, {corners:,} corner{'' if corners == 1 else 's'}"
