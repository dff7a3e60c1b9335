"""Clean the raw arrays of a file: refuse meaningless meshes, repair harmless faults, and warn of each."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.memory import require_memory
from meshfit.mesh.attributes import JOINTS, NO_ATTRIBUTES, WEIGHTS, Attributes, Values, is_uv
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.faceless import no_faces_message
from meshfit.mesh.geometry import bounding_box_diagonal, signed_volume
from meshfit.mesh.manifold import (
    nonmanifold_edges,
    nonmanifold_verts,
    num_components,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import wound_alike
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.mesh.topology import NONE, Indices, Mask, PolygonTopology, Topology
from meshfit.mesh.triangulation import triangle_corners, triangulate
from meshfit.mesh.welding import Stitched, coincident, first_equal, nearly_coincident, stitch
from meshfit.units import count_text

INSIDE_OUT = "the surface is inside out: closed, with a negative volume"
"""The warning of a surface whose faces all look inwards."""
OPPOSITE = "between faces of opposite orientation"
"""The end of the warning of a surface whose faces are not wound alike."""

# Areas and their squares stay finite up to here.
_LARGEST_COORDINATE = 1e60
# Volumes of a smaller size, relative to the cube of the bounding box's diagonal, may come from rounding.
_ROUNDING = 1e-9
# Faces of a closed surface that are looked at first for one with an area.
_SOME_FACES = 1000
# Faces of a smaller area, relative to the square of their longest edge, are flat.
_FLAT = 1e-14
# Memory that cleaning takes at least, besides the content of the file; measured 65 on triangles.
_LEAST_BYTES_PER_CORNER = 50
# Corner data that says, while a mesh is cleaned, which corner of the file each of its corners is.
_Target = TypeVar("_Target", Mesh, PointCloud, Mesh | PointCloud)
_ORIGIN = "origin"


def _no_indices() -> Indices:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class VertexMap:
    """The vertices of a mesh that each vertex of its file became.

    Attributes:
        first: (N,) index in the mesh of each vertex of the file, `NONE` for dropped ones; welded ones share an index.
        split: (K,) vertices of the file that became several.
        copies: (K,) the further vertices of the mesh that they became.
    """

    first: Indices
    split: Indices = field(default_factory=_no_indices)
    copies: Indices = field(default_factory=_no_indices)

    @property
    def num_file_verts(self) -> int:
        """N, the number of vertices of the file."""
        return len(self.first)

    def mesh_verts(self, file_vert: int) -> list[int]:
        """Return the vertices of the mesh that a vertex of the file became; none if it was dropped."""
        if self.first[file_vert] == NONE:
            return []
        return [int(self.first[file_vert]), *self.copies[self.split == file_vert].tolist()]

    def pairs(self) -> tuple[Indices, Indices]:
        """Return all pairs of a vertex of the file and a vertex of the mesh."""
        kept = np.flatnonzero(self.first != NONE)
        return np.concatenate([kept, self.split]), np.concatenate([self.first[kept], self.copies])


def clean(
    soup: PolygonSoup, origin: str, options: CleaningOptions | None = None, *, triangles: bool = False
) -> tuple[PolygonMesh, VertexMap]:
    """Return a mesh without seams, degenerate or duplicate faces, unused and non-manifold vertices.

    Boundary edges whose ends coincide, which file formats split along seams, are joined; see `meshfit.mesh.welding`.
    Coincident vertices off the boundary stay separate: there a closed surface touches itself, and merging would tear
    it. Corners at the place of the previous one are dropped, and so are faces of fewer than three corners. A face
    without area but with three places is dropped only where that opens no edge.

    Each vertex, face and corner keeps its attributes. Texture coordinates become those of corners, and so does data in
    which vertices differ that were joined, such as the colours of faces; of different skin weights, the first are kept.

    Args:
        soup: N positions, polygons, and perhaps attributes.
        origin: name of the mesh in messages, usually its path.
        options: distance of welding, and repair of non-manifold vertices.
        triangles: triangulate all faces; else those with a vertex twice only, such as a polygon with a bridge to its
            hole.

    Returns:
        The mesh, and the vertices that those of the file became.

    Raises:
        MeshError: no vertices or faces, a coordinate that is not finite or beyond 1e60, a face with an index out of
            range, or no area at all.

    Warns:
        MeshfitWarning: with the number of dropped or split elements of each kind, and where the surface is not one
            closed manifold.
    """
    options = options or CleaningOptions()
    _require_valid(soup, origin)
    size = f"{origin}: {count_text(len(soup.sizes), 'face')}"
    require_memory(_LEAST_BYTES_PER_CORNER * len(soup.corners), size, "thin the mesh, or free some memory")
    origins = Attributes(corner={_ORIGIN: np.arange(len(soup.corners))}) if soup.attributes else NO_ATTRIBUTES
    raw = PolygonMesh(soup.verts, soup.corners, soup.sizes, origins)
    given = PolygonTopology.of(raw)
    place = coincident(given, raw.verts, options.weld)
    mesh, repeated = _without_repeated_corners(raw, given, place)
    counts = {"degenerate face": raw.num_faces - mesh.num_faces}
    bridged = _with_place_twice(mesh, place)
    mesh = _triangulated(mesh, place, np.full(mesh.num_faces, fill_value=True) if triangles else bridged)
    if bridged.any():
        mesh, _ = _without_repeated_corners(mesh, PolygonTopology.of(mesh), place)
    welded = _topology(mesh, place[mesh.corners], given)
    duplicate = _duplicates(mesh, welded)
    mesh, welded = _selected(mesh, welded, ~duplicate)
    flat = _needless_flat_faces(mesh, welded)
    mesh, welded = _selected(mesh, welded, ~flat)
    if not mesh.num_faces:
        raise MeshError(f"{origin}: no face has an area ({count_text(raw.num_faces, 'face')})")
    stitched = stitch(mesh.verts, _topology(mesh, mesh.corners, given), welded, split=options.repair == "split")
    result = _stitched_mesh(stitched, mesh)
    counts["degenerate face"] += int(flat.sum())
    counts |= {"duplicate face": int(duplicate.sum()), "repeated corner": repeated}
    counts["unreferenced vertex"] = int((~_marked(raw.corners, raw.num_verts)).sum())
    for kind, count in counts.items():
        if count:
            _warn(f"{origin}: dropped {count_text(count, kind)}")
    if stitched.num_split:
        where = "where separate fans of faces, or more than two faces at an edge, meet"
        _warn(f"{origin}: split {count_text(stitched.num_split, 'vertex')} {where}")
    topology = _topology(result, result.corners, given)
    del given, welded  # which hold hundreds of bytes per face
    vertex_map = _vertex_map(mesh.corners, stitched.corners, place)
    _warn_of_shape(result, topology, origin, is_manifold=stitched.is_manifold)
    return result.with_attributes(_carried(soup, mesh, result)) if soup.attributes else result, vertex_map


def _stitched_mesh(stitched: Stitched, mesh: PolygonMesh) -> PolygonMesh:
    """Return the mesh whose corners are stitched, without attributes; it shares the arrays that are the same."""
    same = np.array_equal(stitched.origins, np.arange(mesh.num_verts))
    verts = mesh.verts if same else mesh.verts[stitched.origins]
    corners = mesh.corners if np.array_equal(stitched.corners, mesh.corners) else stitched.corners
    return PolygonMesh(verts, corners, mesh.sizes)


def _carried(soup: PolygonSoup, kept: PolygonMesh, result: PolygonMesh) -> Attributes:
    """Return the attributes of the cleaned mesh.

    Args:
        soup: content of the file.
        kept: the faces that are left, by the vertices of the file, with the origins of their corners.
        result: the same faces by their own vertices.
    """
    corners = kept.attributes.corner[_ORIGIN]
    faces = np.repeat(np.arange(len(soup.sizes)), soup.sizes)[corners[kept.starts]]
    verts = np.empty(result.num_verts, dtype=np.int64)
    verts[result.corners[::-1]] = kept.corners[::-1]
    given = soup.attributes
    chosen = given.selected(verts, faces, corners)
    moved = {
        name: values[kept.corners]
        for name, values in given.vertex.items()
        if name not in given.corner and (is_uv(name) or _differs(name, values, verts[result.corners], kept.corners))
    }
    stay = {name: values for name, values in chosen.vertex.items() if name not in moved}
    return replace(chosen, vertex=stay, corner={**chosen.corner, **moved})


def _differs(name: str, values: Values, one: Indices, other: Indices) -> bool:
    """Return whether data of vertices differs between pairs of them; that of a skin never counts as different."""
    apart = np.flatnonzero(one != other)
    if name in (JOINTS, WEIGHTS) or not len(apart):
        return False
    ones, others = values[one[apart]], values[other[apart]]
    return not np.array_equal(ones, others, equal_nan=values.dtype.kind in "fc")


def require_finite_verts(verts: NDArray[np.floating], origin: str) -> None:
    """Refuse coordinates that are not finite, or so large that areas overflow.

    Raises:
        MeshError: a coordinate that is not finite or beyond 1e60, with its vertex.
    """
    finite = np.isfinite(verts).all(axis=1)
    if not finite.all():
        bad = int(np.flatnonzero(~finite)[0])
        raise MeshError(f"{origin}: vertex {bad} has a coordinate that is not finite: {verts[bad].tolist()}")
    too_large = (np.abs(verts) > _LARGEST_COORDINATE).any(axis=1)
    if too_large.any():
        bad = int(np.flatnonzero(too_large)[0])
        raise MeshError(
            f"{origin}: expected coordinates up to {_LARGEST_COORDINATE:g}, got {verts[bad].tolist()} at vertex {bad}"
        )


def _require_valid(soup: PolygonSoup, origin: str) -> None:
    verts = soup.verts
    if not len(verts):
        raise MeshError(f"{origin}: the mesh has no vertices")
    if not len(soup.sizes):
        raise MeshError(f"{origin}: {no_faces_message(len(verts))}")
    outside = np.flatnonzero((soup.corners < 0) | (soup.corners >= len(verts)))
    if len(outside):
        ends = np.cumsum(soup.sizes)
        bad = int(np.searchsorted(ends, outside[0], side="right"))
        face = soup.corners[ends[bad] - soup.sizes[bad] : ends[bad]].tolist()
        raise MeshError(f"{origin}: face {bad} is {face}, but vertices are numbered 0 to {len(verts) - 1}")
    used = _marked(soup.corners, len(verts))
    require_finite_verts(np.where(used[:, None], verts, 0.0), origin)


def _topology(mesh: PolygonMesh, corners: Indices, known: PolygonTopology) -> PolygonTopology:
    """Return the connectivity of faces with these corners; the known one, with all it has computed, if it is equal."""
    same = mesh.num_verts == known.num_verts and np.array_equal(mesh.sizes, known.sizes)
    if same and np.array_equal(corners, known.corners):
        return known
    return PolygonTopology(mesh.num_verts, corners, mesh.sizes)


def _without_repeated_corners(mesh: PolygonMesh, topology: PolygonTopology, place: Indices) -> tuple[PolygonMesh, int]:
    """Drop corners at the place of the next one, then faces of fewer than three; count those of the other faces."""
    differs = place[topology.tail] != place[topology.head]
    if differs.all():
        return mesh, 0
    remaining = np.bincount(topology.face[differs], minlength=mesh.num_faces)
    whole = remaining >= 3
    kept = differs & whole[topology.face]
    repeated = int((mesh.sizes - remaining)[whole].sum())
    return _of_corners(mesh, kept, remaining[whole]), repeated


def _with_place_twice(mesh: PolygonMesh, place: Indices) -> Mask:
    """Return (F,) which faces have two corners at one place."""
    large = mesh.sizes > 3
    twice = np.zeros(mesh.num_faces, dtype=bool)
    if large.any():
        corners, sizes = place[mesh.corners[np.repeat(large, mesh.sizes)]], mesh.sizes[large]
        twice[large] = PolygonTopology(mesh.num_verts, corners, sizes).has_vert_twice
    return twice


def _triangulated(mesh: PolygonMesh, place: Indices, chosen: Mask) -> PolygonMesh:
    """Split some faces into triangles, in their place."""
    if not (chosen & (mesh.sizes > 3)).any():
        return mesh
    chosen = chosen | (mesh.sizes == 3)
    inside = np.repeat(chosen, mesh.sizes)
    corners = mesh.corners[inside]
    triangles = np.flatnonzero(inside)[triangle_corners(mesh.verts, place[corners], mesh.sizes[chosen])]
    faces = np.repeat(np.flatnonzero(chosen), mesh.sizes[chosen] - 2)
    rest = np.flatnonzero(~chosen)
    order = np.argsort(np.concatenate([rest, faces]), kind="stable")
    sizes = np.concatenate([mesh.sizes[rest], np.full(len(faces), 3)])
    starts = np.cumsum(sizes) - sizes
    every = np.concatenate([np.flatnonzero(~inside), triangles.reshape(-1)])
    ordered = sizes[order]
    places = np.repeat(starts[order] - np.cumsum(ordered) + ordered, ordered) + np.arange(len(every))
    return _of_corners(mesh, every[places], ordered)


def _selected(mesh: PolygonMesh, topology: PolygonTopology, faces: Mask) -> tuple[PolygonMesh, PolygonTopology]:
    """Return some faces of a mesh, and of another connectivity of the same faces."""
    if faces.all():
        return mesh, topology
    kept = np.repeat(faces, mesh.sizes)
    sizes = mesh.sizes[faces]
    return _of_corners(mesh, kept, sizes), PolygonTopology(topology.num_verts, topology.corners[kept], sizes)


def _of_corners(mesh: PolygonMesh, chosen: Indices | Mask, sizes: Indices) -> PolygonMesh:
    """Return the mesh whose faces, of these sizes, have the chosen corners of this one."""
    rows = {name: values[chosen] for name, values in mesh.attributes.corner.items()}
    return PolygonMesh(mesh.verts, mesh.corners[chosen], sizes, Attributes(corner=rows) if rows else NO_ATTRIBUTES)


def _duplicates(mesh: PolygonMesh, welded: PolygonTopology) -> Mask:
    """Return (F,) which faces repeat an earlier one: with the same vertices, or in the same direction at its place."""
    # A duplicate lies at edges of three faces or more, or has no neighbour but the other.
    crowded = np.zeros(mesh.num_faces, dtype=bool)
    if (welded.faces_per_edge > 2).any():
        crowded[welded.face[welded.faces_per_edge[welded.edge_of] > 2]] = True
    lone = _marked(welded.lone_faces, mesh.num_faces)
    same_verts = _repeats(mesh.corners, mesh, crowded | (lone & (mesh.sizes == 3)), directed=False)
    return np.asarray(same_verts | _repeats(welded.corners, mesh, crowded | lone, directed=True))


def _repeats(corners: Indices, mesh: PolygonMesh, among: Mask, *, directed: bool) -> Mask:
    """Return (F,) which of some faces have the corners of an earlier one, whatever the first corner."""
    repeats = np.zeros(mesh.num_faces, dtype=bool)
    for size in np.unique(mesh.sizes[among]):
        faces = np.flatnonzero(among & (mesh.sizes == size))
        rows = corners[mesh.starts[faces][:, None] + np.arange(size)]
        places = rows.argmin(axis=1)[:, None] + np.arange(size)
        ahead = np.take_along_axis(rows, places % size, axis=1)
        if not directed:
            backwards = ahead[:, 1] > ahead[:, -1]
            ahead[backwards, 1:] = ahead[backwards, :0:-1]
        repeats[faces] = first_equal(ahead) != np.arange(len(faces))
    return repeats


def _needless_flat_faces(mesh: PolygonMesh, welded: PolygonTopology) -> Mask:
    """Return (F,) which faces without area can be dropped without opening an edge."""
    if welded.is_watertight:  # dropping opens an edge, unless it takes all
        some = np.arange(mesh.num_faces) < _SOME_FACES
        if (_relative_areas(*_selected(mesh, welded, some)) > _FLAT).any():
            return np.zeros(mesh.num_faces, dtype=bool)
    flat = _relative_areas(mesh, welded) <= _FLAT
    if not flat.any():
        return flat
    edge, before = welded.edge_of, welded.faces_per_edge
    while True:
        after = np.bincount(edge[~flat[welded.face]], minlength=len(before))
        opened = (before >= 2) & (after == 1)
        needed = np.unique(welded.face[opened[edge] & flat[welded.face]])
        if not len(needed):
            return flat
        flat[needed] = False


def _relative_areas(mesh: PolygonMesh, welded: PolygonTopology) -> Float64[np.ndarray, " F"]:
    """Return the area of each face, divided by the square of its longest edge."""
    triangles = triangulate(mesh.verts, welded.corners, mesh.sizes)
    axes = [np.ascontiguousarray(axis) for axis in mesh.verts.T]
    # Coordinate by coordinate, which is several times as fast as by vectors.
    a, b = ([axis[triangles[:, k]] - axis[triangles[:, 0]] for axis in axes] for k in (1, 2))
    area = np.sqrt(sum((a[i] * b[j] - a[j] * b[i]) ** 2 for i, j in ((0, 1), (1, 2), (2, 0)))) / 2
    if len(triangles) == mesh.num_faces:
        ends = (a, b, [x - y for x, y in zip(a, b, strict=True)])
        squared = np.maximum.reduce([sum(x**2 for x in edge) for edge in ends])
    else:
        counts = mesh.sizes - 2
        area = np.add.reduceat(area, np.cumsum(counts) - counts)
        lengths = sum((axis[welded.head] - axis[welded.tail]) ** 2 for axis in axes)
        squared = np.maximum.reduceat(lengths, mesh.starts)
    return np.asarray(area / squared)


def _marked(indices: Indices, count: int) -> Mask:
    mark = np.zeros(count, dtype=bool)
    mark[indices] = True
    return mark


def _vertex_map(given: Indices, corners: Indices, place: Indices) -> VertexMap:
    """Return the map from the given vertex of each corner to the new one."""
    first = np.full(len(place), NONE)
    if np.array_equal(given, corners):
        first[given] = given
        return VertexMap(first)
    first[given[::-1]] = corners[::-1]
    # A vertex whose faces were all dropped goes with the one at its place.
    first = np.where(first == NONE, first[place], first)
    others = np.flatnonzero(corners != first[given])
    pairs = np.unique(np.stack([given[others], corners[others]], axis=1), axis=0)
    return VertexMap(first, pairs[:, 0], pairs[:, 1])


def _warn_of_shape(mesh: PolygonMesh, topology: PolygonTopology, origin: str, *, is_manifold: bool) -> None:
    components, edges = num_components(topology), nonmanifold_edges(topology)
    verts = () if is_manifold else np.setdiff1d(nonmanifold_verts(topology), topology.edges[edges])
    findings = {
        ("non-manifold edge", " (three faces or more); --repair split separates the faces"): len(edges),
        ("non-manifold vertex", " (separate fans of faces); --repair split separates them"): len(verts),
        ("edge", f" {OPPOSITE}"): len(topology.misoriented_edges),
        ("boundary edge", ": the surface is open"): int(topology.boundary_edges.sum()),
        ("separate component", ""): components if components > 1 else 0,
    }
    for (noun, remark), count in findings.items():
        if count:
            _warn(f"{origin}: {count_text(count, noun)}{remark}")
    near, distance = nearly_coincident(topology, mesh.verts)
    if near:
        reach = f"up to {distance:.2g} apart; --weld {1.05 * distance:.1e} joins them (config: weld)"
        _warn(f"{origin}: {count_text(near, 'boundary vertex')} nearly coincident with another, {reach}")
    if topology.is_watertight and has_negative_volume(mesh.triangulated()):
        _warn(f"{origin}: {INSIDE_OUT}")


def has_negative_volume(mesh: Mesh) -> bool:
    """Return whether the volume of a closed mesh is negative by more than rounding."""
    return signed_volume(mesh) < -_ROUNDING * bounding_box_diagonal(mesh.verts) ** 3


def outward(mesh: _Target) -> _Target:
    """Turn the faces of a closed mesh that is inside out, and those that are wound unlike most of their piece.

    A mesh that needs neither is returned as it is, and so are points; others lose their attributes.
    """
    return _outward(mesh) if isinstance(mesh, Mesh) else mesh


def _outward(mesh: Mesh) -> Mesh:
    mesh = wound_alike(mesh)
    if not has_negative_volume(mesh) or not Topology.of(mesh).is_watertight:
        return mesh
    return Mesh(mesh.verts, mesh.faces[:, ::-1])


def with_turning(texts: Iterable[str], purpose: str) -> list[str]:
    """Return warnings of a mesh whose faces `outward` has turned, which say so.

    Args:
        texts: the warnings.
        purpose: of turning the faces, such as `fit`.
    """
    faults = (INSIDE_OUT, OPPOSITE)
    return [f"{text}; its faces are turned for the {purpose}" if text.endswith(faults) else text for text in texts]


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=4)
