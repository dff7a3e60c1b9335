"""Control meshes and curves on which a scheme is drawn, with extraordinary vertices of low and high valence."""

import itertools

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.mesh.curves import Curves
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh

_CORE = 1.0
_REACH = 2.6
_WIDE, _NARROW = 2.4, 1.1
_POINTS, _NOTCH = 5, 0.45


def jack_quads() -> PolygonMesh:
    """Return a toy jack, a cube with six arms: 32 vertices, of valence 6 at the cube and 3 at the tips, 30 quads."""
    corners = list(itertools.product((-_CORE, _CORE), repeat=3))
    verts = [np.array(corner) for corner in corners]
    faces: list[tuple[int, ...]] = []
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        base = [i for i, corner in enumerate(corners) if corner[axis] == side * _CORE]
        about = [(axis + 1) % 3, (axis + 2) % 3]
        base.sort(key=lambda i: float(np.arctan2(verts[i][about[1]], verts[i][about[0]])) * side)
        tips = range(len(verts), len(verts) + 4)
        verts += [np.where(np.arange(3) == axis, side * _REACH, verts[i]) for i in base]
        faces += [(base[k], base[(k + 1) % 4], tips[(k + 1) % 4], tips[k]) for k in range(4)]
        faces.append(tuple(tips))
    return _of_quads(np.array(verts), np.array(faces))


def jack_triangles() -> Mesh:
    """Return the jack with every quad cut in two, so that vertices have the valences 3, 6 and 12.

    Diagonals join corners of even sign, which keeps the symmetries of a tetrahedron.
    """
    jack = jack_quads()
    verts, quads = jack.verts, jack.corners.reshape(-1, 4)
    even = np.prod(verts[quads[:, 0]], axis=1) > 0
    turned = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    return Mesh(verts, np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]]))


def frame_quads() -> PolygonMesh:
    """Return a square frame of 16 vertices and 16 quads around a hole, every vertex of valence 4."""
    around, about = np.divmod(np.arange(16), 4)
    angle, radius = (around + 1 / 2) * np.pi / 2, np.where(about < 2, _WIDE, _NARROW)
    level = np.where((about == 1) | (about == 2), _CORE, -_CORE) / 2
    verts = np.stack([radius * np.cos(angle), level, -radius * np.sin(angle)], axis=1)
    here, onward = 4 * around + about, 4 * around + (about + 1) % 4
    quads = np.stack([here, (here + 4) % 16, (onward + 4) % 16, onward], axis=1)
    return _of_quads(verts, quads)


def _of_quads(verts: Float64[np.ndarray, "V 3"], quads: Int64[np.ndarray, "F 4"]) -> PolygonMesh:
    return PolygonMesh(verts, quads.reshape(-1), np.full(len(quads), 4))


def star() -> Curves:
    """Return a closed star of five points."""
    angle = np.pi / 2 + np.arange(2 * _POINTS) * np.pi / _POINTS
    radius = np.where(np.arange(2 * _POINTS) % 2, _NOTCH, 1.0)
    return Curves.through(np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1), closed=True)
