"""The length of the Laplacian of the vertex positions, uniform or by cotangents."""

import torch
from jaxtyping import Float
from torch import Tensor

from meshfit.loss.surface import LEAST_DOUBLE_AREA, FaceGeometry, Surface


def laplacian_uniform(verts: Float[Tensor, "V 3"], surface: Surface) -> Float[Tensor, ""]:
    """Mean over verts of the distance from the mean of the neighbours (Desbrun et al. 1999, umbrella operator).

    A vertex without neighbours counts as 0.
    """
    tail, head = surface.edges
    sums = torch.zeros_like(verts).index_add(0, tail, verts.index_select(0, head))
    sums = sums.index_add(0, head, verts.index_select(0, tail))
    return _length(sums / surface.valence - surface.joined * verts).mean()


def laplacian_cotangent(verts: Float[Tensor, "V 3"], surface: Surface) -> Float[Tensor, ""]:
    """Mean over verts of the distance from the cotangent-weighted mean of the neighbours (Desbrun et al. 1999).

    The weights are constants in the backward pass. Where they sum to nothing positive, they are not normalised, as in
    PyTorch3D. A vertex without neighbours counts as 0.
    """
    with torch.no_grad():
        cotangents = corner_cotangents(FaceGeometry.of(surface, verts)).reshape(-1)
        # The cotangent at a corner belongs to the edge opposite to it: corner k to the edge of corners k+1 and k+2.
        start, end = surface.faces.roll(-1, 1).reshape(-1), surface.faces.roll(-2, 1).reshape(-1)
        total = torch.zeros_like(verts[:, 0]).index_add(0, start, cotangents).index_add(0, end, cotangents)
        scale = torch.where(total > 0, 1 / total, total)[:, None]
    weight = cotangents[:, None]
    sums = torch.zeros_like(verts).index_add(0, start, weight * verts.index_select(0, end))
    sums = sums.index_add(0, end, weight * verts.index_select(0, start))
    return _length(scale * sums - surface.joined * verts).mean()


def corner_cotangents(faces: FaceGeometry) -> Float[Tensor, "F 3"]:
    """Cotangent of the angle at each corner of each face."""
    ahead = faces.corners.roll(-1, 1) - faces.corners
    behind = faces.corners.roll(1, 1) - faces.corners
    dot = (ahead * behind).sum(2)
    return dot / faces.double_area.clamp_min(LEAST_DOUBLE_AREA)[:, None]


def _length(vectors: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    length: Tensor = torch.linalg.vector_norm(vectors, dim=1)
    return length
