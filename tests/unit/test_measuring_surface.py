"""Surfaces that cannot be measured are refused."""

import numpy as np
import pytest

from meshfit.errors import MeasureError
from meshfit.measuring.distance import surface_distances
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


@over(
    ("verts", "faces", "message"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "nan.* at vertex 2"),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]], "inf.* at vertex 2"),
        ([[0, 0, 0], [1, 0, 0], [0, 1e20, 0]], [[0, 1, 2]], "up to 1e[+]15"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "no area: all its faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.empty((0, 3), dtype=int), "3 vertices and no faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "face 0 is .* numbered 0 to 2"),
    ],
)
def test_a_mesh_without_a_surface_is_refused(verts, faces, message):
    bad = triangles(verts, faces)
    with pytest.raises(MeasureError, match=f"the result.*{message}") as caught:
        surface_distances(bad, cube(), 100, 0)
    assert "\n" not in str(caught.value)
    with pytest.raises(MeasureError, match="the target"):
        surface_distances(cube(), bad, 100, 0)
