"""`meshfit subdivide`: refine a mesh or curves, from file to file."""

import os
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import err, out
from meshfit.cli.options import MeshFormat, OutputFormat, RepairMode, SchemeConfig, Weld, suggest_option
from meshfit.errors import ConfigError, DomainError
from meshfit.memory import available_memory
from meshfit.paths import (
    STDOUT_PATHS,
    is_pipe,
    is_regular_file,
    looks_like_path,
    not_a_file_message,
    path_text,
    quoted_path,
)
from meshfit.units import count_text, size_text

if TYPE_CHECKING:
    from meshfit.mesh.cleaning import VertexMap
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.io.mesh_file import MeshFile
    from meshfit.mesh.io.vertex_values import Values
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.creases import Creases
    from meshfit.subdivision.registry import Scheme

_MOST_FACES = 10_000_000
"""The most faces that are made without being asked for twice."""
# The peak while refining and writing, measured up to a million faces: 290 to 480 a triangle, 520 to 1450 a polygon.
_BYTES_PER_TRIANGLE, _BYTES_PER_POLYGON = 450, 1000
_PARAMETERS, _CREASES, _LIMIT = "Scheme parameters", "Creases", "Loop limit surface"


@dataclass(frozen=True)
class _Files:
    """The file that is read, and the one that is written.

    Attributes:
        source: name of the mesh or curve file, or of a target.
        content: its content.
        destination: path of the file to write.
        output_format: its format, in place of its suffix.
    """

    source: str
    content: "MeshFile"
    destination: str
    output_format: str | None


@dataclass(frozen=True)
class _SurfaceOptions:
    """Options that apply to surfaces only.

    Attributes:
        alphas: source of one α per vertex; None if one α serves all.
        creases: an angle in degrees, or a file.
        sharpness: of the creases, in levels.
        cleaning: of the mesh file.
        yes: whether to make more faces than `_MOST_FACES`.
        limit: whether to move vertices to their limit.
        normals: whether to write limit normals.
    """

    alphas: str | None
    creases: str | None
    sharpness: float
    cleaning: "CleaningOptions"
    yes: bool
    limit: bool
    normals: bool


def _check(name: str, scheme: "Scheme", options: _SurfaceOptions) -> None:
    """Refuse options that the scheme does not support, before a mesh is read."""
    from meshfit.subdivision.limit import has_loop_limit
    from meshfit.subdivision.refine import require_takes_creases
    from meshfit.subdivision.registry import domain_of

    if options.creases is not None:
        require_takes_creases(scheme, f"--creases: {name}")
    elif options.sharpness != inf:
        raise ConfigError("--sharpness applies to creases only; choose them with --creases")
    if options.alphas is not None and domain_of(scheme) == "curves":
        raise ConfigError(f"--alpha: {name} refines curves; expected one number, got '{options.alphas}'")
    for option, wanted in (("--limit", options.limit), ("--normals", options.normals)):
        if wanted and not has_loop_limit(scheme):
            raise ConfigError(f"{option}: the limit surface is known for loop only, not for {name}")


def _refine_surface(files: _Files, scheme: "Scheme", levels: int, options: _SurfaceOptions) -> str:
    """Refine a surface from file to file, and return a summary of the counts."""
    from meshfit.mesh.io.files import save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh
    from meshfit.mesh.targets import load_target_with_vertex_map
    from meshfit.subdivision.polygons.scheme import PolygonScheme
    from meshfit.subdivision.refine import subdivide

    on_polygons = isinstance(scheme, PolygonScheme)
    mesh, vertex_map = load_target_with_vertex_map(
        files.source, options.cleaning, polygons=on_polygons, file=files.content
    )
    _check_size(mesh, scheme, levels, yes=options.yes)
    if options.alphas is not None:
        scheme = scheme.with_alpha(_alphas(options.alphas, files.content, vertex_map))
    finer: Mesh | PolygonMesh
    creases = ""
    if isinstance(mesh, Mesh):
        finer, creases = _refine_triangles(mesh, vertex_map, files, scheme, levels, options)
    else:
        finer = subdivide(mesh, scheme, levels)
        save_mesh(finer, files.destination, file_format=files.output_format)
    before, after = count_text(mesh.num_faces, "face"), count_text(finer.num_faces, "face")
    return f"{before} → {after}, {count_text(finer.num_verts, 'vertex')}{creases}"


def _check_size(mesh: "Mesh | PolygonMesh", scheme: "Scheme", levels: int, *, yes: bool) -> None:
    """Say how many faces, and how much memory, a very fine mesh takes, and refuse to make it without `--yes`."""
    from meshfit.mesh.mesh import Mesh
    from meshfit.subdivision.growth import num_faces_after

    count = num_faces_after(mesh, scheme, levels)
    if count <= _MOST_FACES:
        return
    memory = count * (_BYTES_PER_TRIANGLE if isinstance(mesh, Mesh) else _BYTES_PER_POLYGON)
    free = available_memory()
    of_free = "" if free is None else f" (free: {size_text(free)})"
    needs = f"{count_text(levels, 'level')}: about {count:,} faces, {size_text(memory)} of memory{of_free}"
    if not yes:
        raise ConfigError(f"{needs}; choose fewer --levels, or give --yes to make them")
    err.print(needs, soft_wrap=True, markup=False)


