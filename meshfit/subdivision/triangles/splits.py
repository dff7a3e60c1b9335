"""Splits of triangles: the finer connectivity, and the edge or face that each new vertex belongs to."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from meshfit.mesh.mesh import Faces
from meshfit.mesh.topology import NONE, Indices, Topology, next_in_face, previous_in_face
from meshfit.subdivision.triangles.scheme import Split


@dataclass(frozen=True, eq=False)
class Division:
    """The finer connectivity of one level. New vertices follow the old: inner ones first, then those on the boundary.

    Attributes:
        faces: (F', 3) the finer faces.
        inner: (N,) a half-edge of the interior edge, or face, of each inner new vertex.
        inner_place: (N,) its row, counted from the first new vertex.
        border: (B,) boundary half-edges in which new vertices are inserted.
        border_place: for each vertex inserted in one edge, (B,) its row, counted from the first new vertex.
        moves_border: whether old boundary vertices move in this step.
    """

    faces: Faces
    inner: Indices
    inner_place: Indices
    border: Indices
    border_place: tuple[Indices, ...]
    moves_border: bool

    @property
    def num_new(self) -> int:
        """The number of inserted vertices."""
        return len(self.inner) + len(self.border) * len(self.border_place)


def divide(topology: Topology, split: Split, step: int) -> Division:
    """Divide every face.

    Args:
        topology: an oriented manifold.
        split: the kind of split.
        step: number of levels already applied to the control mesh; √3 trisects boundary edges at every second one.
    """
    if split is Split.QUADRISECT:
        return _quadrisect(topology)
    return _sqrt3(topology, trisect=step % 2 == 1)


def triangle_parents(topology: Topology, split: Split) -> Indices:
    """Return the (F',) old face that each finer one comes from, in the order of `divide`.

    Where √3 flips an old edge, each of the two faces over it goes to one of the two old faces at it, so that all old
    faces have three children.
    """
    if split is Split.QUADRISECT:
        return np.repeat(np.arange(topology.num_faces), 4)
    left = np.flatnonzero(topology.twin > np.arange(topology.faces.size))
    flipped = np.stack([left, topology.twin[left]], axis=1).reshape(-1)
    return np.asarray(np.concatenate([flipped, np.flatnonzero(topology.twin == NONE)]) // 3)


def _quadrisect(topology: Topology) -> Division:
    """The new vertex of edge e is V + e; the four parts of face f are faces 4f to 4f + 3, its middle last."""
    middle = (topology.num_verts + topology.edge_of).reshape(-1, 3)
    before = np.roll(middle, 1, axis=1)
    corners = np.stack([topology.faces, middle, before], axis=2)
    faces = np.concatenate([corners, middle[:, None, :]], axis=1).reshape(-1, 3)
    on_border = topology.boundary_edges
    halfedge = topology.edge_halfedge
    return Division(
        faces,
        inner=halfedge[~on_border],
        inner_place=np.flatnonzero(~on_border),
        border=halfedge[on_border],
        border_place=(np.flatnonzero(on_border),),
        moves_border=True,
    )


def _sqrt3(topology: Topology, *, trisect: bool) -> Division:
    """Kobbelt 2000, √3-subdivision, section 5 for the boundary.

    A face with a boundary edge gets no vertex of its own in a trisecting step: its two old inner edges are flipped to
    the nearer of the two vertices that trisect the boundary edge.
    """
    border = np.flatnonzero(topology.twin == NONE) if trisect else np.empty(0, dtype=np.int64)
    split_faces = _faces_without(border, topology.num_faces)
    num_inner = int(split_faces.sum())
    first = topology.num_verts + num_inner
    near_tail, near_head = first + np.arange(len(border)), first + len(border) + np.arange(len(border))

    centre = np.repeat(topology.num_verts + np.cumsum(split_faces) - 1, 3)
    centre[next_in_face(border)], centre[previous_in_face(border)] = near_head, near_tail
    centre[border] = NONE

    left = np.flatnonzero(topology.twin > np.arange(topology.faces.size))
    right = topology.twin[left]
    a, b, s, t = topology.tail[left], topology.head[left], centre[left], centre[right]
    flipped = np.stack([np.stack([a, t, s], axis=1), np.stack([b, s, t], axis=1)], axis=1).reshape(-1, 3)
    kept = np.flatnonzero(topology.twin == NONE)
    if trisect:
        outer = np.stack([near_tail, near_head, topology.apex[border]], axis=1)
    else:
        outer = np.stack([topology.tail[kept], topology.head[kept], centre[kept]], axis=1)
    return Division(
        np.concatenate([flipped, outer]),
        inner=3 * np.flatnonzero(split_faces),
        inner_place=np.arange(num_inner),
        border=border,
        border_place=(near_tail - topology.num_verts, near_head - topology.num_verts),
        moves_border=trisect,
    )


def _faces_without(border: Indices, num_faces: int) -> Bool[np.ndarray, " F"]:
    untouched = np.ones(num_faces, dtype=bool)
    untouched[border // 3] = False
    return untouched
