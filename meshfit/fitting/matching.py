"""Nearest neighbours between two point sets: a k-d tree on the CPU, brute force by blocks on other devices."""

import torch
from torch import Tensor

from meshfit.loss.chamfer import Matches
from meshfit.mesh.nearest import nearest_in

_BLOCK = 1 << 25


@torch.no_grad()
def match(p: Tensor, q: Tensor) -> Matches:
    """Match each point of (P, 3) with its nearest of (Q, 3), and the other way round."""
    if p.device.type == "cpu":
        return Matches(_by_tree(p, q), _by_tree(q, p))
    return Matches(by_blocks(p, q), by_blocks(q, p))


def _by_tree(queries: Tensor, points: Tensor) -> Tensor:
    found = torch.from_numpy(nearest_in(points.detach().numpy())(queries.detach().numpy()))
    # Where squared distances overflow, the tree finds nothing and says so by an index that is out of range.
    return found.clamp_(max=len(points) - 1)


def by_blocks(queries: Tensor, points: Tensor) -> Tensor:
    """Nearest by comparing all pairs, a block of queries at a time so that memory stays bounded.

    Distances come from differences, not from inner products, whose cancellation picks wrong neighbours in float32.
    """
    rows = max(1, _BLOCK // len(points))
    return torch.cat(
        [
            torch.cdist(block, points, compute_mode="donot_use_mm_for_euclid_dist").argmin(1)
            for block in torch.split(queries, rows)
        ]
    )
