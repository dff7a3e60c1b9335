"""Pieces of a mesh: faces wound alike, separated where the surface is not manifold, and the crossings between them."""

import numpy as np

from meshfit.mesh.geometry import bounding_box_diagonal, face_areas
from meshfit.mesh.manifold import duplicate_triangles, graph_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import NONE, Indices, Mask, Topology


def manifold_pieces(mesh: Mesh) -> Mesh:
    """Return the same surface as oriented manifold pieces.

    The faces of a piece are wound as most of its area was. Corners of a vertex stay together only across edges of
    exactly two faces that are wound alike; so a surface with one side is cut. Faces without three different corners,
    and both of two triangles with the same three vertices, are dropped, and so are unused vertices.
    """
    corners = mesh.faces
    different = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    mesh = wound_alike(Mesh(mesh.verts, corners[different]))
    split = _split(mesh)
    while len(pairs := duplicate_triangles(Topology.of(split))):
        kept = np.ones(split.num_faces, dtype=bool)
        kept[pairs.reshape(-1)] = False
        split = _split(Mesh(split.verts, split.faces[kept]))
    return split


def wound_alike(mesh: Mesh) -> Mesh:
    """Turn faces such that neighbours are wound alike, as most of the area of their piece is, if it has two sides.

    A mesh without edges between faces of opposite orientation is returned as it is; others lose their attributes.
    """
    topology = Topology.of(mesh)
    if not len(topology.misoriented_edges):
        return mesh
    count = mesh.num_faces
    here = np.flatnonzero(topology.twin > np.arange(len(topology.twin)))
    there = topology.twin[here]
    face, other = topology.face_of(here), topology.face_of(there)
    turned = count * (topology.tail[here] == topology.tail[there])
    sides = np.concatenate([face, face + count]), np.concatenate([other + turned, other + count - turned])
    number, side = graph_components(*sides, 2 * count)
    area = np.bincount(side[:count], weights=face_areas(mesh), minlength=number)
    two_sided = side[:count] != side[count:]
    turn = two_sided & (
        (area[side[count:]] > area[side[:count]])
        | ((area[side[count:]] == area[side[:count]]) & (side[count:] < side[:count]))
    )
    if not turn.any():
        return mesh
    return Mesh(mesh.verts, np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces))


def _split(mesh: Mesh) -> Mesh:
    topology = Topology.of(mesh)
    here = np.flatnonzero(topology.twin > np.arange(len(topology.twin)))
    there = topology.twin[here]
    alike = topology.tail[here] != topology.tail[there]
    here, there = here[alike], there[alike]
    # A half-edge stands for the corner at its tail.
    ends = np.concatenate([here, topology.following(here)]), np.concatenate([topology.following(there), there])
    count, fan = graph_components(*ends, len(topology.tail))
    origin = np.empty(count, dtype=np.int64)
    origin[fan] = topology.tail
    order = np.argsort(origin, kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    # The half-edges of a topology are face by face, from the first corner of each.
    return Mesh(mesh.verts[origin[order]], rank[fan].reshape(-1, 3))


def piece_of_face(mesh: Mesh) -> tuple[int, Indices]:
    """Return the number of pieces, and (F,) the piece of each face."""
    topology = Topology.of(mesh)
    inner = np.flatnonzero(topology.twin != NONE)
    return graph_components(topology.face_of(inner), topology.face_of(topology.twin[inner]), mesh.num_faces)


def crossing_faces(mesh: Mesh) -> tuple[Mask, Mask]:
    """Return (F,) which faces cross any other, and which cross another of their own piece."""
    from meshfit.mesh.meshlab import self_intersecting_faces

    crossing = self_intersecting_faces(mesh)
    within = np.zeros(mesh.num_faces, dtype=bool)
    if not crossing.any():
        return crossing, within
    _, piece = piece_of_face(mesh)
    suspects = np.unique(piece[crossing])
    chosen = np.flatnonzero(np.isin(piece, suspects))
    within[chosen] = crossing_within_pieces(Mesh(mesh.verts, mesh.faces[chosen]), piece[chosen])
    return crossing, within & crossing


def crossing_within_pieces(mesh: Mesh, piece: Indices) -> Mask:
    """Return (F,) which faces cross another of their own piece, by the (F,) numbers of their pieces."""
    from meshfit.mesh.meshlab import self_intersecting_faces

    return self_intersecting_faces(_apart(mesh, piece))


def _apart(mesh: Mesh, piece: Indices) -> Mesh:
    """Move the pieces of a mesh to the places of a cubic grid, so that none crosses another."""
    place = np.unique(piece, return_inverse=True)[1]
    side = int(np.ceil((int(place.max(initial=0)) + 1) ** (1 / 3)))
    cell = np.stack([place % side, place // side % side, place // side**2], axis=1) - (side - 1) / 2
    corners = mesh.verts[mesh.faces] + 1.1 * bounding_box_diagonal(mesh.verts) * cell[:, None, :]
    # Corners of a vertex stay one vertex, as MeshLab takes faces that share a vertex for neighbours.
    _, first, number = np.unique(mesh.faces, return_index=True, return_inverse=True)
    return Mesh(corners.reshape(-1, 3)[first], number.reshape(-1, 3))
