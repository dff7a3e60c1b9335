"""Terms of images: how far a mesh is from the masks, the depth and the normals of views."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from meshfit.images.views import Mask, View
from meshfit.loss.differentiable_view import SeenMesh, ViewCamera
from meshfit.mesh.mesh import Mesh

MaskDifference = Literal["iou", "squared"]

_HALF = 0.5


@dataclass(frozen=True, eq=False)
class ViewTarget:
    """A view as tensors, to compare a mesh with.

    Attributes:
        camera: that took it.
        coverage: (H, W) coverage of the pixels, softened as that of the mesh is.
        depth_pixels: (N,) pixels with a depth, counted row by row.
        depth: (N,) their depth.
        normal_pixels: (M,) pixels with a normal.
        normals: (M, 3) their unit normals in world axes.
    """

    camera: ViewCamera
    coverage: Float[Tensor, "H W"]
    depth_pixels: Int64[np.ndarray, " N"]
    depth: Float[Tensor, " N"]
    normal_pixels: Int64[np.ndarray, " M"]
    normals: Float[Tensor, "M 3"]

    @classmethod
    def of(cls, view: View, blur: float, dtype: torch.dtype, device: torch.device) -> "ViewTarget":
        """Return a view as tensors.

        Args:
            view: the view.
            blur: of the outline, in pixels.
            dtype: of the tensors.
            device: of the tensors.
        """

        def known(values: np.ndarray | None, width: int) -> tuple[Int64[np.ndarray, " N"], Tensor]:
            if values is None:
                return np.zeros(0, dtype=np.int64), torch.zeros((0, width), dtype=dtype, device=device)
            flat = values.reshape(view.mask.size, -1)
            pixels = np.flatnonzero(view.mask.ravel() & np.isfinite(flat).all(axis=1))
            return pixels, torch.tensor(flat[pixels], dtype=dtype, device=device)

        depth_pixels, depth = known(view.depth, 1)
        normal_pixels, normals = known(view.normals, 3)
        coverage = torch.tensor(_softened(view.mask, blur), dtype=dtype, device=device)
        camera = ViewCamera.of(view.camera, dtype, device)
        return cls(camera, coverage, depth_pixels, depth[:, 0], normal_pixels, normals)


def view_terms(
    verts: Float[Tensor, "V 3"],
    mesh: Mesh,
    targets: Sequence[ViewTarget],
    names: Sequence[str],
    blur: float,
    difference: MaskDifference = "iou",
) -> dict[str, Float[Tensor, ""]]:
    """Return the terms of a mesh, each the mean over views.

    - `silhouette`: 1 − Σ min(a, b) / Σ max(a, b) over the pixels of the coverage a of the mesh and b of the mask, which
      is 1 − intersection over union; or the mean of (a − b)².
    - `depth`: mean absolute difference where both have one, without faces that are seen edge on.
    - `normals`: mean of 1 − cos where both have one.

    Args:
        verts: (V, 3) positions of the vertices.
        mesh: its faces.
        targets: the views.
        names: the terms to evaluate.
        blur: of the outline, in pixels.
        difference: of silhouettes.
    """
    totals = {name: verts.new_zeros(()) for name in names}
    for target in targets:
        seen = SeenMesh.of(verts, mesh, target.camera)
        if "silhouette" in totals:
            coverage = seen.silhouette(blur)
            totals["silhouette"] = totals["silhouette"] + _mask_difference(coverage, target.coverage, difference)
        if "depth" in totals:
            totals["depth"] = totals["depth"] + _depth_difference(seen, target)
        if "normals" in totals:
            totals["normals"] = totals["normals"] + _normal_difference(seen, target)
    return {name: total / len(targets) for name, total in totals.items()}


def _mask_difference(
    coverage: Float[Tensor, "H W"], wanted: Float[Tensor, "H W"], difference: MaskDifference
) -> Float[Tensor, ""]:
    if difference == "squared":
        return (coverage - wanted).square().mean()
    return 1 - torch.minimum(coverage, wanted).sum() / torch.maximum(coverage, wanted).sum()


def _depth_difference(seen: SeenMesh, target: ViewTarget) -> Float[Tensor, ""]:
    both = seen.covered.ravel()[target.depth_pixels]
    pixels, depth = target.depth_pixels[both], target.depth[_rows(both, target.depth)]
    if not len(pixels):
        return seen.verts.sum() * 0
    frontal = seen.is_frontal(pixels)
    apart = (seen.depth(pixels) - depth).abs()
    return torch.where(frontal, apart, torch.zeros_like(apart)).sum() / frontal.sum().clamp_min(1)


def _normal_difference(seen: SeenMesh, target: ViewTarget) -> Float[Tensor, ""]:
    both = seen.covered.ravel()[target.normal_pixels]
    pixels, normals = target.normal_pixels[both], target.normals[_rows(both, target.normals)]
    if not len(pixels):
        return seen.verts.sum() * 0
    return 1 - (seen.normals(pixels) * normals).sum(1).mean()


def _rows(kept: np.ndarray, like: Tensor) -> Tensor:
    return torch.from_numpy(np.flatnonzero(kept)).to(like.device)


def _softened(mask: Mask, blur: float) -> Float[np.ndarray, "H W"]:
    """Return sigmoid(d/σ) of the distance d of each pixel's centre from the outline of the mask, half a pixel off."""
    if mask.all() or not mask.any():
        return mask.astype(np.float64)
    inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
    distance = np.where(mask, inside - _HALF, _HALF - outside)
    return np.asarray(0.5 * (1 + np.tanh(distance / (2 * blur))))
