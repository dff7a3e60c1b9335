"""The outer surface of a mesh: the parts that can be seen from outside, without what other parts hide.

Closed pieces are united, whichever way they are wound: where pieces cross, they are cut, and what lies inside another
piece, or in a cavity, is dropped. Open pieces have no inside of their own. Their parts are hidden where the winding
number says that they lie inside the others, unless a good share of all directions sees them; so small gaps between the
panels of a body do not show what is within, and open windows do.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas, face_normals, signed_volume
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh, SameContent
from meshfit.mesh.pieces import crossing_within_pieces, manifold_pieces, piece_of_face
from meshfit.mesh.topology import Indices, Mask, Topology

# Most crossing faces that are cut exactly; if there are more, long edges are halved instead, down to this share of the
# diagonal, and at most to about so many faces.
_MOST_CUT = 1500
_FINE, _MOST_FINE = 0.01, 100_000
# Sides are judged so far off their face: this share of the square root of its area, and at most this share of the
# diagonal where winding numbers are exact, or else between these.
_OFF, _EXACT_OFF, _LEAST_OFF, _MOST_OFF = 0.3, 1e-6, 2e-6, 1e-4
# A side is inside from this winding number on: it is at most 0 in the open; before a sheet within a solid, it is 1/2.
_INSIDE = 0.25
# A part of an open piece, or one behind it, is in plain sight if this share of the directions on one side see it.
_PLAIN_SIGHT = 0.15
_DIRECTIONS, _LOOKED_AT, _FEWEST_LOOKED_AT = 40, 3000, 3
# A part whose area agrees to this share goes as a whole.
_WHOLE = 0.95
_FACES_JUDGED, _NEIGHBOURS = 5, 5


@no_type_check
def outer_surface(mesh: "MeshLike") -> Mesh:
    """Return the outer surface of a mesh: what can be seen from outside, cut where it is hidden.

    A mesh without hidden parts is returned as it is. The same mesh gives the same bytes.

    Args:
        mesh: in any form that `as_mesh` takes; of any orientation, and manifold or not.

    Example:
        >>> import meshfit
        >>> ball = meshfit.icosphere(3)
        >>> both = meshfit.Mesh([*ball.verts, *(ball.verts / 2)], [*ball.faces, *(ball.faces + ball.num_verts)])
        >>> meshfit.outer_surface(both)
        Mesh(642 verts, 1,280 faces, box 2 × 2 × 2)

    Raises:
        MeshError: not a mesh, or one without faces.
    """
    given = as_mesh(mesh, "mesh", triangles=True)
    if not given.num_faces:
        raise MeshError("a mesh without faces has no outer surface")
    found = _outer_surface(SameContent(given))
    return given if found is None else found


@lru_cache(maxsize=2)  # many results are measured against one target
def _outer_surface(content: SameContent) -> Mesh | None:
    """Return the outer surface; None if it is all of the mesh."""
    given = content.mesh
    pieces = manifold_pieces(_without_copies(given))
    if not pieces.num_faces:
        return None
    closed, opened = _closed_and_open(pieces)
    solids, unsolved = _solids(closed)
    union = _union(solids)
    rest = _joined([opened, *unsolved])
    none_dropped = pieces.num_faces == given.num_faces
    none_hidden = none_dropped and union.num_faces == closed.num_faces and _equal_areas(union, closed)
    if not rest.num_faces:
        return None if none_hidden else union
    visible = _visible(union, rest)
    if visible is None:
        return None if none_hidden else _joined([union, rest])
    return visible


def _without_copies(mesh: Mesh) -> Mesh:
    """Keep one of several faces with the same three vertices, and none without area."""
    corners = np.sort(mesh.faces, axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    kept = np.zeros(mesh.num_faces, dtype=bool)
    kept[first] = True
    return Mesh(mesh.verts, mesh.faces[kept & (face_areas(mesh) > 0)])


def _equal_areas(first: Mesh, second: Mesh) -> bool:
    return bool(np.isclose(face_areas(first).sum(), face_areas(second).sum(), rtol=1e-9, atol=0))


def _closed_and_open(pieces: Mesh) -> tuple[Mesh, Mesh]:
    """Separate the pieces without a boundary from those with one."""
    topology = Topology.of(pieces)
    count, piece = piece_of_face(pieces)
    at_boundary = topology.twin < 0
    is_open = np.zeros(count, dtype=bool)
    is_open[piece[topology.face_of(np.flatnonzero(at_boundary))]] = True
    return _part(pieces, ~is_open[piece]), _part(pieces, is_open[piece])


def _part(mesh: Mesh, kept: Mask) -> Mesh:
    used, corners = np.unique(mesh.faces[kept], return_inverse=True)
    return Mesh(mesh.verts[used], corners.reshape(-1, 3))


def _parts(mesh: Mesh, count: int, number: Indices) -> list[Mesh]:
    return [_part(mesh, number == i) for i in range(count)]


def _joined(meshes: list[Mesh]) -> Mesh:
    meshes = [mesh for mesh in meshes if mesh.num_faces]
    if not meshes:
        return Mesh([], [])
    offsets = np.cumsum([0, *(mesh.num_verts for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([mesh.verts for mesh in meshes]), np.concatenate(faces))


def _outward(mesh: Mesh) -> Mesh:
    return mesh if signed_volume(mesh) >= 0 else Mesh(mesh.verts, mesh.faces[:, ::-1])


# Closed pieces.


def _solids(closed: Mesh) -> tuple[list[Mesh], list[Mesh]]:
    """Return closed pieces, wound outwards, none of which crosses itself, and those for which that failed."""
    if not closed.num_faces:
        return [], []
    count, piece = piece_of_face(closed)
    crossing = crossing_within_pieces(closed, piece)
    crosses = np.bincount(piece, weights=crossing, minlength=count)
    solids, unsolved = [], []
    for number, part in enumerate(_parts(closed, count, piece)):
        mesh = _outward(part)
        if not crosses[number]:
            solids.append(mesh)
            continue
        skin = _skin(mesh, crossing[piece == number]) if crosses[number] <= _MOST_CUT else None
        if skin is None:
            unsolved.append(mesh)
        else:
            solids += skin
    return solids, unsolved


def _skin(piece: Mesh, crossing: Mask) -> list[Mesh] | None:
    """Return the outside of a closed piece that crosses itself as closed pieces; None if it does not close."""
    cut = _cut(piece, crossing)
    count, patch = _patches(cut)
    judged = np.flatnonzero(_rank_in(patch, face_areas(cut)) < _FACES_JUDGED)
    sides = [np.abs(values) > 0.5 for values in _winding_of_sides(piece, cut, judged, exact=True)]
    weights = face_areas(cut)[judged]
    inside_front, inside_back = (
        _mean_in(patch[judged], count, side.astype(np.float64), weights)[patch] > 0.5 for side in sides
    )
    # Parts that are turned inside out touch the others along crossings, where four faces of the skin meet.
    skin = _joined(
        [
            manifold_pieces(_without_copies(Mesh(cut.verts, faces)))
            for faces in (cut.faces[inside_back & ~inside_front], cut.faces[inside_front & ~inside_back][:, ::-1])
        ]
    )
    if not skin.num_faces or (Topology.of(skin).twin < 0).any():
        return None
    parts = _parts(skin, *piece_of_face(skin))
    return [part for part in parts if signed_volume(part) > 0]  # the others are the walls of cavities


def _union(solids: list[Mesh]) -> Mesh:
    """Unite closed pieces, and fill all cavities."""
    if len(solids) <= 1:
        return _joined(solids)
    import manifold3d  # most surfaces are one piece

    def united(meshes: list[Mesh]) -> Mesh:
        bodies = [
            manifold3d.Manifold(
                manifold3d.Mesh64(vert_properties=np.array(mesh.verts), tri_verts=mesh.faces.astype(np.uint64))
            )
            for mesh in meshes
        ]
        union = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add).to_mesh64()
        return Mesh(np.asarray(union.vert_properties)[:, :3], np.asarray(union.tri_verts).astype(np.int64))

    union = united(solids)
    parts = _parts(union, *piece_of_face(union))
    kept = [part for part in parts if signed_volume(part) > 0]
    # What lies in a cavity is a part of its own, and is inside another once the cavity is filled.
    return united(kept) if 1 < len(kept) < len(parts) else _joined(kept)


# Open pieces.


def _visible(solid: Mesh, rest: Mesh) -> Mesh | None:
    """Return what can be seen of closed pieces, and of others that have no inside of their own; None if that is all."""
    facing = _facing_out(solid, rest)
    both = _joined([solid, facing])
    is_solid = np.arange(both.num_faces) < solid.num_faces
    fine = _cut_or_refined(both)
    if fine is both:
        of_solid = is_solid
    else:
        from meshfit.mesh.proximity import nearest_on_surface

        of_solid = is_solid[nearest_on_surface(both, fine.verts[fine.faces].mean(axis=1)).faces]
    count, patch = _patches(fine)
    sight = _Sight.of(fine, fine, count, patch)
    front, _ = _winding_of_sides(both, fine, np.arange(fine.num_faces))
    seen_at_all: Mask = sight.shares(count).max(axis=1) > 0
    enclosed = front >= _INSIDE
    kept = np.where(enclosed, sight.in_plain_sight(fine, patch, enclosed), of_solid | seen_at_all[patch])
    agreeing = _mean_in(patch, count, kept.astype(np.float64), face_areas(fine))[patch]
    kept = (kept & (agreeing > 1 - _WHOLE)) | (agreeing > _WHOLE)
    if kept.all() and fine is both:
        return None
    return manifold_pieces(_without_copies(_part(fine, kept))) if kept.any() else both


def _facing_out(solid: Mesh, rest: Mesh) -> Mesh:
    """Wind each open piece such that it faces where it is seen from."""
    count, piece = piece_of_face(rest)
    shares = _Sight.of(_joined([rest, solid]), rest, count, piece).shares(count)
    turned = (shares[:, 1] > shares[:, 0])[piece]
    return Mesh(rest.verts, np.where(turned[:, None], rest.faces[:, ::-1], rest.faces))


@dataclass(frozen=True, eq=False)
class _Sight:
    """Visibility of some faces from outside.

    Attributes:
        faces: (N,) their numbers.
        points: (N, 3) their centroids.
        parts: (N,) the parts of the mesh that they belong to.
        areas: (N,) their areas.
        seen: (N, 2) the shares of all directions before them, and behind them, from which they are seen.
    """

    faces: Indices
    points: Float64[np.ndarray, "N 3"]
    parts: Indices
    areas: Float64[np.ndarray, " N"]
    seen: Float64[np.ndarray, "N 2"]

    @classmethod
    def of(cls, surface: Mesh, mesh: Mesh, count: int, part: Indices) -> "_Sight":
        """Look at the largest faces of each part.

        Args:
            surface: what may be in the way.
            mesh: faces of it.
            count: number of parts.
            part: (F,) the part of each face.
        """
        from meshfit.mesh.proximity import seen_from

        areas = face_areas(mesh)
        size = np.bincount(part, minlength=count)
        quota = np.maximum(_FEWEST_LOOKED_AT, np.ceil(_LOOKED_AT * size / mesh.num_faces))
        faces = np.flatnonzero(_rank_in(part, areas) < quota[part])
        points, directions = mesh.verts[mesh.faces[faces]].mean(axis=1), _directions(_DIRECTIONS)
        seen = seen_from(surface, points, directions)
        before = face_normals(mesh)[faces] @ directions.T > 0
        shares = [(seen & side).sum(axis=1) / np.maximum(side.sum(axis=1), 1) for side in (before, ~before)]
        return cls(faces, points, part[faces], areas[faces], np.stack(shares, axis=1))

    def shares(self, count: int) -> Float64[np.ndarray, "C 2"]:
        """Return the mean shares of each part."""
        sides = [_mean_in(self.parts, count, side, self.areas) for side in self.seen.T]
        return np.stack(sides, axis=1)

    def in_plain_sight(self, mesh: Mesh, part: Indices, enclosed: Mask) -> Mask:
        """Return (F,) which enclosed faces of a mesh are in plain sight, by the nearest such faces of the same part."""
        shown = np.zeros(mesh.num_faces, dtype=bool)
        looked_at = enclosed[self.faces]
        if not looked_at.any():
            return shown
        apart = 4 * bounding_box_diagonal(mesh.verts)
        tree = cKDTree(np.column_stack([self.points, apart * self.parts])[looked_at])
        middle = mesh.verts[mesh.faces[enclosed]].mean(axis=1)
        numbers = range(1, min(_NEIGHBOURS, int(looked_at.sum())) + 1)
        found = tree.query(np.column_stack([middle, apart * part[enclosed]]), k=numbers)
        away, nearest = (np.asarray(values) for values in found)
        same, seen = away < apart, self.seen[looked_at].max(axis=1)[nearest]
        shown[enclosed] = same.any(axis=1) & ((seen * same).sum(axis=1) >= _PLAIN_SIGHT * same.sum(axis=1))
        return shown


def _directions(count: int) -> Float64[np.ndarray, "D 3"]:
    """Return evenly spread unit vectors: points of a spiral on the sphere."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def _cut_or_refined(mesh: Mesh) -> Mesh:
    """Cut faces that cross each other, or halve the long edges where that would take too long."""
    from meshfit.mesh.meshlab import refine_long_edges, self_intersecting_faces

    crossing = self_intersecting_faces(mesh)
    if not crossing.any():
        return mesh
    if crossing.sum() <= _MOST_CUT:
        return _cut(mesh, crossing)
    fewest = np.sqrt(4 / np.sqrt(3) * float(face_areas(mesh).sum()) / _MOST_FINE)
    return refine_long_edges(mesh, max(_FINE * bounding_box_diagonal(mesh.verts), float(fewest)))


