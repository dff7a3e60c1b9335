"""Laws of every scheme on curves: affine invariance, and the same curve from either end and of any numbering."""

import numpy as np

from meshfit.mesh.curves import Curves
from meshfit.subdivision.refine import subdivide
from tests.curve_shapes import INTERPOLATORY, SHAPES, arity, by_variant, dense, many, ordered, refined, single
from tests.loops import over

by_shape = over("shape", SHAPES)
LEVELS = 3


@by_variant
@by_shape
def test_rows_sum_to_one(spec, shape):
    matrix = refined(SHAPES[shape](), spec, LEVELS).matrix
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=4e-15)


@by_variant
@by_shape
def test_affine_maps_commute_with_refinement(spec, shape):
    curves, generator = SHAPES[shape](), np.random.default_rng(0)
    linear, shift = generator.standard_normal((3, 3)), np.array([10.0, 20.0, 30.0])
    moved = Curves(curves.verts @ linear + shift, curves.corners, curves.sizes, curves.closed)
    expected = subdivide(curves, spec, LEVELS).verts @ linear + shift
    np.testing.assert_allclose(subdivide(moved, spec, LEVELS).verts, expected, rtol=0, atol=3e-13)


@by_variant
@by_shape
def test_counts(spec, shape):
    curves = SHAPES[shape]()
    fine = subdivide(curves, spec, LEVELS)
    growth = arity(spec) ** LEVELS
    assert fine.num_segments == growth * curves.num_segments
    assert fine.num_verts == curves.num_verts + (growth - 1) * curves.num_segments
    assert np.array_equal(fine.closed, curves.closed)
    assert len(np.unique(fine.corners)) == len(fine.corners)


@by_variant
@by_shape
def test_old_verts_stand_in_their_chains_as_before(spec, shape):
    curves = SHAPES[shape]()
    fine = subdivide(curves, spec, 2)
    for before, after in zip(
        np.split(curves.corners, np.cumsum(curves.sizes)[:-1]),
        np.split(fine.corners, np.cumsum(fine.sizes)[:-1]),
        strict=True,
    ):
        assert np.array_equal(after[:: arity(spec) ** 2], before)


@by_variant
def test_numbering_does_not_matter(spec):
    curves = many()
    order = np.random.default_rng(1).permutation(curves.num_verts)
    verts = np.empty_like(curves.verts)
    verts[order] = curves.verts
    other = Curves(verts, order[curves.corners], curves.sizes, curves.closed)
    for found, expected in zip(
        ordered(subdivide(other, spec, LEVELS)), ordered(subdivide(curves, spec, LEVELS)), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@by_variant
@over("closed", [False, True])
@over("size", [2, 3, 7])
def test_a_curve_run_through_backwards_is_refined_to_the_same_points(spec, closed, size):
    curves = single(size, closed=closed)
    back = Curves(curves.verts, curves.corners[::-1], curves.sizes, curves.closed)
    (found,), (expected,) = (ordered(subdivide(one, spec, LEVELS)) for one in (back, curves))
    turned = np.roll(found[::-1], 1 - arity(spec) ** LEVELS, axis=0) if closed else found[::-1]
    np.testing.assert_allclose(turned, expected, rtol=0, atol=1e-14)


@by_variant
@over("size", [2, 3, 8])
def test_it_does_not_matter_where_a_closed_curve_starts(spec, size):
    curves = single(size, closed=True)
    rolled = Curves(curves.verts, np.roll(curves.corners, -1), curves.sizes, curves.closed)
    (found,), (expected,) = (ordered(subdivide(one, spec, LEVELS)) for one in (rolled, curves))
    np.testing.assert_allclose(np.roll(found, arity(spec) ** LEVELS, axis=0), expected, rtol=0, atol=1e-14)


@by_variant
def test_chains_do_not_see_each_other(spec):
    curves = many()
    fine = ordered(subdivide(curves, spec, LEVELS))
    for points, closed, expected in zip(ordered(curves), curves.closed, fine, strict=True):
        (found,) = ordered(subdivide(Curves.through(points, closed=bool(closed)), spec, LEVELS))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@by_variant
def test_ends_and_verts_off_the_chains_stay(spec):
    curves = many()
    matrix = dense(curves, spec, LEVELS)
    still = np.ones(curves.num_verts, dtype=bool)
    still[curves.corners] = False
    starts = np.cumsum(curves.sizes) - curves.sizes
    for at in (starts, starts + curves.sizes - 1):
        still[curves.corners[at[~curves.closed]]] = True
    assert still.sum() == 11
    assert np.array_equal(matrix[: curves.num_verts][still], np.eye(curves.num_verts)[still])


@by_variant
@by_shape
def test_interpolatory_schemes_keep_old_verts_and_the_others_do_not(spec, shape):
    curves = SHAPES[shape]()
    kept = dense(curves, spec, 2)[: curves.num_verts]
    moves_some = curves.sizes.max() > 2 or curves.closed.any()
    assert np.array_equal(kept, np.eye(curves.num_verts)) == (spec in INTERPOLATORY or not moves_some)


@by_variant
@over("size", [2, 3, 6])
def test_evenly_spaced_verts_of_a_line_stay_so_up_to_its_ends(spec, size):
    line = Curves.through(np.arange(size)[:, None] * np.array([1.0, -2.0, 0.5]) + 3)
    (points,) = ordered(subdivide(line, spec, LEVELS))
    expected = np.linspace(line.verts[0], line.verts[-1], len(points))
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-14)


@by_variant
@over("closed", [False, True])
def test_levels_one_by_one_are_levels_at_once(spec, closed):
    curves = single(5, closed=closed)
    by_steps = curves
    for _ in range(LEVELS):
        by_steps = subdivide(by_steps, spec)
    at_once = subdivide(curves, spec, LEVELS)
    assert np.array_equal(by_steps.verts, at_once.verts)
    assert np.array_equal(by_steps.corners, at_once.corners)
