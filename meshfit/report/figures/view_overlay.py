"""Overlays of a result on the masks of images: where the two outlines agree, and where they do not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_erosion

from meshfit.images.camera import Camera
from meshfit.images.rasteriser import rasterise
from meshfit.images.target import ImageTarget
from meshfit.images.views import View, Views
from meshfit.measuring.mask_overlap import mask_ious
from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.colours import MASK, RESULT, rgb
from meshfit.report.figures.drawing import Image

MOST_VIEWS = 3
"""Most views of each kind, fitted and held out, that are shown of a target."""

# Each pixel is the mean of a block of fine pixels, and lines are this many fine pixels wide.
_FINE = 3
_LINE = 8
_GREY, _MASK_FILL, _DIFFERENCE_FILL = "#808d99", 70, 130
_MARGIN = 0.2


@dataclass(frozen=True)
class ShownView:
    """A view of a target that is shown.

    Attributes:
        view: the view.
        held_out: whether no fit saw it.
    """

    view: View
    held_out: bool

    @property
    def title(self) -> str:
        """Its name, and whether it was held out."""
        held_out = self.held_out and not self.view.name.startswith("held-out")
        return f"{self.view.name}, held out" if held_out else self.view.name


def shown_views(images: ImageTarget, worst: Sequence[str] = ()) -> list[ShownView]:
    """Return a few views of a target: spread evenly over their order, among them the worst.

    Args:
        images: the target.
        worst: names of fitted views to show rather than their neighbours, most important first.
    """
    fitted = [ShownView(view, held_out=False) for view in _spread(images.views, worst[:1])]
    others = [] if images.held_out is None else _spread(images.held_out, ())
    return [*fitted, *(ShownView(view, held_out=True) for view in others)]


def _spread(views: Views, wanted: Sequence[str]) -> list[View]:
    count = min(MOST_VIEWS, len(views))
    rows = [(2 * k + 1) * len(views) // (2 * count) for k in range(count)]
    for row in (views.names.index(name) for name in wanted if name in views.names):
        rows[int(np.argmin([abs(row - other) for other in rows]))] = row
    return [views[row] for row in sorted(set(rows))]


def draw_overlay(mesh: Mesh, view: View, size: int) -> tuple[Image, float]:
    """Draw the mask of a view with its outline, and the outline of a mesh as the camera sees it.

    The mask is grey, the part of it that the mesh leaves out has the colour of the mask's outline, and what the mesh
    covers beyond it the colour of the mesh's. The background is transparent. The picture is a square around the mask.

    Args:
        mesh: in the coordinates of the view's camera.
        view: the view.
        size: width and height of the picture in pixels.

    Returns:
        The picture, and the intersection over union of the two masks at the pixels of the view.
    """
    left, top, side = _square_around(view.mask)
    camera, fine = view.camera, size * _FINE
    scale = fine / side
    focal = camera.focal[0] * scale, camera.focal[1] * scale
    centre = (camera.centre[0] - left) * scale, (camera.centre[1] - top) * scale
    result = rasterise(mesh, Camera(camera.kind, fine, fine, focal, centre, camera.pose)).face >= 0
    places = (np.arange(fine) + 0.5) / scale
    rows, columns = (np.floor(start + places).astype(np.int64) for start in (top, left))
    within = np.outer((rows >= 0) & (rows < camera.height), (columns >= 0) & (columns < camera.width))
    mask = within & view.mask[np.clip(rows, 0, camera.height - 1)][:, np.clip(columns, 0, camera.width - 1)]
    result &= within
    layers = [
        (mask & result, rgb(_GREY), _MASK_FILL),
        (mask & ~result, rgb(MASK), _DIFFERENCE_FILL),
        (result & ~mask, rgb(RESULT), _DIFFERENCE_FILL),
        (_outline(mask), rgb(MASK), 255),
        (_outline(result), rgb(RESULT), 255),
    ]
    premultiplied = np.zeros((fine, fine, 4))
    for where, colour, alpha in layers:
        premultiplied[where] = [*(colour * (alpha / 255.0)), alpha]
    return _averaged(premultiplied), mask_ious(mesh, Views([view]))[0]


def _square_around(mask: Bool[np.ndarray, "H W"]) -> tuple[float, float, float]:
    """Return left and top of a square around a mask in pixels, and its side; of the image if the mask is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        rows, columns = np.arange(mask.shape[0]), np.arange(mask.shape[1])
    (top, bottom), (left, right) = ((found[0], found[-1] + 1) for found in (rows, columns))
    side = (1 + _MARGIN) * max(bottom - top, right - left)
    return float(left + right - side) / 2, float(top + bottom - side) / 2, float(side)


def _outline(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Return the inner border of a mask; the border of the image is none."""
    return np.asarray(mask & ~binary_erosion(mask, iterations=_LINE, border_value=1), dtype=bool)


def _averaged(premultiplied: Float64[np.ndarray, "H W 4"]) -> Image:
    height, width = (size // _FINE for size in premultiplied.shape[:2])
    mean = premultiplied.reshape(height, _FINE, width, _FINE, 4).mean(axis=(1, 3))
    alpha = mean[:, :, 3:]
    colour = np.divide(mean[:, :, :3] * 255.0, alpha, out=np.zeros_like(mean[:, :, :3]), where=alpha > 0)
    return np.asarray(np.rint(np.dstack([colour, alpha])).astype(np.uint8))
