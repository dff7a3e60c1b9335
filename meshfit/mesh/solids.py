"""Named control meshes: regular solids with vertices on the unit sphere and faces counter-clockwise from outside."""

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh


def _hull(verts: ArrayLike, faces: ArrayLike) -> Mesh:
    """Return a convex solid about the origin with its faces turned outwards."""
    points = np.array(verts, dtype=np.float64)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rows = np.array(faces)
    inward = np.linalg.det(points[rows]) < 0
    rows[inward] = rows[inward][:, ::-1]
    return Mesh(points, rows)


def tetrahedron() -> Mesh:
    """Return a tetrahedron: 4 vertices of valence 3, 4 faces."""
    return _hull([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], list(itertools.combinations(range(4), 3)))


def octahedron() -> Mesh:
    """Return an octahedron: 6 vertices of valence 4, 8 faces."""
    verts = [(1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -1.0, 0), (0, 0, 1.0), (0, 0, -1.0)]
    return _hull(verts, list(itertools.product((0, 1), (2, 3), (4, 5))))


def cube() -> Mesh:
    """Return a cube: 8 vertices of valence 6 and 3, and 12 faces, by one diagonal between even corners per side."""
    verts = list(itertools.product((-1.0, 1.0), repeat=3))
    faces = []
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        corners = [i for i, vert in enumerate(verts) if vert[axis] == side]
        even = [i for i in corners if np.prod(verts[i]) > 0]
        faces += [(even[0], even[1], i) for i in corners if i not in even]
    return _hull(verts, faces)


def quad_cube() -> PolygonMesh:
    """Return a cube: 8 vertices, 6 quads."""
    verts = cube().verts
    sides = np.argsort(verts, axis=0, kind="stable").T.reshape(6, 4)
    quads = sides[:, [0, 1, 3, 2]]
    inward = np.linalg.det(verts[quads[:, :3]]) < 0
    quads[inward] = quads[inward][:, ::-1]
    return PolygonMesh(verts, quads.reshape(-1), np.full(6, 4))


def icosahedron() -> Mesh:
    """Return an icosahedron: 12 vertices of valence 5, 20 faces."""
    golden = (1 + 5**0.5) / 2
    points = np.array([np.roll((0.0, a, b * golden), i) for i in range(3) for a in (-1, 1) for b in (-1, 1)])
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 2.1
    faces = [
        t for t in itertools.combinations(range(12), 3) if all(near[i, j] for i, j in itertools.combinations(t, 2))
    ]
    return _hull(points, faces)


SOLIDS: dict[str, Callable[[], Mesh]] = {
    "icosahedron": icosahedron,
    "octahedron": octahedron,
    "tetrahedron": tetrahedron,
    "cube": cube,
}
POLYGON_SOLIDS: dict[str, Callable[[], PolygonMesh]] = {"cube": quad_cube}
"""Solids with faces that are not triangles, for schemes on polygons, under the same names."""
