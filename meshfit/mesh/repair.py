"""From the raw arrays of a file to a mesh to be trusted: refuse what is meaningless, mend what is harmless, say so."""

import warnings

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import DomainError, MeshError, MeshfitWarning
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import misoriented_edges, nonmanifold_edges, num_components
from meshfit.mesh.mesh import Faces, Mesh
from meshfit.mesh.topology import Indices, Topology

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
    _require_sound(verts, faces, origin)
    mesh = weld_seams(Mesh(verts, faces))
    kept, dropped = _sound_faces(mesh)
    if not len(kept):
        raise MeshError(f"{origin}: all {mesh.num_faces} faces are degenerate (no area)")
    dropped["unreferenced verts"] = int((~_marked(faces, len(verts))).sum())
    used = _marked(kept, len(verts))
    result = Mesh(mesh.verts[used], (np.cumsum(used) - 1)[kept])
    for what, count in dropped.items():
        if count:
            _warn(f"{origin}: dropped {count} {what}")
    _warn_of_shape(Topology.of(result), origin)
    return result


def weld_seams(mesh: Mesh) -> Mesh:
    """Let faces share verts that lie at the same position on a boundary, as file formats split them along seams.

    Coincident verts off the boundary stay apart: there a closed surface touches itself, and welding would tear it.
    """
    topology = Topology.of(mesh)
    seam = np.flatnonzero(topology.boundary_verts)
    target = np.arange(mesh.num_verts)
    target[seam] = seam[_first_equal(mesh.verts[seam])]
    return Mesh(mesh.verts, target[mesh.faces])


def require_sound_verts(verts: NDArray[np.floating], origin: str) -> None:
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


def _require_sound(verts: NDArray[np.floating], faces: NDArray[np.integer], origin: str) -> None:
    if not len(verts):
        raise MeshError(f"{origin}: the mesh has no verts")
    if not len(faces):
        raise DomainError(f"{origin}: the mesh has {len(verts)} verts and no faces; a surface of triangles is needed")
    require_sound_verts(verts, origin)
    outside = ((faces < 0) | (faces >= len(verts))).any(axis=1)
    if outside.any():
        bad = int(np.flatnonzero(outside)[0])
        raise MeshError(f"{origin}: face {bad} is {faces[bad].tolist()}, but verts are numbered 0 to {len(verts) - 1}")


def _sound_faces(mesh: Mesh) -> tuple[Faces, dict[str, int]]:
    degenerate = face_areas(mesh) == 0.0
    faces = mesh.faces[~degenerate]
    kept = faces[_first_equal(np.sort(faces, axis=1)) == np.arange(len(faces))]
    return kept, {"degenerate faces": int(degenerate.sum()), "duplicate faces": len(faces) - len(kept)}


def _marked(faces: NDArray[np.integer], num_verts: int) -> NDArray[np.bool_]:
    mark = np.zeros(num_verts, dtype=bool)
    mark[faces] = True
    return mark


def _first_equal(rows: NDArray[np.generic]) -> Indices:
    """(N,) for each row of three, the first row that equals it. Faster than `np.unique` by rows, and 0.0 is -0.0."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[np.flatnonzero(starts)][np.cumsum(starts) - 1]
    return first


def _warn_of_shape(topology: Topology, origin: str) -> None:
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