# Patches and sides.


def _cut(mesh: Mesh, crossing: Mask) -> Mesh:
    """Cut the faces of a mesh that cross others, which are known but for those that touch another by a hair."""
    from meshfit.mesh.proximity import cut_where_crossing

    at_crossing = np.zeros(mesh.num_verts, dtype=bool)
    at_crossing[mesh.faces[crossing]] = True
    suspect = at_crossing[mesh.faces].any(axis=1)
    cut = cut_where_crossing(_part(mesh, suspect))
    both = _joined([Mesh(mesh.verts, mesh.faces[~suspect]), cut])
    # Vertices of the cut faces that they had before are at the same place.
    verts, number = np.unique(both.verts + 0.0, axis=0, return_inverse=True)
    faces = number.reshape(-1)[both.faces]
    different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return _in_order(Mesh(verts, faces[different]))


def _in_order(mesh: Mesh) -> Mesh:
    """Return a mesh with its faces in the order of their corners, which CGAL returns in any order."""
    first = mesh.faces.argmin(axis=1)[:, None]
    corners = np.take_along_axis(mesh.faces, (first + np.arange(3)) % 3, axis=1)
    return Mesh(mesh.verts, corners[np.lexsort(corners.T[::-1])])


def _patches(mesh: Mesh) -> tuple[int, Indices]:
    """Return the number of patches, which end at edges of one or of more than two faces, and (F,) that of each face."""
    edges = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = edges[:, 0] * mesh.num_verts + edges[:, 1]
    order = np.argsort(key, kind="stable")
    _, first, times = np.unique(key[order], return_index=True, return_counts=True)
    pair = first[times == 2]
    return graph_components(order[pair] // 3, order[pair + 1] // 3, mesh.num_faces)


def _winding_of_sides(
    field: Mesh, mesh: Mesh, faces: Indices, *, exact: bool = False
) -> tuple[Float64[np.ndarray, " N"], Float64[np.ndarray, " N"]]:
    """Return the winding numbers of a field just before and just behind some faces of a mesh."""
    from meshfit.mesh.proximity import winding_numbers

    size = bounding_box_diagonal(field.verts)
    limits = (0.0, _EXACT_OFF * size) if exact else (_LEAST_OFF * size, _MOST_OFF * size)
    off = np.clip(_OFF * np.sqrt(face_areas(mesh)[faces]), *limits)[:, None]
    middle, normals = mesh.verts[mesh.faces[faces]].mean(axis=1), face_normals(mesh)[faces]
    front, back = (winding_numbers(field, middle + side * normals, exact=exact) for side in (off, -off))
    return front, back


def _rank_in(number: Indices, values: Float64[np.ndarray, " F"]) -> Indices:
    """Return the rank of each value among those of the same number, the largest first."""
    order = np.lexsort((np.arange(len(values)), -values, number))
    sizes = np.bincount(number)
    start = np.cumsum(sizes) - sizes
    rank = np.empty(len(values), dtype=np.int64)
    rank[order] = np.arange(len(values)) - start[number[order]]
    return rank


def _mean_in(
    number: Indices, count: int, values: Float64[np.ndarray, " N"], weights: Float64[np.ndarray, " N"]
) -> Float64[np.ndarray, " C"]:
    """Return the weighted mean of the values of each number."""
    total = np.bincount(number, weights=weights, minlength=count)
    sums = np.bincount(number, weights=weights * values, minlength=count)
    return np.asarray(sums / np.maximum(total, np.finfo(np.float64).tiny))
