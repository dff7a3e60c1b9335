"""Surface sampling: on the faces, uniform by area, stratified, reproducible."""

import numpy as np
from scipy.stats import chisquare, kstest

from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface
from tests.loops import over
from tests.shapes import ALL, mixed_closed, torus

LEAST_P = 0.001


def weights_of(mesh, points, faces):
    """Barycentric coordinates by least squares, and how far each point is from its plane."""
    corners = mesh.verts[mesh.faces[faces]]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    offset = points - corners[:, 0]
    second = np.einsum("nij,nj->ni", np.linalg.pinv(sides), offset)
    off = np.linalg.norm(offset - np.einsum("nij,nj->ni", sides, second), axis=1)
    return np.column_stack([1 - second.sum(axis=1), second]), off


@over("shape", ALL)
def test_points_lie_on_the_faces_named(shape):
    mesh = ALL[shape]()
    found = sample_surface(mesh, 500, np.random.default_rng(1))
    assert found.points.shape == (500, 3)
    assert found.faces.shape == (500,)
    weights, off = weights_of(mesh, found.points, found.faces)
    assert off.max() < 1e-12
    assert weights.min() > -1e-12


@over("count", [1, 7, 1000])
def test_each_face_gets_its_share_of_points_but_for_the_ends_of_its_stretch(count):
    """Stratified: a face of area a holds between floor and ceiling of a's share, and at most one beyond at each end."""
    mesh = mixed_closed()
    found = sample_surface(mesh, count, np.random.default_rng(2))
    share = count * face_areas(mesh) / face_areas(mesh).sum()
    counts = np.bincount(found.faces, minlength=mesh.num_faces)
    assert counts.sum() == count
    assert (np.abs(counts - share) < 2).all()
    assert (counts[share >= 2] > 0).all()
    assert (np.diff(found.faces) >= 0).all()


def test_faces_are_hit_in_proportion_to_their_area():
    """One point a draw, so that no stratification helps."""
    mesh, generator = mixed_closed(), np.random.default_rng(3)
    draws = 4_000
    hits = np.bincount([sample_surface(mesh, 1, generator).faces[0] for _ in range(draws)], minlength=mesh.num_faces)
    expected = draws * face_areas(mesh) / face_areas(mesh).sum()
    assert chisquare(hits, expected).pvalue > LEAST_P


def test_points_are_uniform_within_a_triangle():
    """Each barycentric coordinate w of a uniform point has the distribution 1 - (1 - w)²."""
    mesh = Mesh(np.array([[0.0, 0, 0], [5, 1, 0], [2, 7, 3]]), np.array([[0, 1, 2]]))
    found = sample_surface(mesh, 20_000, np.random.default_rng(4))
    weights, _ = weights_of(mesh, found.points, found.faces)
    for weight in weights.T:
        assert kstest(weight, lambda w: 1 - (1 - w) ** 2).pvalue > LEAST_P


def test_small_parts_of_the_surface_get_their_share():
    """Bins by the fourths of each triangle that midpoints cut: all of one area."""
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    found = sample_surface(mesh, 8000, np.random.default_rng(5))
    weights, _ = weights_of(mesh, found.points, found.faces)
    corner = [(weights[:, k] > 0.5).sum() for k in range(3)]
    assert chisquare([*corner, 8000 - sum(corner)]).pvalue > LEAST_P


def test_faces_without_area_are_never_hit():
    verts = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = Mesh(verts, np.array([[0, 0, 1], [0, 1, 2], [1, 1, 1], [0, 1, 2], [2, 2, 0]]))
    assert set(sample_surface(mesh, 200, np.random.default_rng(6)).faces.tolist()) == {1, 3}


def test_the_same_seed_gives_the_same_points():
    first, second, other = (sample_surface(torus(), 300, np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.faces, second.faces)
    assert not np.array_equal(first.points, other.points)


def test_points_scale_with_the_mesh():
    mesh = torus()
    one = sample_surface(mesh, 300, np.random.default_rng(9))
    big = sample_surface(Mesh(mesh.verts * 2.0**40, mesh.faces), 300, np.random.default_rng(9))
    assert np.array_equal(big.points, one.points * 2.0**40)
