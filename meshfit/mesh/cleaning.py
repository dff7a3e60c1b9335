"""Clean the raw arrays of a file: refuse meaningless meshes, repair harmless faults, and warn of each."""

import warnings

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import DomainError, MeshError, MeshfitWarning
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import misoriented_edges, nonmanifold_edges, num_components
from meshfit.mesh.mesh import Verts
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.mesh.topology import NONE, HalfEdges, Indices, Mask, PolygonTopology

# Areas and their squares stay finite up to here.
_LARGEST_COORDINATE = 1e60


def clean(soup: PolygonSoup, origin: str) -> tuple[PolygonMesh, Indices]:
    """Return a mesh without seams, degenerate or duplicate faces and unused vertices, and the index of each vertex.

    Boundary vertices at equal positions, which file formats split along seams, are merged. Coincident vertices off the
    boundary stay separate: there a closed surface touches itself, and merging would tear it. A corner that repeats the
    previous one is dropped; a polygon is degenerate if no triangle of its fan has an area.

    Args:
        soup: N positions, and polygons.
        origin: name of the mesh in messages, usually its path.

    Returns:
        The mesh, and (N,) the index in it of each given vertex, `NONE` for dropped ones.

    Raises:
        MeshError: no vertices or faces, a coordinate that is not finite or beyond 1e60, a face with an index out of
            range, or no area at all.

    Warns:
        MeshfitWarning: with the number of dropped elements of each kind, and where the surface is not one closed
            manifold.
    """
    _require_valid(soup, origin)
    raw = PolygonMesh(*soup)
    welded = _weld_targets(PolygonTopology.of(raw), raw.verts)
    mesh, repeated = _without_repeated_corners(raw.verts, welded[raw.corners], raw.sizes)
    result, dropped = _without_bad_faces(mesh)
    dropped["degenerate faces"] += raw.num_faces - mesh.num_faces
    if not result.num_faces:
        raise MeshError(f"{origin}: all {raw.num_faces} faces are degenerate (no area)")
    unreferenced = int((~_marked(raw.corners, raw.num_verts)).sum())
    dropped |= {"repeated corners": repeated, "unreferenced vertices": unreferenced}
    used = _marked(result.corners, raw.num_verts)
    number = np.where(used, np.cumsum(used) - 1, NONE)
    result = PolygonMesh(raw.verts[used], number[result.corners], result.sizes)
    for kind, count in dropped.items():
        if count:
            _warn(f"{origin}: dropped {count} {kind}")
    _warn_of_shape(PolygonTopology.of(result), origin)
    return result, number[welded]


def _weld_targets(topology: HalfEdges, verts: Verts) -> Indices:
    """Return (V,) the vertex that each one is merged into."""
    seam = np.flatnonzero(topology.boundary_verts)
    target = np.arange(topology.num_verts)
    target[seam] = seam[_first_equal(verts[seam])]
    return target


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
        raise DomainError(f"{origin}: expected a surface, got a mesh of {len(verts)} vertices and no faces")
    require_finite_verts(verts, origin)
    outside = np.flatnonzero((soup.corners < 0) | (soup.corners >= len(verts)))
    if len(outside):
        ends = np.cumsum(soup.sizes)
        bad = int(np.searchsorted(ends, outside[0], side="right"))
        face = soup.corners[ends[bad] - soup.sizes[bad] : ends[bad]].tolist()
        raise MeshError(f"{origin}: face {bad} is {face}, but vertices are numbered 0 to {len(verts) - 1}")


def _without_repeated_corners(verts: Verts, corners: Indices, sizes: Indices) -> tuple[PolygonMesh, int]:
    """Drop repeated corners, then polygons of fewer than three; return how many corners the other polygons lost."""
    topology = PolygonTopology(len(verts), corners, sizes)
    differs = corners != topology.head
    remaining = np.bincount(topology.face[differs], minlength=len(sizes))
    whole = remaining >= 3
    kept = differs & whole[topology.face]
    return PolygonMesh(verts, corners[kept], remaining[whole]), int((sizes - remaining)[whole].sum())


def _without_bad_faces(mesh: PolygonMesh) -> tuple[PolygonMesh, dict[str, int]]:
    """Drop degenerate and duplicate faces, and count them."""
    counts = mesh.sizes - 2
    has_area = face_areas(mesh.triangulated()) != 0.0
    kept = np.logical_or.reduceat(has_area, np.cumsum(counts) - counts) if len(has_area) else has_area
    rest = _selected(mesh, kept)
    first = _first_of_duplicates(rest)
    return _selected(rest, first), {
        "degenerate faces": int((~kept).sum()),
        "duplicate faces": int((~first).sum()),
    }


def _selected(mesh: PolygonMesh, faces: Mask) -> PolygonMesh:
    return PolygonMesh(mesh.verts, mesh.corners[np.repeat(faces, mesh.sizes)], mesh.sizes[faces])


def _first_of_duplicates(mesh: PolygonMesh) -> Mask:
    """Return (F,) which faces are the first with their corners, whatever the starting corner and the direction."""
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
    """Return (N,) the first row equal to each row. Faster than `np.unique` by rows, and 0.0 equals -0.0."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[np.flatnonzero(starts)][np.cumsum(starts) - 1]
    return first


def _warn_of_shape(topology: HalfEdges, origin: str) -> None:
    components = num_components(topology)
    findings = {
        "non-manifold edges (three faces or more)": len(nonmanifold_edges(topology)),
        "edges between faces of opposite orientation": len(misoriented_edges(topology)),
        "boundary edges: the surface is open": int(topology.boundary_edges.sum()),
        "separate components": components if components > 1 else 0,
    }
    for finding, count in findings.items():
        if count:
            _warn(f"{origin}: {count} {finding}")


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=4)
