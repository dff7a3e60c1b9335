"""Contours of masks with sub-pixel accuracy, and signed distances from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from meshfit.images.camera import Camera
from meshfit.images.views import Mask, View

# Standard deviation in pixels of the filter that makes a smooth curve of the steps between pixels.
_SMOOTHING = 0.8
_LEAST = 0.05
# Pixels within so many of the contour get their distance from it; farther ones that from the pixels of the other side.
_BAND = 3.0


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The outline of an object in an image, in pixels; where the object is cut off by the image, it has none.

    Attributes:
        camera: that took the image.
        points: (N, 2) points of the contour, about one per pixel of its length.
        normals: (N, 2) unit normals of the contour there, outwards.
        lengths: (N,) length of the contour that each point stands for.
        distance: (H, W) signed distance of pixel centres from the contour, positive inside.
        cut_off: whether the object reaches the border of the image.
    """

    camera: Camera
    points: Float64[np.ndarray, "N 2"]
    normals: Float64[np.ndarray, "N 2"]
    lengths: Float64[np.ndarray, " N"]
    distance: Float64[np.ndarray, "H W"]
    cut_off: bool

    @classmethod
    def of(cls, view: View) -> "Silhouette":
        """Return the silhouette of a view's mask; without points if the mask is empty or full."""
        points, normals = mask_contour(view.mask)
        lengths = 1.0 / np.abs(normals).sum(axis=1)
        return cls(
            view.camera, points, normals, lengths, _signed_distance(view.mask, points), _reaches_border(view.mask)
        )

    def distance_at(self, pixels: Float64[np.ndarray, "N 2"]) -> Float64[np.ndarray, " N"]:
        """Return the signed distance of places in pixels from the contour, positive inside.

        Beyond the image it falls with the distance from it; if the image cuts the object off, it is infinite there.
        """
        height, width = self.distance.shape
        inside = np.clip(pixels, 0.5, [width - 0.5, height - 0.5])
        values = map_coordinates(self.distance, [inside[:, 1] - 0.5, inside[:, 0] - 0.5], order=1, mode="nearest")
        beyond = np.abs(pixels - inside).sum(axis=1)
        if self.cut_off:
            return np.where(beyond > 0.5, np.inf, values)
        return np.asarray(values - beyond)


def mask_contour(mask: Mask) -> tuple[Float64[np.ndarray, "N 2"], Float64[np.ndarray, "N 2"]]:
    """Return points of a mask's contour, about one per pixel of its length, and its unit normals there, outwards."""
    smooth = gaussian_filter(mask.astype(np.float64), _SMOOTHING, mode="nearest") - 0.5
    # Parts and gaps as thin as a pixel keep it.
    smooth = np.where(mask, np.maximum(smooth, _LEAST), np.minimum(smooth, -_LEAST))
    padded = np.gradient(np.pad(smooth, 1, mode="edge"))
    slope = np.stack([padded[1][1:-1, 1:-1], padded[0][1:-1, 1:-1]], axis=-1)
    return _crossings(smooth, slope)


def _crossings(
    smooth: Float64[np.ndarray, "H W"], slope: Float64[np.ndarray, "H W 2"]
) -> tuple[Float64[np.ndarray, "N 2"], Float64[np.ndarray, "N 2"]]:
    """Return where the lines between neighbouring pixel centres cross level 0, and the outward normals there."""
    points, normals = [], []
    for axis in (0, 1):
        first = np.take(smooth, range(smooth.shape[axis] - 1), axis=axis)
        second = np.take(smooth, range(1, smooth.shape[axis]), axis=axis)
        row, column = np.nonzero((first > 0) != (second > 0))
        share = first[row, column] / (first[row, column] - second[row, column])
        step = np.array([1, 0]) if axis == 0 else np.array([0, 1])
        start = np.column_stack([column, row]) + 0.5
        points.append(start + share[:, None] * step[::-1])
        towards = slope[row, column] * (1 - share[:, None]) + slope[row + step[0], column + step[1]] * share[:, None]
        normals.append(-towards)
    normal = np.concatenate(normals)
    return np.concatenate(points), normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def _signed_distance(mask: Bool[np.ndarray, "H W"], points: Float64[np.ndarray, "N 2"]) -> Float64[np.ndarray, "H W"]:
    outside = distance_transform_edt(~mask) if mask.any() else np.full(mask.shape, np.inf)
    inside = distance_transform_edt(mask) if not mask.all() else np.full(mask.shape, np.inf)
    distance = np.where(mask, inside - 0.5, 0.5 - outside)
    if not len(points):
        return distance
    near = np.abs(distance) < _BAND
    row, column = np.nonzero(near)
    found = cKDTree(points).query(np.column_stack([column, row]) + 0.5)[0]
    distance[near] = np.where(mask[near], found, -found)
    return distance


def _reaches_border(mask: Bool[np.ndarray, "H W"]) -> bool:
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
