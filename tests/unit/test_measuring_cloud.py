"""Measuring against points: exact where the points are on a known surface, and null where a cloud tells nothing."""

import math

import numpy as np
import pytest

from meshfit.errors import MeasureError
from meshfit.measuring import cloud
from meshfit.measuring.cloud import percentiles_of
from meshfit.measuring.deviation import deviation
from meshfit.measuring.limits import parse_limit
from meshfit.measuring.measure import measure
from meshfit.measuring.metrics import MEASURED
from meshfit.measuring.shortfalls import shortfalls
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.solids import cube
from meshfit.subdivision.sphere import icosphere

SIZES = {"samples": 2000, "points": 2000}


def directions(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def plane(n=21):
    """The square from -1 to 1 at z = 0, with normals up."""
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    verts = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = [np.stack([corner, corner + 1, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + n], 1)]
    return Mesh(verts, np.concatenate(faces))


def test_distances_of_points_over_a_plane_are_their_heights():
    rng = np.random.default_rng(0)
    inside = rng.uniform(-0.9, 0.9, size=(5000, 2))
    heights = rng.uniform(-0.05, 0.05, size=5000)
    measured = measure(plane(), PointCloud(np.column_stack([inside, heights])), **SIZES)
    assert measured.hausdorff.backward == np.abs(heights).max()
    # Weights by area differ at random, and not with the height.
    assert measured.distance.backward_mean == pytest.approx(np.abs(heights).mean(), rel=0.05)
    assert measured.distance.backward_p50 == pytest.approx(np.median(np.abs(heights)), rel=0.05)
    # The square reaches farther than the points.
    assert measured.hausdorff.forward == pytest.approx(math.hypot(0.1, 0.1), abs=0.06)


def test_points_on_a_sphere_around_are_at_its_distance_with_normals_alike():
    sphere = icosphere(4)
    rays = directions(4000)
    measured = measure(sphere, PointCloud(1.1 * rays, rays), **SIZES)
    assert measured.distance.backward_rms == pytest.approx(0.1, rel=0.01)
    assert measured.hausdorff.backward < 0.1025
    # To the nearest points, it is more, by the spacing of the points, which is known.
    spacing = math.sqrt(4 * math.pi * 1.1**2 / 4000)
    assert measured.cloud.spacing == pytest.approx(spacing, rel=0.1)
    assert 0.1 < measured.distance.forward_mean < math.hypot(0.1, spacing)
    assert measured.normal_consistency.signed > 0.995
    assert measured.normal_angle.p99 < 6
    inwards = measure(sphere, PointCloud(1.1 * rays, -rays), **SIZES)
    assert inwards.normal_consistency.signed == pytest.approx(-measured.normal_consistency.signed)
    assert inwards.normal_angle.mean == pytest.approx(180 - measured.normal_angle.mean)


def test_estimated_normals_have_no_side():
    rays = directions(4000)
    measured = measure(icosphere(3), PointCloud(rays), **SIZES)
    assert measured.cloud.normals == "estimated"
    assert measured.normal_consistency.signed is None
    assert measured.normal_consistency.absolute > 0.99
    assert measured.normal_angle.p99 < 15
    values = measured.to_dict()
    line = parse_limit("normal_consistency=0.9", above=False).failure(values, 2.0)
    assert line.endswith("estimated ones have no side")
    assert parse_limit("distance.backward_rms=0.5", above=True).failure(values, 2.0) is None


def test_creases_of_a_cloud_are_missing_with_the_reason_and_the_rest_is_there():
    measured = measure(cube(), PointCloud(sample_surface(cube(), 3000, np.random.default_rng(0)).points), **SIZES)
    missing = {name for name, value in measured.flat().items() if value is None}
    assert missing == {name for name in MEASURED if name.startswith("edges.")} | {"normal_consistency.signed"}
    assert "no creases" in measured.edges.reason
    assert "3,000 points" in repr(measured)
    assert "cloud" not in measure(cube(), cube(), **SIZES).to_dict()


def test_a_side_that_was_scanned_twice_counts_once():
    rng = np.random.default_rng(1)
    once, twice = rng.uniform(-1, 1, size=(4000, 3)), rng.uniform(-1, 1, size=(16000, 3))
    points = np.concatenate([once[once[:, 0] < 0], twice[twice[:, 0] >= 0]])
    points[:, 2] = np.where(points[:, 0] < 0, 0.1, 0.3)
    measured = measure(plane(), PointCloud(points), **SIZES)
    assert measured.distance.backward_mean == pytest.approx(0.2, rel=0.02)
    assert np.linalg.norm(points[:, 2], 1) / len(points) > 0.25


def test_weighted_percentiles_with_equal_weights_are_those_of_numpy_and_weights_are_repetitions():
    values = np.random.default_rng(2).normal(size=501)
    assert np.allclose(percentiles_of(values, np.full(501, 3.0)), np.percentile(values, (50, 90, 95, 99)))
    counts = np.random.default_rng(3).integers(1, 4, 501)
    assert np.allclose(
        percentiles_of(values, counts.astype(float)),
        np.percentile(np.repeat(values, counts), (50, 90, 95, 99)),
        atol=0.05,
    )


def test_duplicates_alone_and_scale_change_nothing_that_they_should_not():
    rays = directions(500)
    plain = measure(icosphere(2), PointCloud(rays), **SIZES)
    far = np.array([4e5, -5e6, 300.0])
    moved = icosphere(2).with_verts(1000 * icosphere(2).verts + far)
    there = measure(moved, PointCloud(1000 * rays + far), **SIZES, f_score_tau=10.0)
    assert there.distance.backward_rms == pytest.approx(1000 * plain.distance.backward_rms, rel=1e-6)
    repeated = measure(icosphere(2), PointCloud(np.repeat(rays, 12, axis=0)), **SIZES)
    assert repeated.distance.backward_mean == pytest.approx(plain.distance.backward_mean, rel=0.05)


def test_a_point_that_is_not_finite_is_refused():
    with pytest.raises(MeasureError, match=r"the target: expected finite coordinates .* at point 1"):
        measure(cube(), PointCloud([[0, 0, 0], [np.nan, 0, 0], [1, 0, 0], [0, 1, 0]]), **SIZES)


def test_deviation_is_to_the_nearest_points_and_unsigned():
    found = deviation(icosphere(1), PointCloud(2 * icosphere(1).verts))
    assert not found.signed
    assert np.allclose(found.verts, 1.0)


def test_what_a_cloud_shows_and_the_result_does_not_reach_is_a_shortfall_and_what_it_does_not_show_is_none():
    rays = directions(6000)
    sphere = icosphere(4)
    assert shortfalls(sphere, PointCloud(rays)) == []
    half = rays[rays[:, 2] > 0]
    assert shortfalls(sphere, PointCloud(half)) == []  # the other half is beyond the rim
    ear = 0.15 * rays[:2000] + [0, 0, 1.4]
    (text,) = shortfalls(sphere, PointCloud(np.concatenate([rays, ear])))
    assert text.startswith("not reached: ")
    blown = sphere.with_verts(sphere.verts * np.where(sphere.verts[:, 2:] > 0.6, 1.3, 1.0))
    assert any(text.startswith("off the target: ") for text in shortfalls(blown, PointCloud(rays)))


def test_of_many_points_some_are_measured_and_the_farthest_is_of_all(monkeypatch):
    monkeypatch.setattr(cloud, "_MOST_POINTS", 1000)
    rays = directions(5000)
    heights = np.random.default_rng(4).uniform(0.99, 1.01, 5000)
    measured = measure(icosphere(4), PointCloud(heights[:, None] * rays), **SIZES)
    assert measured.cloud.points == 5000
    assert measured.hausdorff.backward == point_distances(icosphere(4), heights[:, None] * rays).max()
    assert measured.distance.backward_mean == pytest.approx(0.005, rel=0.1)
