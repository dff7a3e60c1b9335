"""From the raw arrays of a file to a mesh to be trusted: refuse what is meaningless, mend what is harmless, say so."""

import warnings

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import DomainError, MeshError, MeshfitWarning
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.halfedges import HalfEdges, Indices, Mask
from meshfit.mesh.manifold import misoriented_edges, nonmanifold_edges, num_components
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.mesh.topology import NONE, PolygonTopology, Topology

# Areas and their squares stay finite up to here.
_LARGEST = 1e60


def clean(verts: NDArray[np.floating], faces: NDArray[np.integer], origin: str) -> Mesh:
    """A mesh of these arrays, welded along its seams, without degenerate or duplicate faces and unused verts.

    Args:
        verts: (V, 3) positions.
        faces: (F, 3) vertex indices.
        origin: what to call the mesh in messages, usually its path.

    Raises:
        MeshError: no verts or faces, a coordinate that is not finite or beyond 1e60, a face that indexes outside, no
            area at all.

    Warns:
        MeshfitWarning: with the count of whatever was dropped, and where the surface is not one closed manifold.
    """
    sizes = np.full(len(faces), 3, dtype=np.int64)
    return clean_polygons(PolygonSoup(verts, faces.reshape(-1).astype(np.int64), sizes), origin).triangulated()


