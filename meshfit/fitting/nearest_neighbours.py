"""Nearest neighbours between two point sets: k-d trees on the CPU, brute force elsewhere."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import torch
from torch import Tensor

from meshfit.loss.chamfer import Matches
from meshfit.mesh.nearest import nearest_point_query

# Distances in memory at once.
_BLOCK = 1 << 26


@contextmanager
def search_threads(threads: int) -> Iterator[Executor | None]:
    """Provide threads for `match_nearest`, or None for one; each problem uses two."""
    if threads == 1:
        yield None
        return
    # OpenMP's number of threads is set per thread.
    with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        yield pool


@torch.no_grad()
def match_nearest(p: Tensor, q: Tensor, batch_size: int = 1, pool: Executor | None = None) -> Matches:
    """Find the nearest q of each p and the nearest p of each q, within each pair of point sets of a batch.

    Args:
        p: (K P, 3), P points of each of K problems.
        q: (K Q, 3), Q of each.
        batch_size: K.
        pool: threads for the search on the CPU; the result does not depend on it.
    """
    ps, qs = p.detach().view(batch_size, -1, 3), q.detach().view(batch_size, -1, 3)
    if p.device.type == "cpu":
        rows = list((pool.map if pool else map)(_kd_tree, [*ps, *qs], [*qs, *ps], [*range(batch_size)] * 2))
        return Matches(torch.cat(rows[:batch_size]), torch.cat(rows[batch_size:]), batch_size)
    forward, backward = brute_force(ps, qs)
    first = torch.arange(batch_size, device=p.device)[:, None]
    return Matches((forward + first * qs.shape[1]).view(-1), (backward + first * ps.shape[1]).view(-1), batch_size)


def nearest_neighbour_search(points: Tensor, *, scattered: bool = False) -> Callable[[Tensor], Tensor]:
    """Build a k-d tree over (N, 3) points; the function returned maps (M, 3) queries to the (M,) nearest indices.

    The tree is on the CPU for every device: on a GPU, brute force over a large cloud takes longer than the transfer.

    Args:
        points: (N, 3) the points.
        scattered: whether consecutive queries may be far apart; see `nearest_point_query`.
    """
    query = nearest_point_query(points.cpu().numpy(), scattered=scattered)
    return lambda queries: torch.from_numpy(query(queries.cpu().numpy())).to(queries.device)


def _kd_tree(queries: Tensor, points: Tensor, member: int) -> Tensor:
    """Return the nearest points of one problem as rows of all problems' points."""
    return torch.from_numpy(nearest_point_query(points.numpy())(queries.numpy()) + member * len(points))


def brute_force(p: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Compare all pairs, both ways at once, one block of p at a time, so that memory stays bounded.

    Distances come from differences, not from inner products, whose cancellation picks wrong neighbours in float32.
    Never waits for the device.

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
    """Return (K, P, Q) squared distances. On CUDA, `torch.cdist` takes 50 times as long: one thread block per pair."""
    rows, columns = p[:, :, None], q[:, None]
    total = (rows[..., 0] - columns[..., 0]).square_()
    for axis in (1, 2):
        offset = rows[..., axis] - columns[..., axis]
        total.addcmul_(offset, offset)
    return total
