"""Points on a surface, uniform by area, that gradients flow through."""

import torch
from torch import Tensor

from meshfit.loss.surface import FaceGeometry
from meshfit.loss.terms import Samples


def sample(faces: FaceGeometry, count: int, generator: torch.Generator) -> Samples:
    """Draw points uniformly by area; each is a fixed convex combination of the corners of its face.

    Within a triangle the square-root map is used (Osada et al. 2002, Shape Distributions, eq. 1).

    Args:
        faces: the surface, as it lies now.
        count: N, how many points.
        generator: of the device of `faces`; it is advanced by exactly 3 N numbers.
    """
    picked, weights = _draw(faces.double_area, count, generator)
    corners = faces.corners.index_select(0, picked)
    return Samples((weights[:, :, None] * corners).sum(1), faces.normals.index_select(0, picked))


@torch.no_grad()
def _draw(double_area: Tensor, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    uniform = torch.rand(3, count, generator=generator, dtype=double_area.dtype, device=double_area.device)
    cumulative = double_area.cumsum(0)
    picked = torch.searchsorted(cumulative, uniform[0] * cumulative[-1], right=True)
    root = uniform[1].sqrt()
    weights = torch.stack([1 - root, root * (1 - uniform[2]), root * uniform[2]], dim=1)
    return picked.clamp_(max=len(double_area) - 1), weights
