"""Projection of attributes: those of a surface, taken over by another mesh whose vertices have places on it.

Vertex data are interpolated within the face of the surface that is nearest to the place of the vertex. A face takes the
data of the face nearest to its middle. Corner data with seams, such as texture coordinates, are found by walking on the
surface from the middle of the face towards each of its corners, unless no seam can lie between them; a walk ends where
it meets a seam, so that no face has coordinates from both sides of one. It crosses edges that are joined at one end, at
poles and where seams end.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.mesh.attributes import NO_ATTRIBUTES, Attributes, Values
from meshfit.mesh.interpolation import barycentric_operator, interpolated, interpolated_rows
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.proximity import Points, nearest_on_surface
from meshfit.mesh.seams import at_verts, joined_edges
from meshfit.mesh.topology import NONE, Indices, Mask, Topology

Weights = Float64[np.ndarray, "N 3"]
Shares = Float64[np.ndarray, " N"]
# A point this far outside a triangle, in barycentric coordinates, is on its edge.
_ON_EDGE = 1e-9
_MOST_FACES_OF_WALK, _MOST_EDGES_ALONG_SEAM = 1000, 100
# Values of corners at one vertex are the same if they differ by less than this share of the range.
_SAME = 1e-7


@dataclass(frozen=True, eq=False)
class Places:
    """Points on a surface.

    Attributes:
        face: (N,) the face with each point.
        weights: (N, 3) its barycentric coordinates there.
    """

    face: Int64[np.ndarray, " N"]
    weights: Weights

    @classmethod
    def nearest(cls, surface: Mesh, points: Points) -> "Places":
        """Return the points of a surface that are nearest to some points."""
        near = nearest_on_surface(surface, points)
        return cls(near.faces, _normalised(_barycentric(surface.verts[surface.faces[near.faces]], near.points)))

    def points(self, surface: Mesh) -> Points:
        """Return their positions."""
        return np.asarray(np.einsum("nc,ncd->nd", self.weights, surface.verts[surface.faces[self.face]]))

    def __getitem__(self, chosen: Indices | Mask) -> "Places":
        """Return some of the points."""
        return Places(self.face[chosen], self.weights[chosen])


def projected_attributes(mesh: Mesh | PolygonMesh, places: Verts, surface: Mesh) -> Attributes:
    """Return the attributes that a mesh takes over from a surface.

    Args:
        mesh: V vertices.
        places: (V, 3) points on the surface, or near it, that correspond to the vertices.
        surface: with attributes.
    """
    attributes, polygons = surface.attributes, PolygonMesh.of(mesh)
    if not attributes or not mesh.num_faces or not surface.num_faces:
        return NO_ATTRIBUTES
    at = Places.nearest(surface, places)
    on_surface = at.points(surface)
    sums = np.add.reduceat(on_surface[polygons.corners], polygons.starts)
    middle = Places.nearest(surface, sums / polygons.sizes[:, None])
    operator = barycentric_operator(surface.faces[at.face], at.weights, surface.num_verts)
    topology = Topology.of(surface)
    corner = {}
    for name, values in attributes.corner.items():
        if joined_edges(topology, values)[topology.twin != NONE].all():
            corner[name] = interpolated(name, at_verts(topology, values), [operator])[polygons.corners]
        else:
            corner[name] = _beside_seams(name, values, surface, polygons, at, middle)
    return replace(
        attributes,
        vertex=interpolated_rows(attributes.vertex, [operator]),
        face={name: values[middle.face] for name, values in attributes.face.items()},
        corner=corner,
    )


def carried_places(before: Mesh, places: Verts, verts: Points) -> Points:
    """Return the places of other vertices on the same surface, interpolated where they are nearest to it.

    Args:
        before: V vertices of the surface.
        places: (V, 3) what corresponds to them.
        verts: (N, 3) the other vertices.
    """
    at = Places.nearest(before, verts)
    return np.asarray((at.weights[:, :, None] * places[before.faces[at.face]]).sum(axis=1))


def _beside_seams(
    name: str, values: Values, surface: Mesh, polygons: PolygonMesh, at: Places, middle: Places
) -> Values:
    """Return the values at the corners of a mesh, of corner data of a surface that has seams.

    Args:
        name: of the data.
        values: at the corners of the surface.
        surface: the surface.
        polygons: the mesh.
        at: the places of its vertices on the surface.
        middle: those of the middles of its faces.
    """
    topology, corners = Topology.of(surface), polygons.corners
    face = np.repeat(np.arange(polygons.num_faces), polygons.sizes)
    found = _at_corners(name, values, at)[corners]
    far = ~_beside(topology, joined_edges(topology, values), middle.face[face], at.face[corners])
    walk = _Walk(surface, topology, joined_edges(topology, values, at_one_end=True))
    found[far] = _at_corners(name, values, walk.to(middle[face[far]], at[corners[far]]))
    walked = np.zeros(polygons.num_verts, dtype=bool)
    walked[corners[far]] = True
    near = walked[corners]
    found[near] = _equal_at_verts(found[near], corners[near])
    return np.asarray(found)


def _beside(topology: Topology, joined: Mask, first: Indices, second: Indices) -> Mask:
    """Return which pairs of faces are the same, or have an edge or a vertex in common that is on no seam.

    Args:
        topology: of the surface.
        joined: (3F,) which of its half-edges are on no seam, nor at the boundary.
        first: (N,) faces.
        second: (N,) faces.
    """
    beside = first == second
    twin, is_joined = topology.twin.reshape(-1, 3), joined.reshape(-1, 3)
    for side in range(3):
        beside |= is_joined[first, side] & (twin[first, side] // 3 == second)
    on_seam = np.zeros(topology.num_verts, dtype=bool)
    on_seam[topology.tail[~joined]] = on_seam[topology.head[~joined]] = True
    left = np.flatnonzero(~beside)
    verts, others = topology.faces[first[left]], topology.faces[second[left]]
    for corner in range(3):
        vert = verts[:, corner]
        beside[left] |= ~on_seam[vert] & (others == vert[:, None]).any(axis=1)
    return np.asarray(beside)


def _at_corners(name: str, values: Values, ends: Places) -> Values:
    corners = 3 * ends.face[:, None] + np.arange(3)
    return interpolated(name, values, [barycentric_operator(corners, ends.weights, len(values))])


def _equal_at_verts(values: Values, corners: Indices) -> Values:
    """Make values at the corners of one vertex equal that are equal up to rounding, so that no seam is between them."""
    if not np.issubdtype(values.dtype, np.floating):
        return values
    rows = values.reshape(len(values), -1)
    step = _SAME * float(np.ptp(rows)) or 1.0
    keys = np.column_stack([corners, np.rint((rows - rows.min(initial=0.0)) / step).astype(np.int64)])
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return np.asarray(values[first[which.reshape(-1)]])


@dataclass(frozen=True, eq=False)
class _Walk:
    """Walks on a surface that do not cross seams.

    Attributes:
        surface: the surface.
        topology: its connectivity.
        joined: (3F,) which half-edges are no seams, and have a twin.
    """

    surface: Mesh
    topology: Topology
    joined: Mask

    @cached_property
    def _chart(self) -> Indices:
        """The chart of each face, which seams separate from others."""
        side = np.flatnonzero(self.joined)
        return graph_components(side // 3, self.topology.twin[side] // 3, self.surface.num_faces)[1]

    def to(self, starts: Places, ends: Places) -> Places:
        """Walk from each start straight towards an end; return where the walk leads: there, or to a seam.

        On the seam, it goes on along it for as long as it comes nearer to the end. A walk that goes astray, on a
        surface with folds, is taken for complete if its end is in the same chart.
        """
        goals = ends.points(self.surface)
        astray = np.ones(len(goals), dtype=bool)
        face, weights = starts.face.copy(), starts.weights.copy()
        entered = np.full(len(face), NONE, dtype=np.int64)
        active = np.arange(len(face))
        for _ in range(_MOST_FACES_OF_WALK):
            if not len(active):
                break
            ahead = _barycentric(self.surface.verts[self.surface.faces[face[active]]], goals[active])
            inside = (ahead >= -_ON_EDGE).all(axis=1)
            weights[active[inside]] = _normalised(ahead[inside])
            astray[active[inside]] = False
            active, ahead = active[~inside], ahead[~inside]
            side, crossing = _exits(weights[active], ahead)
            halfedge = 3 * face[active] + (side + 1) % 3
            weights[active] = crossing
            stops = ~self.joined[halfedge] | (halfedge == entered[active])
            stopped = active[stops]
            astray[active[~self.joined[halfedge] & (self.topology.twin[halfedge] != NONE)]] = False
            face[stopped], weights[stopped] = self._along_seams(halfedge[stops], goals[stopped])
            active, halfedge, side, crossing = active[~stops], halfedge[~stops], side[~stops], crossing[~stops]
            twin, rows = self.topology.twin[halfedge], np.arange(len(active))
            face[active], entered[active] = twin // 3, twin
            turned = np.zeros((len(active), 3))
            turned[rows, twin % 3] = crossing[rows, (side + 2) % 3]
            turned[rows, (twin + 1) % 3] = crossing[rows, (side + 1) % 3]
            weights[active] = turned
        astray &= self._chart[face] == self._chart[ends.face]
        face[astray], weights[astray] = ends.face[astray], ends.weights[astray]
        return Places(face, weights)

    def _along_seams(self, halfedge: Indices, goals: Points) -> tuple[Indices, Weights]:
        """Walk along the edges of charts, from some half-edges; return the faces and weights of the nearest points."""
        halfedge, share = halfedge.copy(), self._share(halfedge, goals)
        active = np.flatnonzero((share == 0) | (share == 1))
        for _ in range(_MOST_EDGES_ALONG_SEAM):
            if not len(active):
                break
            forwards = share[active] == 1
            further = self._next_on_border(halfedge[active], forwards=forwards)
            share_there = self._share(further, goals[active])
            nearer = (further != NONE) & np.where(forwards, share_there > 0, share_there < 1)
            active = active[nearer]
            halfedge[active], share[active] = further[nearer], share_there[nearer]
            active = active[share[active] == np.where(forwards[nearer], 1, 0)]
        weights, rows, place = np.zeros((len(halfedge), 3)), np.arange(len(halfedge)), halfedge % 3
        weights[rows, place], weights[rows, (place + 1) % 3] = 1 - share, share
        return halfedge // 3, weights

    def _share(self, halfedge: Indices, goals: Points) -> Shares:
        """Return how far along half-edges, from 0 to 1, the points nearest to the goals are."""
        verts, topology = self.surface.verts, self.topology
        tail, head = verts[topology.tail[halfedge]], verts[topology.head[halfedge]]
        along = head - tail
        length = (along * along).sum(axis=1)
        reach = ((goals - tail) * along).sum(axis=1)
        return np.asarray(np.divide(reach, length, out=np.zeros_like(reach), where=length > 0).clip(0, 1))

    def _next_on_border(self, halfedge: Indices, *, forwards: Mask) -> Indices:
        """Return the half-edge that follows, or precedes, each one along the border of its chart."""
        topology = self.topology

        def turned(side: Indices, ahead: Mask) -> Indices:
            return np.where(ahead, topology.following(side), topology.preceding(side))

        further = turned(halfedge, forwards)
        for _ in range(int(topology.valence.max(initial=0))):
            inner = self.joined[further]
            if not inner.any():
                break
            further[inner] = turned(topology.twin[further[inner]], forwards[inner])
        return np.where(self.joined[further], NONE, further)


def _exits(weights: Weights, ahead: Weights) -> tuple[Indices, Weights]:
    """Return through which side, by its opposite corner, the way to some point leaves a triangle, and where."""
    falls = ahead < -_ON_EDGE
    share = np.divide(weights, weights - ahead, out=np.full_like(weights, np.inf), where=falls)
    side = np.asarray(share.argmin(axis=1))
    rows = np.arange(len(side))
    crossing = weights + share[rows, side][:, None].clip(0, 1) * (ahead - weights)
    crossing[rows, side] = 0.0
    return side, _normalised(crossing)


def _barycentric(triangles: Float64[np.ndarray, "N 3 3"], points: Points) -> Weights:
    """Return the barycentric coordinates of points, projected to the planes of triangles; (1, 0, 0) without area."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    offset = points - origin
    aa, ab, bb = (first * first).sum(1), (first * second).sum(1), (second * second).sum(1)
    pa, pb = (offset * first).sum(1), (offset * second).sum(1)
    area = aa * bb - ab * ab
    usable = area > 1e-14 * aa * bb
    v = np.divide(bb * pa - ab * pb, area, out=np.zeros_like(area), where=usable)
    w = np.divide(aa * pb - ab * pa, area, out=np.zeros_like(area), where=usable)
    return np.stack([1 - v - w, v, w], axis=1)


def _normalised(weights: Weights) -> Weights:
    clipped = weights.clip(0.0, None)
    return np.asarray(clipped / clipped.sum(axis=1, keepdims=True))
