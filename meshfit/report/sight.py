"""What is in sight: whether a point of a mesh is hidden by the mesh itself."""

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.report.camera import Camera

_NEARER = 0.01


def in_sight(mesh: Mesh, vert: int, camera: Camera) -> bool:
    """Whether no face lies before a vert, as seen from a camera.

    Args:
        mesh: the mesh.
        vert: index of the vert.
        camera: where from.
    """
    seen = camera.project(mesh.verts)
    point = seen[vert]
    corners = seen[mesh.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = point - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    some = area != 0
    area = np.where(some, area, 1.0)
    u = (to[:, 0] * second[:, 1] - to[:, 1] * second[:, 0]) / area
    v = (first[:, 0] * to[:, 1] - first[:, 1] * to[:, 0]) / area
    covers = some & (u >= 0) & (v >= 0) & (u + v <= 1)
    depth = corners[:, 0, 2] + u * first[:, 2] + v * second[:, 2]
    return not bool((covers & (depth > point[2] + _NEARER)).any())
