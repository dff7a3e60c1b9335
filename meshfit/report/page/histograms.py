"""How much of a result is how far off: the distances of its verts, each counted by the area around it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.mesh import Mesh
from meshfit.report.page.gallery import limit_of
from meshfit.report.page.subjects import Subjects

BINS = 40


@dataclass(frozen=True)
class Histogram:
    """The distances of one result.

    Attributes:
        place: which row of the sheet it belongs to.
        shares: of the area in each bin, in percent.
        beyond: share of the area that is farther off than the last bin, in percent.
    """

    place: int
    shares: tuple[float, ...]
    beyond: float


def histograms_of(subjects: Subjects) -> dict[str, Any]:
    """The histograms of a wall, for the charts; they end where its scale of colours does."""
    limit = limit_of(subjects)
    found = [
        histogram(subject.exhibit.place, subject.result, subject.distances, limit)
        for subject in subjects.shown
        if subject.distances is not None
    ]
    rows = [{"row": each.place, "shares": each.shares, "beyond": each.beyond} for each in found]
    return {"limit": limit, "rows": rows}


def histogram(place: int, mesh: Mesh, distances: Float64[np.ndarray, " V"], limit: float) -> Histogram:
    """The shares of a mesh's area by distance, in even bins from 0 to `limit`."""
    weights = vert_areas(mesh)
    weights = weights / (weights.sum() or 1.0) * 100
    shares, _ = np.histogram(distances, bins=BINS, range=(0.0, limit), weights=weights)
    beyond = float(weights[distances > limit].sum())
    return Histogram(place, tuple(round(float(share), 3) for share in shares), round(beyond, 3))


def vert_areas(mesh: Mesh) -> Float64[np.ndarray, " V"]:
    """(V,) a third of the area of the faces at each vert."""
    corners = mesh.verts[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 6
    return np.bincount(mesh.faces.reshape(-1), weights=np.repeat(areas, 3), minlength=mesh.num_verts)