def _refine_triangles(
    mesh: "Mesh", vertex_map: "VertexMap", files: _Files, scheme: "Scheme", levels: int, options: _SurfaceOptions
) -> tuple["Mesh", str]:
    """Refine and write triangles; return them and a summary of their creases."""
    from meshfit.mesh.io.files import save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.limit import loop_limit_normals, on_loop_limit
    from meshfit.subdivision.refine import Refinement, refine, refined_mesh

    topology = Topology.of(mesh)
    creases = None if options.creases is None else _creases(options.creases, options.sharpness, mesh, vertex_map)
    refinement = refine(topology, scheme, levels, creases)
    assert isinstance(refinement, Refinement)  # noqa: S101  of triangles
    finer = refined_mesh(mesh, scheme, refinement, creases)
    assert isinstance(finer, Mesh)  # noqa: S101
    normals = loop_limit_normals(finer, scheme, refinement.creases) if options.normals else None
    if options.limit:
        finer = on_loop_limit(finer, scheme, refinement.creases)
    save_mesh(finer, files.destination, normals, file_format=files.output_format)
    return finer, "" if creases is None else f"; {_crease_counts(creases, topology)}"


def _refine_curves(files: _Files, scheme: "Scheme", levels: int) -> str:
    """Refine curves from file to file, and return a summary of the counts."""
    from meshfit.mesh.io.files import load_curves, save_curves
    from meshfit.subdivision.refine import subdivide

    curves = load_curves(files.content)
    finer = subdivide(curves, scheme, levels)
    save_curves(finer, files.destination, file_format=files.output_format)
    before, after = count_text(curves.num_segments, "segment"), count_text(finer.num_segments, "segment")
    return f"{before} → {after}, {count_text(finer.num_verts, 'vertex')}"


