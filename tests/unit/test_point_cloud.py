"""Point clouds: estimated normals, rims, densities and noise, against surfaces that are known."""

import numpy as np
import pytest

from meshfit.errors import ConfigError, MeshError
from meshfit.fitting.fit import fit
from meshfit.measuring.distance import surface_distances
from meshfit.mesh.control_mesh import control_mesh_of
from meshfit.mesh.denoised_cloud import denoised_cloud
from meshfit.mesh.geometry import face_areas, face_normals, unit_vectors
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.noise import noise_of_mesh, noise_of_points
from meshfit.mesh.point_cloud import PointCloud, evenly_spread, oriented_cloud, rim_of, sampled_areas
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from meshfit.mesh.wrapped_normals import cloud_with_normals
from meshfit.subdivision.sphere import icosphere


def ball(count: int, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    directions = unit_vectors(generator.normal(size=(count, 3)))
    return directions * (1 + noise * generator.normal(size=(count, 1)))


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_normals_of_two_balls_point_outwards(noise: float) -> None:
    centres = np.repeat([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], 2000, axis=0)
    points = np.concatenate([ball(2000, noise), ball(2000, noise, 1)]) + centres
    normals = oriented_cloud(PointCloud(points)).normals
    assert normals is not None
    cosines = np.einsum("nk,nk->n", normals, unit_vectors(points - centres))
    assert (cosines > 0).all()
    assert np.degrees(np.arccos(cosines.mean())) < 10


def test_normals_face_the_sensor() -> None:
    points = ball(500)
    points = points[points[:, 2] > 0.2]
    sensor = np.array([0.0, 0.0, 10.0])
    for place, sign in ((sensor, 1), (np.zeros(3), -1)):
        normals = oriented_cloud(PointCloud(points), place).normals
        assert normals is not None
        assert (sign * np.einsum("nk,nk->n", normals, points) > 0.9).all()


def test_given_normals_are_kept_and_normalised() -> None:
    cloud = PointCloud(ball(10), 3 * ball(10, seed=1))
    assert np.allclose(cloud.normals, ball(10, seed=1))
    assert oriented_cloud(cloud) is cloud
    assert np.array_equal(cloud.subset(np.array([2, 3, 5, 7])).verts, cloud.verts[[2, 3, 5, 7]])


def test_the_rim_of_a_disc_is_its_circle() -> None:
    generator = np.random.default_rng(0)
    radius, angle = np.sqrt(generator.random(4000)), 2 * np.pi * generator.random(4000)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(4000)], axis=1)
    rim = rim_of(oriented_cloud(PointCloud(points)))
    assert rim[radius < 0.9].mean() < 0.002
    assert rim[radius > 0.995].mean() > 0.5
    assert rim_of(oriented_cloud(PointCloud(ball(4000)))).mean() < 0.002


def test_areas_add_up_to_the_surface_however_dense_it_is() -> None:
    points = ball(20_000)
    kept = (points[:, 2] > 0) | (np.arange(len(points)) % 10 == 0)
    areas = sampled_areas(points[kept])
    assert areas.sum() == pytest.approx(4 * np.pi, rel=0.1)
    above = points[kept][:, 2] > 0
    assert areas[above].sum() == pytest.approx(2 * np.pi, rel=0.1)


@pytest.mark.parametrize("noise", [0.001, 0.01, 0.03])
def test_the_noise_of_points_is_found(noise: float) -> None:
    assert noise_of_points(ball(5000, noise)) == pytest.approx(noise, rel=0.15)


def test_the_noise_of_a_mesh_is_found_and_shape_is_none() -> None:
    sphere = icosphere(4)
    scale = 1 + 0.01 * np.random.default_rng(0).normal(size=(sphere.num_verts, 1))
    assert noise_of_mesh(sphere.with_verts(sphere.verts * scale)) == pytest.approx(0.01, rel=0.15)
    for clean in (sphere, load_target("bone"), load_target("cow")):
        assert noise_of_mesh(clean) == 0.0


@pytest.mark.slow
def test_a_fit_to_noisy_points_lies_nearer_to_the_surface_than_they_do() -> None:
    cloud = PointCloud(ball(3000, 0.03))
    settings = {"method": "gauss-newton", "verts": 2000, "coarse_steps": 6, "tries": 1, "device": "cpu"}
    result = fit("sphere", cloud, **settings)
    followed = fit("sphere", cloud, noise=0, **settings)
    errors = [surface_distances(each.mesh, icosphere(4), 2000, 0)[1].rms for each in (result, followed)]
    assert errors[0] < 0.75 * errors[1]
    assert result.target is cloud


@pytest.mark.filterwarnings("ignore:(source and target differ in topology|the target is open)")
def test_a_half_ball_pulls_the_rest_of_a_sphere_nowhere() -> None:
    sphere = icosphere(4)
    middle = sphere.verts[sphere.faces].mean(axis=1)
    half = Mesh(sphere.verts, sphere.faces[middle[:, 2] > 0])
    settings = {"method": "gauss-newton", "connectivity": "fixed", "levels": 0, "coarse_steps": 0, "device": "cpu"}
    result = fit(icosphere(3), half, normalise="none", register="off", **settings)
    distances = surface_distances(half, result.mesh, 5000, 0)[1]
    assert distances.forward_rms < 0.01
    below = result.mesh.verts[icosphere(3).verts[:, 2] < -0.2]
    assert (below[:, 2] < -0.1).all()


