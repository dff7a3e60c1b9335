"""A mesh in plain Python, walked face by face, on which naive twins of the schemes are built."""

import numpy as np

from meshfit.mesh.mesh import Mesh


class Walk:
    """Neighbourhoods looked up in dictionaries keyed by directed edges."""

    def __init__(self, mesh: Mesh) -> None:
        self.points = [np.array(vert) for vert in mesh.verts]
        self.faces = [tuple(face) for face in mesh.faces.tolist()]
        self.apex = {(f[k], f[(k + 1) % 3]): f[(k + 2) % 3] for f in self.faces for k in range(3)}
        self.rim = {tail: head for tail, head in self.apex if (head, tail) not in self.apex}
        self.back = {head: tail for tail, head in self.rim.items()}
        self.neighbours = [set() for _ in self.points]
        for tail, head in self.apex:
            self.neighbours[tail].add(head)
            self.neighbours[head].add(tail)

    def edges(self):
        """Each undirected edge once; those on the rim in their faces' direction."""
        return [(a, b) for a, b in self.apex if a < b or (b, a) not in self.apex]

    def valence(self, vert: int) -> int:
        return len(self.neighbours[vert])

    def is_inner(self, vert: int) -> bool:
        return vert not in self.rim

    def is_extraordinary(self, vert: int) -> bool:
        return self.is_inner(vert) and self.valence(vert) != 6

    def ring(self, vert: int, first: int) -> list[int]:
        """Around an inner vertex, counter-clockwise: after w comes the apex of the face to the left of (vert, w)."""
        ring = [first]
        while len(ring) < self.valence(vert):
            ring.append(self.apex[vert, ring[-1]])
        return ring

    def beyond(self, tail: int, head: int) -> np.ndarray:
        """Across a directed edge of a face: the vertex there, or else the face's own apex mirrored in the midpoint."""
        if (head, tail) in self.apex:
            return self.points[self.apex[head, tail]]
        return self.points[tail] + self.points[head] - self.points[self.apex[tail, head]]

    def along(self, tail: int, head: int) -> list[np.ndarray]:
        """Of a rim edge: the point before, both ends, the point after."""
        return [self.points[vert] for vert in (self.back[tail], tail, head, self.rim[head])]


def weighted(weights, points) -> np.ndarray:
    return sum(weight * point for weight, point in zip(weights, points, strict=True))


def same_face_sets(one, other) -> bool:
    """Whether two lists of faces agree, wherever their rows start."""
    return {started_at_least(face) for face in one} == {started_at_least(face) for face in other}


def started_at_least(face) -> tuple[int, ...]:
    k = int(np.argmin(face))
    return tuple(int(v) for v in (*face[k:], *face[:k]))
