"""Overlap of the masks of a result with those of images."""

from dataclasses import dataclass

import numpy as np

from meshfit.images.rasteriser import rasterise
from meshfit.images.views import Views
from meshfit.mesh.mesh import Mesh
from meshfit.units import count_text

_LEAST = 0.9
"""A view whose masks overlap less is reported."""


@dataclass(frozen=True)
class MaskOverlap:
    """Intersection over union of the masks of a result and of images, at pixel centres.

    Attributes:
        mean: over the views that the result was fitted to.
        least: of these views.
        held_out_mean: over views that it was not fitted to; None without such views.
        held_out_least: of these views.
        views: number of the views that it was fitted to.
        held_out: number of the others.
        worst_view: name of the view of the least overlap, of those that it was fitted to.
    """

    mean: float
    least: float
    held_out_mean: float | None
    held_out_least: float | None
    views: int
    held_out: int
    worst_view: str

    @property
    def shortfalls(self) -> list[str]:
        """Where masks differ much, in words."""
        if self.least >= _LEAST:
            return []
        of_views = count_text(self.views, "view")
        return [f"masks differ: IoU {self.least:.3f} in '{self.worst_view}', mean {self.mean:.3f} of {of_views}"]


def mask_overlap(mesh: Mesh, views: Views, held_out: Views | None = None) -> MaskOverlap:
    """Return how the masks of a mesh overlap those of images.

    Args:
        mesh: the result.
        views: that it was fitted to, in the same coordinates.
        held_out: views that it was not fitted to.
    """
    fitted = mask_ious(mesh, views)
    others = [] if held_out is None else mask_ious(mesh, held_out)
    return MaskOverlap(
        mean=float(np.mean(fitted)),
        least=min(fitted),
        held_out_mean=float(np.mean(others)) if others else None,
        held_out_least=min(others) if others else None,
        views=len(fitted),
        held_out=len(others),
        worst_view=views[int(np.argmin(fitted))].name,
    )


def mask_ious(mesh: Mesh, views: Views) -> list[float]:
    """Return the intersection over union of the masks in each view; 1 where both are empty."""
    ious = []
    for view in views:
        mask = rasterise(mesh, view.camera).face >= 0
        union = int((mask | view.mask).sum())
        ious.append(float((mask & view.mask).sum() / union) if union else 1.0)
    return ious
