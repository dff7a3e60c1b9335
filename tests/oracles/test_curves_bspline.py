"""B-spline subdivision against scipy's B-splines, and every scheme against a twin in plain Python and fractions."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline, lagrange

from meshfit.mesh.curves import Curves
from meshfit.subdivision.refine import subdivide
from tests.curve_shapes import arity, ordered, single
from tests.loops import over

LEVELS = 3


def bspline(points: np.ndarray, *, closed: bool) -> tuple[BSpline, int]:
    """The uniform cubic B-spline of control points: parameter i lies at vertex i. The number of its segments."""
    if closed:
        control, segments = np.concatenate([points[-1:], points, points[:2]]), len(points)
    else:
        ends = 2 * points[[0, -1]] - points[[1, -2]]
        control, segments = np.concatenate([ends[:1], points, ends[1:]]), len(points) - 1
    return BSpline(np.arange(-3, len(control) + 1), control, 3), segments


@pytest.mark.parametrize("spec", ["cubic-bspline", "ternary-bspline", "interp-bspline:alpha=0"])
@over("closed", [False, True])
@over("size", [3, 4, 9])
def test_refined_control_points_are_those_of_the_same_spline(spec, closed, size):
    """Fine verts, put to their limit by (1, 4, 1) / 6, lie on the spline of the coarse ones at their parameters."""
    curves = single(size, closed=closed)
    (points,) = ordered(subdivide(curves, spec, LEVELS))
    before, after = (np.roll(points, shift, axis=0) for shift in (1, -1))
    limit = (before + 4 * points + after) / 6
    if not closed:
        limit[[0, -1]] = points[[0, -1]]
    spline, segments = bspline(curves.verts, closed=closed)
    parameter = np.linspace(0, segments, len(points), endpoint=not closed)
    np.testing.assert_allclose(limit, spline(parameter), rtol=0, atol=1e-13)


@over("closed", [False, True])
def test_verts_converge_to_the_spline_by_a_quarter_each_level(closed):
    curves = single(6, closed=closed)
    spline, segments = bspline(curves.verts, closed=closed)
    gaps = []
    for level in range(3, 8):
        (points,) = ordered(subdivide(curves, "cubic-bspline", level))
        gaps.append(np.abs(points - spline(np.linspace(0, segments, len(points), endpoint=not closed))).max())
    np.testing.assert_allclose(np.divide(gaps[1:], gaps[:-1]), 1 / 4, atol=0.02)
    assert gaps[-1] < 1e-4


@pytest.mark.parametrize("spec", ["four-point", "ternary-four-point"])
def test_new_verts_lie_on_the_cubic_through_four_old_ones(spec):
    curves = single(7, closed=True)
    (points,) = ordered(subdivide(curves, spec))
    step = arity(spec)
    for i in range(7):
        near = curves.verts[[(i + k) % 7 for k in (-1, 0, 1, 2)]]
        for part in range(1, step):
            cubic = [lagrange([-1, 0, 1, 2], axis)(part / step) for axis in near.T]
            np.testing.assert_allclose(points[step * i + part], cubic, rtol=0, atol=1e-13)


def test_four_point_comes_close_to_a_circle_and_the_cubic_spline_through_the_same_points():
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    fine = subdivide(Curves.through(circle, closed=True), "four-point", 6)
    assert np.abs(np.linalg.norm(fine.verts, axis=1) - 1).max() < 1e-3
    (points,) = ordered(fine)
    spline = CubicSpline(np.arange(17), np.concatenate([circle, circle[:1]]), bc_type="periodic")
    np.testing.assert_allclose(points, spline(np.arange(len(points)) / 64), atol=1e-3)


W, A = Fraction(3, 64), Fraction(1, 4)
TWINS = {
    "cubic-bspline": ([1, 6, 1], [[0, 4, 4, 0]], 8),
    "four-point:tension=0.046875": ([0, 1, 0], [[-W, Fraction(1, 2) + W, Fraction(1, 2) + W, -W]], 1),
    "interp-bspline:alpha=0.25": (
        [(1 - A) / 8, 1 - (1 - A) / 4, (1 - A) / 8],
        [[-A / 16, (8 + A) / 16, (8 + A) / 16, -A / 16]],
        1,
    ),
    "ternary-bspline": ([4, 19, 4], [[1, 16, 10, 0], [0, 10, 16, 1]], 27),
    "ternary-four-point": ([0, 81, 0], [[-5, 60, 30, -4], [-4, 30, 60, -5]], 81),
}


def twin(points: list[Fraction], spec: str, *, closed: bool) -> list[Fraction]:
    """One level on the numbers along one curve, exactly."""
    old, new, over = TWINS[spec]
    last = len(points) - 1

    def at(i):
        if closed:
            return points[i % len(points)]
        if i < 0:
            return 2 * points[0] - points[1]
        return points[i] if i <= last else 2 * points[last] - points[last - 1]

    fine = []
    for i in range(len(points)):
        fine.append(sum(weight * at(i - 1 + k) for k, weight in enumerate(old)) / over)
        if closed or i < last:
            fine += [sum(weight * at(i - 1 + k) for k, weight in enumerate(weights)) / over for weights in new]
    return fine


@pytest.mark.parametrize("spec", TWINS)
@over("closed", [False, True])
@over("size", [2, 3, 4, 11])
def test_a_twin_in_fractions_agrees(spec, closed, size):
    """Mirroring alone keeps the ends: no rule fixes them."""
    values = np.random.default_rng(size).integers(-50, 50, size)
    expected = [Fraction(int(value)) for value in values]
    for _ in range(LEVELS):
        expected = twin(expected, spec, closed=closed)
    curves = Curves.through(np.stack([values, 0 * values, 1 + 0 * values], axis=1), closed=closed)
    (points,) = ordered(subdivide(curves, spec, LEVELS))
    np.testing.assert_allclose(points[:, 0], [float(value) for value in expected], rtol=0, atol=1e-12)
