"""Where a shape is best looked at from: the three-quarter view that shows most of it."""

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.geometry import area_vectors, normalised
from meshfit.mesh.mesh import Mesh

Vector = tuple[float, float, float]

_AZIMUTHS = range(-165, 181, 15)
_ELEVATIONS = (15, 30)
_POINTS = 30_000
_CELLS = 56
_BINS = 4
# How much more a shape has to show from its back than from its front, straight on than from three quarters, and from
# high above than from a little above.
_FRONT, _THREE_QUARTER, _LOW = 0.2, 0.2, 0.1


def three_quarter(mesh: Mesh) -> Vector:
    """The unit vector from a mesh, y up, towards the eye that sees most of it.

    Of two rings of directions the one is taken from which the outline is largest and the normals in sight are most
    various, with some preference for the front (towards +z), for three-quarter views, and for the lower ring.

    Args:
        mesh: with at least one face.
    """
    points, normals = _sights(mesh)
    views = [(elevation, azimuth) for elevation in _ELEVATIONS for azimuth in sorted(_AZIMUTHS, key=abs)]
    best = max(views, key=lambda view: round(_shown(points, normals, *view) * _preference(*view), 9))
    return _direction(*best)


def _sights(mesh: Mesh) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, "N 3"]]:
    """Points that cover the surface evenly, in a frame of their own, and its normals there."""
    vectors = area_vectors(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    if not areas.sum() > 0:
        return np.zeros((1, 3)), np.zeros((1, 3))
    generator = np.random.default_rng(0)
    chosen = np.searchsorted(np.cumsum(areas) / areas.sum(), (np.arange(_POINTS) + 0.5) / _POINTS)
    chosen = np.minimum(chosen, mesh.num_faces - 1)
    weights = generator.dirichlet((1.0, 1.0, 1.0), size=_POINTS)
    points = np.einsum("nk,nkc->nc", weights, mesh.verts[mesh.faces[chosen]])
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    return points / (float(np.linalg.norm(points, axis=1).max()) or 1.0), normalised(vectors[chosen])


def _direction(elevation: int, azimuth: int) -> Vector:
    """Straight from the front is azimuth 0; from the mesh's left side, +x, is 90."""
    up, round_ = np.deg2rad(elevation), np.deg2rad(azimuth)
    return float(np.cos(up) * np.sin(round_)), float(np.sin(up)), float(np.cos(up) * np.cos(round_))


def _preference(elevation: int, azimuth: int) -> float:
    radians = np.deg2rad(azimuth)
    low = 1 + _LOW * (elevation == _ELEVATIONS[0])
    return float((1 + _FRONT * np.cos(radians)) * (1 + _THREE_QUARTER * abs(np.sin(2 * radians))) * low)


def _shown(
    points: Float64[np.ndarray, "N 3"], normals: Float64[np.ndarray, "N 3"], elevation: int, azimuth: int
) -> float:
    """The area of the outline, times one plus the entropy of the normals in sight."""
    away = np.asarray(_direction(elevation, azimuth))
    right = np.array([away[2], 0.0, -away[0]]) / np.hypot(away[0], away[2])
    axes = np.array([right, np.cross(away, right), away])
    seen = points @ axes.T
    cells = np.minimum(((seen[:, :2] + 1) / 2 * _CELLS).astype(np.int64), _CELLS - 1)
    nearest = np.full(_CELLS * _CELLS, -1, dtype=np.int64)
    order = np.argsort(seen[:, 2], kind="stable")
    nearest[(cells[:, 0] * _CELLS + cells[:, 1])[order]] = order
    front = nearest[nearest >= 0]
    turned = np.minimum(((normals[front] @ axes[:2].T + 1) / 2 * _BINS).astype(np.int64), _BINS - 1)
    share = np.bincount(turned[:, 0] * _BINS + turned[:, 1], minlength=_BINS**2) / len(front)
    entropy = -float((share[share > 0] * np.log(share[share > 0])).sum()) / np.log(_BINS**2)
    return float(len(front) * (1 + entropy))
