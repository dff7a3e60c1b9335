"""Where on a surface a result is off: the distance of each of its verts to the target."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeasureError
from meshfit.measuring.proximity import point_distances
from meshfit.mesh.mesh import Mesh

_SHOWN = 0.99
_ROUND = (1.0, 1.2, 1.6, 2.0, 2.4, 3.0, 4.0, 5.0, 6.0, 8.0)


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
    return point_distances(target, result.verts) if result.num_verts else np.zeros(0)


def worst_vert(distances: Float64[np.ndarray, " V"]) -> int:
    """The index of the vert that is farthest from the target; the first of several.

    Raises:
        MeasureError: there are no verts.
    """
    if not len(distances):
        raise MeasureError("a mesh without verts has no worst one")
    return int(np.argmax(distances))


def shared_limit(distances: Sequence[Float64[np.ndarray, " V"]]) -> float:
    """Where a scale of colours ends that several meshes share: a round number that holds 99 of 100 verts of each.

    With the largest distance at its end, one vert that is far off would make all the others look alike.
    """
    reached = max((float(np.quantile(each, _SHOWN)) for each in distances if len(each)), default=0.0)
    if not reached > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(reached))
    return float(next((step * power for step in _ROUND if step * power >= reached), 10.0 * power))