def test_an_even_subset_keeps_sparse_parts() -> None:
    points = ball(20_000)
    points = points[(points[:, 2] > 0) | (np.arange(20_000) % 20 == 0)]
    rows = evenly_spread(points, 2000)
    assert 1000 < len(rows) <= 2000
    assert len(np.unique(rows)) == len(rows)
    assert 0.15 < (points[rows, 2] < 0).mean() < 0.55  # 5 % of all points
    assert evenly_spread(points[:50], 50).tolist() == list(range(50))
    assert len(evenly_spread(np.zeros((30, 3)), 8)) == 1


def test_clouds_of_many_points_are_wrapped_around_some_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meshfit.mesh.control_mesh._MOST_WRAPPED", 1500)
    made = control_mesh_of(PointCloud(ball(6000)), verts=200).mesh
    assert np.abs(np.linalg.norm(made.verts, axis=1) - 1).max() < 0.1


def test_clouds_are_refused_where_faces_are_needed() -> None:
    with pytest.raises(ConfigError, match="method: gauss-newton"):
        fit("sphere", PointCloud(ball(100)), steps=1)
    for points in ([[0, 0, 0]], [[0, 0]] * 5):
        with pytest.raises(MeshError, match="points: expected"):
            PointCloud(points)


@pytest.mark.slow
def test_a_cloud_is_wrapped_where_the_source_is_chosen_for_it() -> None:
    points = np.concatenate([ball(3000), ball(3000, seed=1) * 0.5 + [1.2, 0.0, 0.0]])
    outside = (np.linalg.norm(points, axis=1) > 0.99) & (np.linalg.norm(points - [1.2, 0, 0], axis=1) > 0.49)
    result = fit("auto", PointCloud(points[outside]), method="gauss-newton", verts=1000, device="cpu")
    distances = np.linalg.norm(result.mesh.verts, axis=1) - 1, np.linalg.norm(result.mesh.verts - [1.2, 0, 0], axis=1)
    error = np.minimum(np.abs(distances[0]), np.abs(distances[1] - 0.5))
    assert np.percentile(error, 95) < 0.02


def test_normals_of_thin_noisy_parts_point_outwards_and_those_of_open_scans_stay() -> None:
    """A ball with a fin that is hardly thicker than the noise."""
    body, directions, axes = ball(4000), ball(1500, seed=1), np.array([1.0, 0.6, 0.08])
    fin = axes * directions + np.array([1.2, 0.0, 0.0])
    outside = np.linalg.norm(fin, axis=1) > 1.05
    points, outwards = (
        np.concatenate([body, fin[outside]]),
        np.concatenate([body, unit_vectors(directions / axes)[outside]]),
    )
    points = points + 0.02 * np.random.default_rng(2).normal(size=(len(points), 1)) * outwards
    normals = cloud_with_normals(PointCloud(points)).normals
    assert normals is not None
    assert (np.einsum("nk,nk->n", normals, outwards)[len(body) :] > 0).mean() > 0.9
    scan = PointCloud(points[points[:, 2] > 0.1])
    for cloud in (scan, PointCloud(points, outwards)):
        assert np.array_equal(cloud_with_normals(cloud).normals, oriented_cloud(cloud).normals)


def test_points_of_much_noise_are_moved_to_their_surface_and_those_of_little_stay() -> None:
    noisy, clean = ball(2000, 0.07), ball(2000, 0.01)
    errors = [np.std(np.linalg.norm(points, axis=1)) for points in (denoised_cloud(PointCloud(noisy)).verts, noisy)]
    assert errors[0] < 0.35 * errors[1]
    assert np.array_equal(denoised_cloud(PointCloud(clean)).verts, clean)
    assert np.array_equal(denoised_cloud(PointCloud(noisy), 0.0).verts, noisy)


@pytest.mark.slow
def test_a_noisy_sheet_of_points_becomes_an_open_surface_on_the_side_of_its_normals() -> None:
    generator = np.random.default_rng(0)
    x, y = generator.uniform(-1, 1, (2, 2000))
    sheet = np.stack([x, y, 0.2 * np.sin(3 * x) + generator.normal(0, 0.01, len(x))], axis=1)
    down = np.stack([0.6 * np.cos(3 * x), 0 * x, -np.ones_like(x)], axis=1)
    for cloud, side in ((PointCloud(sheet), 1), (PointCloud(sheet, down), -1)):
        made = control_mesh_of(cloud, verts=300)
        assert (made.made_from, made.reason) == ("points", "an open cloud: it shows 50% of a closed surface around it")
        assert TopologyCounts.of(Topology.of(made.mesh)).openings == 1
        verts = made.mesh.verts
        assert np.abs(verts[:, 2] - 0.2 * np.sin(3 * verts[:, 0])).mean() < 0.01
        assert np.allclose([verts[:, :2].min(0), verts[:, :2].max(0)], [[-1, -1], [1, 1]], atol=0.08)
        aside = side * face_normals(made.mesh)[:, 2] <= 0  # slivers at the rim
        assert face_areas(made.mesh)[aside].sum() < 0.005 * face_areas(made.mesh).sum()
    assert control_mesh_of(PointCloud(ball(800)), verts=100).made_from == "wrap"
    with pytest.raises(MeshError, match="the target has faces"):
        control_mesh_of(icosphere(1), "open")
