"""Nearest neighbours between two point sets: a k-d tree on the CPU; elsewhere all pairs, which never wait."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from meshfit.loss.chamfer import Matches
from meshfit.mesh.nearest import nearest_point_query

_BLOCK = 1 << 26


@contextmanager
def search_threads(threads: int) -> Iterator[Executor | None]:
    """Threads for `match`, if more than one is wanted; a problem keeps two of them busy."""
    if threads == 1:
        yield None
        return
    # Each thread tells OpenMP anew that it is to stay by itself.
    with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        yield pool


@torch.no_grad()
def match_nearest(p: Tensor, q: Tensor, batch_size: int = 1, pool: Executor | None = None) -> Matches:
    """Match each point of a member with the nearest of the same member's others, and the other way round.

    Args:
        p: (K P, 3), P points of each of K batch_size.
        q: (K Q, 3), Q of each.
        batch_size: K.
        pool: threads to search with, on the CPU; what is found does not depend on it.
    """
    ps, qs = p.detach().view(batch_size, -1, 3), q.detach().view(batch_size, -1, 3)
    if p.device.type == "cpu":
        found = list((pool.map if pool else map)(_kd_tree, [*ps, *qs], [*qs, *ps], [*range(batch_size)] * 2))
        return Matches(torch.cat(found[:batch_size]), torch.cat(found[batch_size:]), batch_size)
    forward, backward = brute_force(ps, qs)
    first = torch.arange(batch_size, device=p.device)[:, None]
    return Matches((forward + first * qs.shape[1]).view(-1), (backward + first * ps.shape[1]).view(-1), batch_size)


def nearest_neighbour_search(points: Tensor) -> Callable[[Tensor], Tensor]:
    """Prepare for many queries: the function returned maps (M, 3) points to the (M,) indices of the nearest of (N, 3).

    Args:
        points: (N, 3), none of them removed later. The tree stands on the CPU whatever their device: on a GPU all
            pairs of a large cloud take longer than the way there and back.
    """
    query, last = nearest_point_query(points.cpu().numpy()), len(points) - 1
    return lambda queries: torch.from_numpy(np.minimum(query(queries.cpu().numpy()), last)).to(queries.device)


def _kd_tree(queries: Tensor, points: Tensor, member: int) -> Tensor:
    found = nearest_point_query(points.numpy())(queries.numpy())
    # Where squared distances overflow, the tree finds nothing and says so by an index that is out of range.
    return torch.from_numpy(np.minimum(found, len(points) - 1) + member * len(points))


def brute_force(p: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest by comparing all pairs, both ways at once, a block of p at a time so that memory stays bounded.

    Distances come from differences, not from inner products, whose cancellation picks wrong neighbours in float32.

    Args:
        p: (K, P, 3).
        q: (K, Q, 3).

    Returns:
        (K, P) the nearest of q, and (K, Q) the nearest of p.
    """
    rows = max(1, _BLOCK // (len(q) * q.shape[1]))
    least = q.new_full(q.shape[:2], torch.inf)
    forward, backward = [], torch.zeros(q.shape[:2], dtype=torch.int64, device=q.device)
    for start in range(0, p.shape[1], rows):
        distances = _squared_distances(p[:, start : start + rows], q)
        forward.append(distances.argmin(2))
        nearest = distances.min(1)
        backward = torch.where(nearest.values < least, nearest.indices + start, backward)
        least = torch.minimum(least, nearest.values)
    return torch.cat(forward, 1), backward


def _squared_distances(p: Tensor, q: Tensor) -> Tensor:
    """(K, P, Q). On CUDA it takes a fiftieth of the time of `torch.cdist`, which starts a block of threads a pair."""
    ahead, across = p[:, :, None], q[:, None]
    total = (ahead[..., 0] - across[..., 0]).square_()
    for axis in (1, 2):
        offset = ahead[..., axis] - across[..., axis]
        total.addcmul_(offset, offset)
    return total
