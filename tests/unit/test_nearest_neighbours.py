"""Nearest neighbours: k-d tree and brute force against all pairs in float64."""

import numpy as np
import pytest
import torch

from meshfit.fitting import nearest_neighbours as matching
from meshfit.fitting.nearest_neighbours import brute_force, match_nearest, search_threads
from meshfit.loss.chamfer import Matches
from meshfit.mesh.nearest import nearest_point_query, spatial_order
from tests.loops import over

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
DTYPES = over("dtype", [torch.float32, torch.float64])


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
    found = match_nearest(p, q)
    assert_nearest(p, q, found.forward)
    assert_nearest(q, p, found.backward)


@CASES
def test_sorting_scattered_queries_changes_no_answer(cloud):
    p, q = cloud
    found = [nearest_point_query(p, scattered=scattered)(q) for scattered in (False, True)]
    assert found[0].tolist() == found[1].tolist()
    assert sorted(spatial_order(q)) == list(range(len(q)))


def test_the_spatial_order_keeps_neighbours_together():
    points = GENERATOR.random((4000, 3))
    steps = [np.linalg.norm(np.diff(row, axis=0), axis=1).mean() for row in (points, points[spatial_order(points)])]
    assert steps[1] < steps[0] / 5
    strange = np.array([[np.nan, 0, 0], [np.inf, 1, 2], [1, 2, 3], [1e300, -1e300, 0]])
    for some in (points[:0], points[:1], strange, np.zeros((3, 3))):
        assert sorted(spatial_order(some)) == list(range(len(some)))


@CASES
@DTYPES
@pytest.mark.parametrize("block", [1, 700, 1 << 25])
def test_blocks_of_any_size_find_the_nearest_in_both_directions(cloud, dtype, block, monkeypatch):
    monkeypatch.setattr(matching, "_BLOCK", block)
    p, q = tensors(cloud, dtype)
    for a, b in ((p, q), (q, p)):
        forward, backward = brute_force(a[None], b[None])
        assert_nearest(a, b, forward[0])
        assert_nearest(b, a, backward[0])


def nearest_by_loops(p, q):
    """Squared lengths of small whole numbers are exact, and `min` takes the first of equal ones."""
    return [
        min(range(len(q)), key=lambda j: sum((a - b) ** 2 for a, b in zip(point, q[j], strict=True))) for point in p
    ]


@pytest.mark.parametrize("block", [1, 60, 700, 1000, 1 << 25])
def test_blocks_take_the_first_of_equally_near_points_of_each_member(block, monkeypatch):
    """At most 1, 2, 23, 33 or all of 41 rows are compared at once, so that the last block may be shorter."""
    monkeypatch.setattr(matching, "_BLOCK", block)
    generator = np.random.default_rng(1)
    p, q = (generator.integers(3, size=(3, count, 3)) for count in (41, 10))
    forward, backward = brute_force(torch.tensor(p, dtype=torch.float32), torch.tensor(q, dtype=torch.float32))
    for k in range(3):
        assert forward[k].tolist() == nearest_by_loops(p[k].tolist(), q[k].tolist())
        assert backward[k].tolist() == nearest_by_loops(q[k].tolist(), p[k].tolist())


@DTYPES
@pytest.mark.parametrize("threads", [1, 3])
def test_points_are_matched_with_those_of_the_same_member(dtype, threads):
    generator = torch.Generator().manual_seed(0)
    p, q = (torch.randn(4, count, 3, generator=generator, dtype=dtype) for count in (50, 70))
    with search_threads(threads) as pool:
        found = match_nearest(p.view(-1, 3), q.view(-1, 3), 4, pool)
    assert found.batch_size == 4
    alone = [match_nearest(ours, theirs) for ours, theirs in zip(p, q, strict=True)]
    assert found.forward.tolist() == [70 * k + j for k, part in enumerate(alone) for j in part.forward.tolist()]
    assert found.backward.tolist() == [50 * k + i for k, part in enumerate(alone) for i in part.backward.tolist()]


def test_blocks_bound_the_pairs_that_are_compared_at_once(monkeypatch):
    seen = []
    distances = matching._squared_distances

    def spy(block, points):
        seen.append(block.shape[0] * block.shape[1] * points.shape[1])
        return distances(block, points)

    monkeypatch.setattr(matching, "_BLOCK", 1000)
    monkeypatch.setattr(matching, "_squared_distances", spy)
    p, q = tensors(CLOUDS["random"], torch.float32)
    brute_force(p[None], q[None])
    assert len(seen) == 60
    brute_force(p.view(2, 150, 3), q.view(2, 100, 3))
    assert len(seen) == 60 + 30
    assert max(seen) <= 1000


def test_matching_leaves_no_graph_behind():
    p, q = (points.requires_grad_() for points in tensors(CLOUDS["random"], torch.float64))
    found = match_nearest(p, q)
    assert isinstance(found, Matches)
    assert not found.forward.requires_grad
    assert not found.backward.requires_grad


def test_points_that_are_not_contiguous_are_matched_alike():
    p, q = tensors(CLOUDS["random"], torch.float64)
    transposed = p.T.contiguous().T
    assert not transposed.is_contiguous()
    assert torch.equal(match_nearest(transposed, q).forward, match_nearest(p, q).forward)


@DTYPES
def test_indices_stay_in_range_where_squared_distances_overflow(dtype):
    p, q = tensors(CLOUDS["random"], dtype)
    found = match_nearest(p * torch.finfo(dtype).max / 100, q)
    assert 0 <= int(found.forward.min()) <= int(found.forward.max()) < len(q)
    assert 0 <= int(found.backward.min()) <= int(found.backward.max()) < len(p)
