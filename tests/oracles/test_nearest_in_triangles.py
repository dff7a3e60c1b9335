"""Nearest points of triangles, against libigl's distances."""

import igl
import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton.correspondences import nearest_in_triangles
from tests.loops import over

POINTS = 150
REGIONS = [(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1)]


def random(generator):
    return generator.normal(size=(3, 3))


def obtuse(generator):
    """An angle of some 170 degrees, at any corner."""
    a, along, aside = generator.normal(size=(3, 3))
    corners = [a, a - along + 0.1 * aside, a + along + 0.1 * aside]
    return np.roll(corners, generator.integers(3), axis=0)


def needle(generator):
    """One side a thousandth of the others."""
    a, along, aside = generator.normal(size=(3, 3))
    return np.roll([a, a + along, a + along + 1e-3 * aside], generator.integers(3), axis=0)


def cap(generator):
    """A corner all but on the side across from it."""
    a, along, aside = generator.normal(size=(3, 3))
    return np.roll([a, a + along, a + 0.4 * along + 1e-3 * aside], generator.integers(3), axis=0)


def in_a_row(generator):
    """No area, in coordinates that leave none to rounding either."""
    a, along = generator.integers(-4, 5, 3), generator.integers(1, 9, 3)
    return np.array([a, a + along, a + generator.integers(2, 5) * along])[generator.permutation(3)].astype(float)


def folded(generator):
    """Two corners in the same place."""
    a, b = generator.normal(size=(2, 3))
    return np.array([a, a, b])[generator.permutation(3)]


def shrunk(generator):
    """All three in one place."""
    return np.repeat(generator.normal(size=(1, 3)), 3, axis=0)


SOUND = [random, obtuse, needle, cap]
WITHOUT_AREA = [in_a_row, folded, shrunk]


def points_about(corners, generator):
    """Some of the triangle itself, some straight above it, and some all around, near and far."""
    weights = generator.dirichlet([0.5] * 3, POINTS // 3)
    on = weights @ corners
    above = on + generator.normal(size=(len(on), 1)) * np.cross(corners[1] - corners[0], corners[2] - corners[0])
    size = np.ptp(corners, axis=0).max() + 0.1
    around = corners.mean(axis=0) + generator.normal(size=(POINTS // 3, 3)) * size * 3 ** generator.uniform(-2, 2)
    return np.concatenate([on, above, around])


def tries(kind, count=40):
    generator = np.random.default_rng([ord(letter) for letter in kind.__name__])
    for _ in range(count):
        corners = kind(generator)
        yield corners, points_about(corners, generator)


def found(corners, points, dtype=torch.float64):
    triangles = torch.tensor(corners, dtype=dtype).expand(len(points), 3, 3)
    return nearest_in_triangles(torch.tensor(points, dtype=dtype), triangles).double().numpy()


def distance_to(corners, faces, points):
    return np.sqrt(igl.point_mesh_squared_distance(points, corners, np.array(faces))[0])


def assert_weights(weights, rounding):
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=rounding)


@pytest.mark.parametrize("kind", SOUND)
def test_the_point_is_as_near_as_libigl_says(kind):
    for corners, points in tries(kind):
        weights = found(corners, points)
        assert_weights(weights, 1e-12)
        distance = np.linalg.norm(weights @ corners - points, axis=1)
        np.testing.assert_allclose(distance, distance_to(corners, [[0, 1, 2]], points), atol=1e-8, rtol=1e-8)


@pytest.mark.parametrize("kind", WITHOUT_AREA)
def test_of_triangles_without_area_the_nearest_point_of_the_sides_is_found(kind):
    for corners, points in tries(kind):
        weights = found(corners, points)
        assert_weights(weights, 1e-12)
        distance = np.linalg.norm(weights @ corners - points, axis=1)
        apart = [(i, j) for i, j in ((0, 1), (1, 2), (2, 0)) if (corners[i] != corners[j]).any()]
        expected = distance_to(corners, apart, points) if apart else np.linalg.norm(points - corners[0], axis=1)
        np.testing.assert_allclose(distance, expected, atol=1e-8, rtol=1e-8)


@over("kind", SOUND + WITHOUT_AREA)
def test_single_precision_is_as_near_up_to_rounding(kind):
    """Rounding may lead further astray the flatter a triangle is, but not by more than it is wide."""
    for case in tries(kind):
        corners, points = (values.astype(np.float32).astype(float) for values in case)
        single, double = found(corners, points, torch.float32), found(corners, points)
        assert_weights(single, 1e-6)
        far, near = (np.linalg.norm(weights @ corners - points, axis=1) for weights in (single, double))
        assert (far - near).max() < 2e-3 * (np.abs(corners).max() + np.abs(points).max())


@pytest.mark.parametrize("kind", SOUND)
def test_all_regions_are_met(kind):
    """Inside, at each side and at each corner."""
    met = {tuple(row) for corners, points in tries(kind) for row in (found(corners, points) > 0).astype(int).tolist()}
    assert met >= set(REGIONS)


def test_points_of_the_triangle_itself_are_their_own_nearest():
    generator = np.random.default_rng(0)
    corners, weights = random(generator), generator.dirichlet([1.0] * 3, 200)
    weights[:3] = np.eye(3)
    np.testing.assert_allclose(found(corners, weights @ corners), weights, atol=1e-12)


def test_triangles_side_by_side_are_each_found_with_its_own_point():
    generator = np.random.default_rng(1)
    corners, points = generator.normal(size=(50, 3, 3)), generator.normal(size=(50, 3))
    together = nearest_in_triangles(torch.tensor(points), torch.tensor(corners)).numpy()
    alone = [found(corners[k], points[k : k + 1])[0] for k in range(50)]
    np.testing.assert_array_equal(together, alone)
