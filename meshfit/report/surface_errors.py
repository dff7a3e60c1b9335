"""Where on a surface a result is off: the distance of each of its verts to the target."""

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeasureError
from meshfit.measuring.proximity import distance_of_each
from meshfit.mesh.mesh import Mesh


def distances_to(result: Mesh, target: Mesh) -> Float64[np.ndarray, " V"]:
    """(V,) the distance from each vert of a result to the target's surface, in the unit that both are in.

    The largest is at most the Hausdorff distance from the result to the target: that one looks within faces too.

    Raises:
        MeasureError: the target has no faces, or a coordinate is not finite.
    """
    if not target.num_faces:
        raise MeasureError("the target has no faces, so there is no surface to measure distances to")
    if not (np.isfinite(result.verts).all() and np.isfinite(target.verts).all()):
        raise MeasureError("distances need coordinates that are finite")
    return distance_of_each(target, result.verts) if result.num_verts else np.zeros(0)


def worst_vert(distances: Float64[np.ndarray, " V"]) -> int:
    """The index of the vert that is farthest from the target; the first of several.

    Raises:
        MeasureError: there are no verts.
    """
    if not len(distances):
        raise MeasureError("a mesh without verts has no worst one")
    return int(np.argmax(distances))
