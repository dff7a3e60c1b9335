"""Curves, chains, and the joining of segments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains, Curves, join_segments, require_chains
from meshfit.mesh.topology import NONE
from tests.curve_shapes import SHAPES, many, single
from tests.loops import over

POINTS = np.eye(3)


def chains_of(joined: Chains) -> list[tuple[list[int], bool]]:
    parts = np.split(joined.corners, np.cumsum(joined.sizes)[:-1]) if len(joined.sizes) else []
    return [(part.tolist(), bool(closed)) for part, closed in zip(parts, joined.closed, strict=True)]


def test_curves_hold_copies_that_cannot_be_changed():
    verts, corners = np.eye(3), np.array([0, 1, 2], dtype=np.int32)
    curves = Curves(verts, corners, [3], [True])
    verts[0], corners[0] = 9, 9
    assert (curves.verts[0, 0], curves.corners[0]) == (1, 0)
    dtypes = [getattr(curves, name).dtype for name in ("verts", "corners", "sizes", "closed")]
    assert dtypes == [np.float64, np.int64, np.int64, np.bool_]
    for name in ("verts", "corners", "sizes", "closed"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(curves, name)[0] = 0


@over(
    ("arrays", "message"),
    [
        ((np.eye(4), [0, 1], [2], [False]), r"verts: expected rows of three numbers, got an array of shape \(4, 4\)"),
        ((np.arange(3), [0, 1], [2], [False]), r"verts: .* shape \(3,\)"),
        ((POINTS, [[0, 1]], [2], [False]), r"corners: expected a flat list, got an array of shape \(1, 2\)"),
        ((POINTS, [0, 1], np.array(2), [False]), r"sizes: .* shape \(\)"),
        ((POINTS, [0, 1], [2], [False, True]), "expected one size and one closed per chain, got 1 and 2"),
        ((POINTS, [0, 1], [3], [False]), "got 2 corners, and sizes that add up to 3$"),
        ((POINTS, [0, 1], [3, -1], [False, False]), "sizes that add up to 2, one of them -1"),
    ],
)
def test_arrays_that_do_not_fit(arrays, message):
    with pytest.raises(MeshError, match=message):
        Curves(*arrays)


@over(
    ("corners", "sizes", "closed", "message"),
    [
        ([0, 1, 2, 9], [2, 2], [False, True], "chain 1 has vertex 9: vertices are numbered 0 to 3"),
        ([0, -1], [2], [False], "chain 0 has vertex -1"),
        ([0], [1], [True], "of 2 or more vertices: chain 0 has 1"),
        ([0, 1], [2, 0], [False, False], "of 2 or more vertices: chain 1 has 0"),
        ([0, 1, 0], [3], [False], "vertex 0 is in the chains twice"),
        ([0, 1, 1, 2], [2, 2], [False, False], "vertex 1 is in the chains twice"),
    ],
)
def test_chains_that_are_none(corners, sizes, closed, message):
    curves = Curves(np.zeros((4, 3)), corners, sizes, closed)
    with pytest.raises(MeshError, match=f"a walk needs .*{message}"):
        require_chains(Chains.of(curves), "a walk")


def test_segments_and_neighbours():
    curves = Curves(np.zeros((7, 3)), [4, 1, 0, 5, 2], [3, 2], [False, True])
    chains = Chains.of(curves)
    assert curves.num_segments == 4
    assert list(zip(chains.tail.tolist(), chains.head.tolist(), strict=True)) == [(4, 1), (1, 0), (5, 2), (2, 5)]
    assert chains.neighbours.tolist() == [[1, NONE], [4, 0], [5, 5], [NONE, NONE], [NONE, 1], [2, 2], [NONE, NONE]]


@over("inserted", [1, 2])
@over("shape", SHAPES)
def test_split_puts_new_verts_between_the_ends_of_segments(shape, inserted):
    coarse = Chains.of(SHAPES[shape]())
    fine = coarse.split(inserted)
    require_chains(fine, "a test")
    segments = len(coarse.tail)
    ends = np.stack([coarse.tail, coarse.head], axis=1)
    new = coarse.num_verts + np.arange(segments * inserted).reshape(segments, inserted)
    walked = np.column_stack([ends[:, :1], new, ends[:, 1:]])
    expected = np.stack([walked[:, :-1], walked[:, 1:]], axis=2).reshape(-1, 2)
    assert np.array_equal(np.stack([fine.tail, fine.head], axis=1), expected)
    assert fine.num_verts == coarse.num_verts + inserted * segments


JOINED = {
    "in order": ([(0, 1), (1, 2), (2, 3)], [([0, 1, 2, 3], False)]),
    "in any order": ([(2, 3), (0, 1), (1, 2)], [([0, 1, 2, 3], False)]),
    "in any direction": ([(1, 2), (1, 0), (3, 2)], [([0, 1, 2, 3], False)]),
    "backwards": ([(2, 1), (0, 1), (3, 2)], [([3, 2, 1, 0], False)]),
    "one segment": ([(1, 0)], [([1, 0], False)]),
    "a triangle": ([(0, 1), (2, 0), (1, 2)], [([0, 1, 2], True)]),
    "a triangle of mixed directions": ([(1, 0), (1, 2), (2, 0)], [([1, 0, 2], True)]),
    "there and back": ([(0, 1), (1, 0)], [([0, 1], True)]),
    "twice": ([(0, 1), (0, 1)], [([0, 1], True)]),
    "two at once": ([(4, 5), (0, 1), (5, 6), (1, 2), (6, 4)], [([4, 5, 6], True), ([0, 1, 2], False)]),
    "none": ([], []),
}


@over("name", JOINED)
def test_segments_are_joined(name):
    segments, expected = JOINED[name]
    assert chains_of(join_segments(7, np.array(segments, dtype=np.int64).reshape(-1, 2), "a.obj")) == expected


@over(
    ("segments", "message"),
    [
        ([(0, 1), (1, 2), (1, 3)], r"the curves branch: vertex 1 has 3 segments, allowed: 1 or 2 \(1 such vertex\)"),
        (
            [(0, 1), (0, 1), (0, 1)],
            r"vertex 0 has 3 segments, .* \(2 such vertices\); split the curves there",
        ),
        ([(0, 1), (1, 4)], r"segment 1 is \[1, 4\], but vertices are numbered 0 to 3"),
        ([(-1, 1)], r"segment 0 is \[-1, 1\], but vertices"),
        ([(0, 1), (2, 2)], r"segment 1 is \[2, 2\], from a vertex to itself"),
    ],
)
def test_segments_that_make_no_curves(segments, message):
    with pytest.raises(MeshError, match=f"^a.obj: .*{message}"):
        join_segments(4, np.array(segments), "a.obj")


@over("shape", SHAPES)
def test_segments_listed_along_chains_come_back_as_these_chains(shape):
    chains = Chains.of(SHAPES[shape]())
    found = join_segments(chains.num_verts, np.stack([chains.tail, chains.head], axis=1), "a.obj")
    assert chains_of(found) == chains_of(chains)


def up_to_start_and_direction(chains: list[tuple[list[int], bool]]) -> set[tuple[tuple[int, ...], bool]]:
    found = set()
    for corners, closed in chains:
        ways = [corners, corners[::-1]]
        if closed:
            ways = [[*way[k:], *way[:k]] for way in ways for k in range(len(way))]
        found.add((tuple(min(ways)), closed))
    return found


@given(st.randoms(use_true_random=False))
def test_shuffled_and_turned_segments_make_the_same_curves(random):
    chains = Chains.of(many())
    segments = list(zip(chains.tail.tolist(), chains.head.tolist(), strict=True))
    random.shuffle(segments)
    turned = [pair[::-1] if random.random() < 0.5 else pair for pair in segments]
    found = chains_of(join_segments(chains.num_verts, np.array(turned), "a.obj"))
    assert up_to_start_and_direction(found) == up_to_start_and_direction(chains_of(chains))
    for corners, closed in found:
        first = next(pair for pair in turned if set(pair) <= set(corners))
        walked = [*corners, corners[0]] if closed else corners
        assert any((walked[k], walked[k + 1]) == first for k in range(len(walked) - 1))


def test_through():
    curves = Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    assert (curves.num_verts, curves.num_segments, curves.closed.tolist()) == (3, 2, [False])
    assert single(5, closed=True).num_segments == 5