def clean_polygons(found: PolygonSoup, origin: str) -> PolygonMesh:
    """A mesh of these arrays, as `clean` makes it of triangles.

    A corner that repeats the one before it is dropped; a polygon is degenerate if no triangle of its fan has area.

    Args:
        found: positions and polygons.
        origin: what to call the mesh in messages, usually its path.

    Raises:
        MeshError: as `clean`.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    return clean_with_vertex_map(found, origin)[0]


def clean_with_vertex_map(found: PolygonSoup, origin: str) -> tuple[PolygonMesh, Indices]:
    """What `clean_polygons` makes of these, and (N,) the vertex that each given one is now, `NONE` if it was dropped.

    Raises:
        MeshError: as `clean`.

    Warns:
        MeshfitWarning: as `clean` does.
    """
    _require_sound(found, origin)
    raw = PolygonMesh(*found)
    target = _seam_targets(PolygonTopology.of(raw), raw.verts)
    mesh, repeated = _without_repeated_corners(raw.verts, target[raw.corners], raw.sizes)
    result, dropped = _sound_faces(mesh)
    dropped["degenerate faces"] += raw.num_faces - mesh.num_faces
    if not result.num_faces:
        raise MeshError(f"{origin}: all {raw.num_faces} faces are degenerate (no area)")
    dropped |= {"repeated corners": repeated, "unreferenced verts": int((~_marked(raw.corners, raw.num_verts)).sum())}
    used = _marked(result.corners, raw.num_verts)
    number = np.where(used, np.cumsum(used) - 1, NONE)
    result = PolygonMesh(raw.verts[used], number[result.corners], result.sizes)
    for what, count in dropped.items():
        if count:
            _warn(f"{origin}: dropped {count} {what}")
    _warn_of_shape(PolygonTopology.of(result), origin)
    return result, number[target]


def weld_seams(mesh: Mesh) -> Mesh:
    """Let faces share verts that lie at the same position on a boundary, as file formats split them along seams.

    Coincident verts off the boundary stay apart: there a closed surface touches itself, and welding would tear it.
    """
    return Mesh(mesh.verts, _seam_targets(Topology.of(mesh), mesh.verts)[mesh.faces])


def _seam_targets(topology: HalfEdges, verts: Verts) -> Indices:
    """(V,) the vertex that each is to become."""
    seam = np.flatnonzero(topology.boundary_verts)
    target = np.arange(topology.num_verts)
    target[seam] = seam[_first_equal(verts[seam])]
    return target


def require_finite_verts(verts: NDArray[np.floating], origin: str) -> None:
    """Refuse positions that cannot be computed with.

    Raises:
        MeshError: a coordinate that is not finite or beyond 1e60; its vertex is named.
    """
    finite = np.isfinite(verts).all(axis=1)
    if not finite.all():
        bad = int(np.flatnonzero(~finite)[0])
        raise MeshError(f"{origin}: vertex {bad} has a coordinate that is not finite: {verts[bad].tolist()}")
    too_large = (np.abs(verts) > _LARGEST).any(axis=1)
    if too_large.any():
        bad = int(np.flatnonzero(too_large)[0])
        raise MeshError(f"{origin}: vertex {bad} is {verts[bad].tolist()}; coordinates up to {_LARGEST:g} are allowed")


def _require_sound(found: PolygonSoup, origin: str) -> None:
    verts = found.verts
    if not len(verts):
        raise MeshError(f"{origin}: the mesh has no verts")
    if not len(found.sizes):
        raise DomainError(f"{origin}: the mesh has {len(verts)} verts and no faces; a surface of triangles is needed")
    require_finite_verts(verts, origin)
    outside = np.flatnonzero((found.corners < 0) | (found.corners >= len(verts)))
    if len(outside):
        ends = np.cumsum(found.sizes)
        bad = int(np.searchsorted(ends, outside[0], side="right"))
        face = found.corners[ends[bad] - found.sizes[bad] : ends[bad]].tolist()
        raise MeshError(f"{origin}: face {bad} is {face}, but verts are numbered 0 to {len(verts) - 1}")


def _without_repeated_corners(verts: Verts, corners: Indices, sizes: Indices) -> tuple[PolygonMesh, int]:
    """Polygons less the corners that equal the one before, of those that still have three; and how many these were."""
    topology = PolygonTopology(len(verts), corners, sizes)
    fresh = corners != topology.head
    left = np.bincount(topology.face[fresh], minlength=len(sizes))
    whole = left >= 3
    kept = fresh & whole[topology.face]
    return PolygonMesh(verts, corners[kept], left[whole]), int((sizes - left)[whole].sum())


def _sound_faces(mesh: PolygonMesh) -> tuple[PolygonMesh, dict[str, int]]:
    """The mesh without degenerate and duplicate faces, and how many there were."""
    counts = mesh.sizes - 2
    has_area = face_areas(mesh.triangulated()) != 0.0
    sound = np.logical_or.reduceat(has_area, np.cumsum(counts) - counts) if len(has_area) else has_area
    rest = _selected(mesh, sound)
    first = _first_alike(rest)
    return _selected(rest, first), {
        "degenerate faces": int((~sound).sum()),
        "duplicate faces": int((~first).sum()),
    }


def _selected(mesh: PolygonMesh, faces: Mask) -> PolygonMesh:
    return PolygonMesh(mesh.verts, mesh.corners[np.repeat(faces, mesh.sizes)], mesh.sizes[faces])


def _first_alike(mesh: PolygonMesh) -> Mask:
    """(F,) which faces are the first with their corners, wherever these begin and whichever way they go round."""
    first = np.zeros(mesh.num_faces, dtype=bool)
    for size in np.unique(mesh.sizes):
        faces = np.flatnonzero(mesh.sizes == size)
        rows = mesh.corners[mesh.starts[faces][:, None] + np.arange(size)]
        places = rows.argmin(axis=1)[:, None] + np.arange(size)
        ahead = np.take_along_axis(rows, places % size, axis=1)
        backwards = ahead[:, 1] > ahead[:, -1]
        ahead[backwards, 1:] = ahead[backwards, :0:-1]
        first[faces] = _first_equal(ahead) == np.arange(len(faces))
    return first


def _marked(verts: Indices, num_verts: int) -> Mask:
    mark = np.zeros(num_verts, dtype=bool)
    mark[verts] = True
    return mark


def _first_equal(rows: NDArray[np.generic]) -> Indices:
    """(N,) for each row, the first row that equals it. Faster than `np.unique` by rows, and 0.0 is -0.0."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[np.flatnonzero(starts)][np.cumsum(starts) - 1]
    return first


def _warn_of_shape(topology: HalfEdges, origin: str) -> None:
    pieces = num_components(topology)
    findings = {
        "non-manifold edges (three faces or more)": len(nonmanifold_edges(topology)),
        "edges between faces of opposite orientation": len(misoriented_edges(topology)),
        "boundary edges: the surface is open": int(topology.boundary_edges.sum()),
        "separate components": pieces if pieces > 1 else 0,
    }
    for what, count in findings.items():
        if count:
            _warn(f"{origin}: {count} {what}")


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=4)