def _number(text: str | None) -> float | None:
    """Return the number that a text is; None for any other text."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _alphas(text: str, mesh_file: "MeshFile", vertex_map: "VertexMap") -> "Values":
    from meshfit.mesh.io.vertex_values import read_vertex_property, read_vertex_values

    prefix, colon, name = text.partition(":")
    if colon and prefix == "attribute":
        return read_vertex_property(mesh_file, name, vertex_map, (0.0, 1.0))
    _require_text_file(text, "--alpha: expected a number, a file or attribute:NAME")
    return read_vertex_values(text, vertex_map, (0.0, 1.0))


def _creases(text: str, sharpness: float, mesh: "Mesh", vertex_map: "VertexMap") -> "Creases":
    from meshfit.mesh.topology import Topology
    from meshfit.subdivision.creases import creases_by_angle, read_creases

    if not sharpness >= 0:
        raise ConfigError(f"--sharpness: expected 0 or more, got {sharpness:g}")
    degrees = _number(text)
    if degrees is not None:
        return creases_by_angle(mesh, degrees, sharpness)
    _require_text_file(text, "--creases: expected a number of degrees or a file")
    return read_creases(text, Topology.of(mesh), vertex_map, sharpness)


def _require_text_file(text: str, expected: str) -> None:
    """Refuse a text that is not the path of a file or pipe."""
    if is_regular_file(text) or is_pipe(text):
        return
    problem = f": {not_a_file_message(text, ('.txt',))}" if looks_like_path(text) or os.path.lexists(text) else ""
    raise ConfigError(f"{expected}, got {quoted_path(text)}{problem}")


def _crease_counts(creases: "Creases", topology: "Topology") -> str:
    edges = int(((creases.sharpness > 0) & ~topology.boundary_edges).sum())
    corners = int((creases.rules(topology).corner > 0).sum())
    return f"{count_text(edges, 'sharp edge')}, {count_text(corners, 'corner')}"


def subdivide(
    source: Annotated[
        str,
        typer.Argument(
            help="Mesh or curve file, or name of a target; - is standard input.",
            metavar="IN",
            autocompletion=completions.targets,
        ),
    ],
    destination: Annotated[
        str,
        typer.Argument(
            help="File to write; its suffix names the format. - is standard output.",
            metavar="OUT",
            autocompletion=completions.meshes,
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
        int, typer.Option("--levels", "-n", min=0, max=10, help="Number of refinement levels, 0 to 10.", metavar="N")
    ] = 1,
    alpha: Annotated[
        str | None,
        typer.Option(
            "--alpha",
            help="From 0 (approximating) to 1 (interpolatory), for schemes with this parameter. One number; or one "
            "per vertex of IN, from a text file with one number per line, or attribute:NAME for a property of a PLY.",
            metavar="A",
            rich_help_panel=_PARAMETERS,
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights", help="Vertex weights of loop: loop or warren.", metavar="NAME", rich_help_panel=_PARAMETERS
        ),
    ] = None,
    tension: Annotated[
        float | None,
        typer.Option("--tension", help="w of butterfly and four-point.", metavar="W", rich_help_panel=_PARAMETERS),
    ] = None,
    valence3: Annotated[
        str | None,
        typer.Option(
            "--valence3",
            help="Rule of interp-loop at valence 3: displacement or zorin.",
            metavar="NAME",
            rich_help_panel=_PARAMETERS,
        ),
    ] = None,
    creases: Annotated[
        str | None,
        typer.Option(
            "--creases",
            help="Sharp edges, for loop, interp-loop and midpoint. Either an angle in degrees: edges whose faces meet "
            "at a larger angle are sharp. Or a text file with one entry per line: 'a b' or 'a b sharpness' for an "
            "edge, 'a' for a corner; vertices are counted from 0 in the order of IN.",
            metavar="ANGLE|FILE",
            rich_help_panel=_CREASES,
        ),
    ] = None,
    sharpness: Annotated[
        float,
        typer.Option(
            "--sharpness",
            help="Number of levels for which creases stay sharp, such as 1.5; the file may override it by edge.",
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
            help="Write vertex normals of the Loop limit surface (PLY and OBJ only).",
            rich_help_panel=_LIMIT,
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help=f"Make the mesh even if it has more than {_MOST_FACES:,} faces.")
    ] = False,
    input_format: MeshFormat = None,
    output_format: OutputFormat = None,
    weld: Weld = 0.0,
    repair: RepairMode = "split",
) -> int:
    """Refine a mesh, or curves, by a subdivision scheme.

    Schemes on curves, such as four-point, read polylines: the `l` lines of an OBJ, or the edges of a PLY.

    Schemes on polygons keep the faces of the file and write polygons; schemes on triangles triangulate them.

    Texture coordinates, colours, materials and skin weights are refined too, with the seams of textures kept.

    Files may be compressed, as in head.ply.gz.

    Examples:
        meshfit subdivide head.obj fine.ply --scheme interp-loop --levels 2
        meshfit subdivide head.obj fine.obj -s interp-loop --alpha 0.5
        meshfit subdivide head.obj fine.obj -s interp-loop --alpha alphas.txt  # one per vertex
        meshfit subdivide part.obj fine.ply -n 3 --creases 40 --sharpness 2  # edges above 40 degrees
        meshfit subdivide part.obj fine.ply -n 3 --creases edges.txt --limit --normals
        meshfit subdivide cube.obj fine.obj -s catmull-clark -n 3
        meshfit subdivide curve.obj smooth.obj -s four-point -n 4
        meshfit subdivide head.obj fine.obj -s my-scheme.yaml
        zstdcat head.obj.zst | meshfit subdivide - fine.ply.gz --format obj
    """
    from meshfit.config.loading import load_definitions
    from meshfit.config.scheme_files import resolve_specs
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.io.files import curve_output_suffix, mesh_output_suffix
    from meshfit.mesh.targets import open_target
    from meshfit.subdivision.registry import SURFACES, domain_of, registry_with, resolve, schemes_on

    number = _number(alpha)
    alphas = alpha if number is None else None
    common_alpha = number if alphas is None else 1.0  # one per vertex replaces it later
    (spec,), own = resolve_specs([scheme], load_definitions(config))
    declared = resolve(
        spec, registry_with(own), alpha=common_alpha, weights=weights, tension=tension, valence3=valence3
    )
    cleaning = CleaningOptions(weld, repair)
    options = _SurfaceOptions(alphas, creases, sharpness, cleaning, yes=yes, limit=limit, normals=normals)
    _check(spec, declared, options)
    on_curves = domain_of(declared) == "curves"
    with suggest_option("--output-format"):
        (curve_output_suffix if on_curves else mesh_output_suffix)(destination, output_format)
    try:
        with suggest_option("--format"):
            content = open_target(source, "curve" if on_curves else "mesh", input_format)
            files = _Files(source, content, destination, output_format)
            if on_curves:
                counts = _refine_curves(files, declared, levels)
            else:
                counts = _refine_surface(files, declared, levels, options)
    except DomainError as error:
        others = f"surfaces: {schemes_on(*SURFACES)}" if on_curves else f"curves: {schemes_on('curves')}"
        raise DomainError(f"{error}; schemes on {others}") from None
    console, name = (err, "standard output") if destination in STDOUT_PATHS else (out, path_text(destination))
    console.print(f"{name}: {counts}", soft_wrap=True, markup=False)
    return 0
