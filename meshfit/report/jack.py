"""The control mesh that limit surfaces are shown of: a cube with an arm on each side, as in the game of jacks."""

import itertools

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.mesh.mesh import Mesh

_CORE = 1.0
_REACH = 2.6


def jack_quads() -> tuple[Float64[np.ndarray, "V 3"], Int64[np.ndarray, "F 4"]]:
    """32 verts, of valence 6 where arms meet and 3 at their ends, and 30 quads, counter-clockwise from outside."""
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
    return np.array(verts), np.array(faces)


def jack_triangles() -> Mesh:
    """The same with every quad cut, so that verts have the valences 3, 6 and 12.

    Diagonals join corners of even sign, which leaves the symmetries of a tetrahedron.
    """
    verts, quads = jack_quads()
    even = np.prod(verts[quads[:, 0]], axis=1) > 0
    turned = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    return Mesh(verts, np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]]))
