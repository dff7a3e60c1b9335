"""`meshfit subdivide`: refine a mesh or curves, from file to file."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import SchemeConfig
from meshfit.errors import ConfigError, DomainError
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.mesh.io.vertex_values import Values
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Indices, Topology
    from meshfit.subdivision.creases import Creases
    from meshfit.subdivision.registry import Scheme


@dataclass(frozen=True)
class SurfaceOptions:
    """Options of a surface besides scheme and levels.

    Attributes:
        alphas: source of one α per vertex, if there is not one α for all.
        creases: degrees or a file.
        sharpness: of creases.
        limit: move vertices to their limit.
        normals: write limit normals.
    """

    alphas: str | None
    creases: str | None
    sharpness: float
    limit: bool
    normals: bool


def check(name: str, scheme: "Scheme", options: SurfaceOptions) -> None:
    """Refuse options that the scheme does not support, before a mesh is read."""
    from meshfit.subdivision.limit import has_loop_limit
    from meshfit.subdivision.refine import require_takes_creases
    from meshfit.subdivision.registry import domain_of

    if options.creases is not None:
        require_takes_creases(scheme, f"--creases: {name}")
    elif options.sharpness != inf:
        raise ConfigError("--sharpness: goes with --creases, which says where")
    if options.alphas and domain_of(scheme) == "curves":
        raise ConfigError(f"--alpha: {name} refines curves, for which one number is needed")
    for option, wanted in (("--limit", options.limit), ("--normals", options.normals)):
        if wanted and not has_loop_limit(scheme):
            raise ConfigError(f"{option}: limits are known for loop only; found {name}")


def refined_mesh(source: str, destination: Path, scheme: "Scheme", levels: int, options: SurfaceOptions) -> str:
    """Refine a surface from file to file, and return the counts in words."""
    from meshfit.mesh.io.files import save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh
    from meshfit.mesh.targets import load_target_with_vertex_map, target_path
    from meshfit.subdivision.polygons.scheme import PolygonScheme
    from meshfit.subdivision.refine import subdivide

    on_polygons = isinstance(scheme, PolygonScheme)
    mesh, numbering = load_target_with_vertex_map(source, polygons=on_polygons)
    if options.alphas is not None:
        scheme = scheme.with_alpha(_alphas(options.alphas, target_path(source), numbering))
    finer: Mesh | PolygonMesh
    found = ""
    if isinstance(mesh, Mesh):
        finer, found = _creased(mesh, numbering, destination, scheme, levels, options)
    else:
        finer = subdivide(mesh, scheme, levels)
        save_mesh(finer, destination)
    return f"{mesh.num_faces:,} faces → {finer.num_faces:,} faces, {finer.num_verts:,} verts{found}"


def _creased(
    mesh: "Mesh", numbering: "Indices", destination: Path, scheme: "Scheme", levels: int, options: SurfaceOptions
) -> tuple["Mesh", str]:
    """Refine and write triangles; return them, and the counts of creases in words."""
    from meshfit.mesh.io.files import save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.limit import loop_limit, loop_limit_normals
    from meshfit.subdivision.refine import refine
    from meshfit.subdivision.refinement import Refinement

    topology = Topology.of(mesh)
    tagged = None if options.creases is None else _creases(options.creases, options.sharpness, mesh, numbering)
    refinement = refine(topology, scheme, levels, tagged)
    assert isinstance(refinement, Refinement)  # noqa: S101  of triangles
    finer = Mesh(refinement(mesh.verts), refinement.faces)
    directions = loop_limit_normals(finer, scheme, refinement.creases) if options.normals else None
    if options.limit:
        at_limit = loop_limit(Topology.of(finer), scheme, refinement.creases) @ finer.verts
        finer = Mesh(at_limit, finer.faces)
    save_mesh(finer, destination, directions)
    return finer, "" if tagged is None else f"; {_counted(tagged, topology)}"


def refined_curves(source: str, destination: Path, scheme: "Scheme", levels: int) -> str:
    """Refine curves from file to file, and return the counts in words."""
    from meshfit.mesh.io.files import load_curves, save_curves
    from meshfit.mesh.targets import target_path
    from meshfit.subdivision.refine import subdivide

    curves = load_curves(target_path(source))
    finer = subdivide(curves, scheme, levels)
    save_curves(finer, destination)
    return f"{curves.num_segments:,} segments → {finer.num_segments:,} segments, {finer.num_verts:,} verts"


def number_in(text: str | None) -> float | None:
    """Return the number in a text, or None."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _alphas(text: str, mesh_path: Path, numbering: "Indices") -> "Values":
    from meshfit.mesh.io.vertex_values import read_vertex_property, read_vertex_values

    prefix, colon, name = text.partition(":")
    if colon and prefix == "attribute":
        return read_vertex_property(mesh_path, name, numbering, (0.0, 1.0))
    if not Path(text).is_file():
        raise ConfigError(f"--alpha: '{text}' is no number, no file, and no attribute:NAME")
    return read_vertex_values(text, numbering, (0.0, 1.0))


