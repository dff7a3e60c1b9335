"""Nearest neighbours: the k-d tree and the blocks find what comparing all pairs in float64 finds."""

import numpy as np
import pytest
import torch

from meshfit.fitting import matching
from meshfit.fitting.matching import by_blocks, match
from meshfit.loss.chamfer import Matches

GENERATOR = np.random.default_rng(0)
CLOUDS = {
    "random": (GENERATOR.normal(size=(300, 3)), GENERATOR.normal(size=(200, 3))),
    "clustered": tuple(
        GENERATOR.normal(size=(5, 1, 3)).repeat(60, axis=1).reshape(-1, 3) + 1e-3 * GENERATOR.normal(size=(300, 3))
        for _ in range(2)
    ),
    "with duplicates": tuple(
        GENERATOR.normal(size=(20, 3))[GENERATOR.integers(20, size=count)] for count in (150, 250)
    ),
    "on a lattice, with ties": tuple(GENERATOR.integers(3, size=(count, 3)).astype(float) for count in (120, 90)),
    "all in one place": (np.zeros((70, 3)), np.ones((50, 3))),
    "one point each": (np.zeros((1, 3)), np.ones((1, 3))),
    "on a line": (np.outer(GENERATOR.normal(size=100), [1, 0, 0]), np.outer(GENERATOR.normal(size=80), [1, 0, 0])),
}
CASES = pytest.mark.parametrize("cloud", CLOUDS.values(), ids=CLOUDS)
DTYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def tensors(cloud, dtype):
    return (torch.tensor(points, dtype=dtype) for points in cloud)


def assert_nearest(queries, points, found):
    assert found.dtype == torch.int64
    assert found.shape == (len(queries),)
    pairs = (queries.double()[:, None] - points.double()[None]).square().sum(2).sqrt()
    tolerance = 1e-6 if queries.dtype == torch.float32 else 1e-13
    torch.testing.assert_close(pairs.gather(1, found[:, None])[:, 0], pairs.min(1).values, rtol=tolerance, atol=0)


@CASES
@DTYPES
def test_the_tree_finds_the_nearest_in_both_directions(cloud, dtype):
    p, q = tensors(cloud, dtype)
    found = match(p, q)
    assert_nearest(p, q, found.forward)
    assert_nearest(q, p, found.backward)


@CASES
@DTYPES
@pytest.mark.parametrize("block", [1, 700, 1 << 25])
def test_blocks_of_any_size_find_the_nearest(cloud, dtype, block, monkeypatch):
    monkeypatch.setattr(matching, "_BLOCK", block)
    p, q = tensors(cloud, dtype)
    assert_nearest(p, q, by_blocks(p, q))
    assert_nearest(q, p, by_blocks(q, p))


def test_blocks_bound_the_pairs_that_are_compared_at_once(monkeypatch):
    seen = []
    distances = torch.cdist

    def spy(block, points, **options):
        seen.append(len(block) * len(points))
        return distances(block, points, **options)

    monkeypatch.setattr(matching, "_BLOCK", 1000)
    monkeypatch.setattr(torch, "cdist", spy)
    p, q = tensors(CLOUDS["random"], torch.float32)
    by_blocks(p, q)
    assert len(seen) == 60
    assert max(seen) <= 1000


def test_matching_leaves_no_graph_behind():
    p, q = (points.requires_grad_() for points in tensors(CLOUDS["random"], torch.float64))
    found = match(p, q)
    assert isinstance(found, Matches)
    assert not found.forward.requires_grad
    assert not found.backward.requires_grad


def test_points_that_are_not_contiguous_are_matched_alike():
    p, q = tensors(CLOUDS["random"], torch.float64)
    transposed = p.T.contiguous().T
    assert not transposed.is_contiguous()
    assert torch.equal(match(transposed, q).forward, match(p, q).forward)


@DTYPES
def test_indices_stay_in_range_where_squared_distances_overflow(dtype):
    p, q = tensors(CLOUDS["random"], dtype)
    found = match(p * torch.finfo(dtype).max / 100, q)
    assert 0 <= int(found.forward.min()) <= int(found.forward.max()) < len(q)
    assert 0 <= int(found.backward.min()) <= int(found.backward.max()) < len(p)
