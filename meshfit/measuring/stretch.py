"""Stretch: singular values of the map from the faces of a source to those of a result with the same connectivity."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeasureError
from meshfit.mesh.geometry import area_vectors, is_size_kept
from meshfit.mesh.mesh import Mesh

LARGEST = 1e6
"""Stretch of a face that lost its area, and the largest of any."""
# Share of the squared longest edge up to which a face has no area, and so no map from it.
_NO_AREA = 1e-14


@dataclass(frozen=True)
class Stretch:
    """Stretch of the faces of a source, over its area: 1 where lengths are kept, 2 where one doubles or halves.

    It is max(s1, 1/s2) of the singular values s1 ≥ s2 of the affine map from a face of the source to that of the
    result (Sorkine et al. 2002, Bounded-distortion piecewise mesh parameterization), at most a million.

    Attributes:
        p50: median.
        p99: 99th percentile.
        scale: size of the result relative to the source, by which singular values were divided; 1 where the sizes are
            meant to be compared.
    """

    p50: float
    p99: float
    scale: float


def stretch(source: Mesh, result: Mesh, *, scaled: bool | None = None) -> Stretch:
    """Measure how much the faces of a source are stretched.

    Args:
        source: with area.
        result: the same faces.
        scaled: whether the size of the source is without meaning, so that the mean scale is removed: that of lengths,
            as the geometric mean over the source's area. None removes one beyond 1.5 or below its inverse.

    Raises:
        MeasureError: no face of the source has area.
    """
    weights = np.linalg.norm(area_vectors(source), axis=1)
    values, usable = singular_values(source, result)
    if not usable.any():
        raise MeasureError("the source has no area: there is no map from its faces")
    values, weights = values[usable], weights[usable]
    roots = np.sqrt(values.prod(axis=1))
    kept = roots > 0
    scale = float(np.exp(np.average(np.log(roots[kept]), weights=weights[kept]))) if kept.any() else 1.0
    if not (scaled or (scaled is None and not is_size_kept(scale))):
        scale = 1.0
    distortion = np.full(len(values), LARGEST)
    whole = values[:, 1] > 0
    distortion[whole] = np.minimum(np.maximum(values[whole, 0] / scale, scale / values[whole, 1]), LARGEST)
    order = np.argsort(distortion, kind="stable")
    total = weights[order].cumsum()
    median, p99 = distortion[order][np.searchsorted(total, np.array([0.5, 0.99]) * total[-1])]
    return Stretch(float(median), float(p99), scale)


def singular_values(source: Mesh, result: Mesh) -> tuple[Float64[np.ndarray, "F 2"], np.ndarray]:
    """Return (F, 2) singular values of the maps of faces, largest first, and (F,) which faces of the source have area.

    Those of faces without area are 0.
    """
    first, second = (source.verts[source.faces[:, k]] - source.verts[source.faces[:, 0]] for k in (1, 2))
    length = np.linalg.norm(first, axis=1)
    area = np.linalg.norm(np.cross(first, second), axis=1)
    longest = np.maximum(np.maximum(length, np.linalg.norm(second, axis=1)), np.linalg.norm(second - first, axis=1))
    usable = area > _NO_AREA * longest**2
    # In a plane with the first edge along x, the face is (length, 0), (along, height).
    safe = np.where(usable, length, 1.0)
    along, height = (first * second).sum(axis=1) / safe, np.where(usable, area / safe, 1.0)
    to = [result.verts[source.faces[:, k]] - result.verts[source.faces[:, 0]] for k in (1, 2)]
    across = to[0] / safe[:, None]
    up = (to[1] - along[:, None] * across) / height[:, None]
    # Closed form for the Gram matrix of the two columns; the smaller value follows from the ratio of areas.
    squares = (across**2).sum(axis=1), (up**2).sum(axis=1)
    spread = np.hypot(squares[0] - squares[1], 2 * (across * up).sum(axis=1))
    largest = np.sqrt((squares[0] + squares[1] + spread) / 2)
    ratio = np.linalg.norm(np.cross(across, up), axis=1)
    smallest = np.divide(ratio, largest, out=np.zeros_like(ratio), where=largest > 0)
    values = np.stack([largest, np.minimum(smallest, largest)], axis=1)
    return np.where(usable[:, None], values, 0.0), usable