def _creases(text: str, sharpness: float, mesh: "Mesh", numbering: "Indices") -> "Creases":
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.creases import creases_by_angle, read_creases

    if not sharpness >= 0:
        raise ConfigError(f"--sharpness: {sharpness:g} is not allowed: 0 or more is")
    degrees = number_in(text)
    if degrees is not None:
        return creases_by_angle(mesh, degrees, sharpness)
    if not Path(text).is_file():
        raise ConfigError(f"--creases: '{text}' is no number of degrees and no file")
    return read_creases(text, Topology.of(mesh), numbering, sharpness)


def _counted(creases: "Creases", topology: "Topology") -> str:
    edges = int(((creases.sharpness > 0) & ~topology.boundary_edges).sum())
    corners = int((creases.rules(topology).corner > 0).sum())
    return f"{count_text(edges, 'sharp edge')}, {count_text(corners, 'corner')}"


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
    config: SchemeConfig = None,
    levels: Annotated[
        int, typer.Option("--levels", "-n", min=0, max=10, help="How many times, 0 to 10.", metavar="N")
    ] = 1,
    alpha: Annotated[
        str | None,
        typer.Option(
            "--alpha",
            help="From 0, approximating, to 1, interpolatory, for schemes that have it: one number; or one for each "
            "vertex of IN, from a text file with one number per line or, as attribute:NAME, from a property of a PLY.",
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
            help="For loop, interp-loop and midpoint. A number of degrees: edges with a larger angle between faces are "
            "sharp. Or a text file with one entry per line: 'a b' or 'a b sharpness' for an edge, 'a' for a corner; "
            "vertices are counted from 0 in the order of IN.",
            metavar="ANGLE|FILE",
            rich_help_panel=_CREASES,
        ),
    ] = None,
    sharpness: Annotated[
        float,
        typer.Option(
            "--sharpness",
            help="Number of levels for which creases stay sharp, such as 1.5, unless the file gives another.",
            metavar="S",
            show_default="permanent",
            rich_help_panel=_CREASES,
        ),
    ] = inf,
    limit: Annotated[
        bool,
        typer.Option("--limit", help="Project vertices onto the Loop limit surface.", rich_help_panel=_LIMIT),
    ] = False,
    normals: Annotated[
        bool,
        typer.Option(
            "--normals",
            help="Write the normals of Loop's limit surface with the vertices, to PLY or OBJ.",
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
    from meshfit.config.loading import load_definitions
    from meshfit.config.scheme_files import resolve_specs
    from meshfit.subdivision.registry import SURFACES, domain_of, registry_with, resolve, schemes_on

    number = number_in(alpha)
    each = alpha if number is None else None
    shared = {"alpha": number if each is None else 1.0, "weights": weights, "tension": tension, "valence3": valence3}
    (spec,), own = resolve_specs([scheme], load_definitions(config))
    declared = resolve(spec, registry_with(own), **shared)
    options = SurfaceOptions(each, creases, sharpness, limit=limit, normals=normals)
    check(spec, declared, options)
    on_curves = domain_of(declared) == "curves"
    try:
        if on_curves:
            counts = refined_curves(source, destination, declared, levels)
        else:
            counts = refined_mesh(source, destination, declared, levels, options)
    except DomainError as error:
        others = f"surfaces: {schemes_on(*SURFACES)}" if on_curves else f"curves: {schemes_on('curves')}"
        raise DomainError(f"{error}; schemes on {others}") from None
    out.print(f"{destination}: {counts}", soft_wrap=True, markup=False)
    return 0
