"""Sampling by area: points on their faces, uniform over and within them, from one generator only."""

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from meshfit.fitting.sampling import AreaTable, sample
from meshfit.loss.operators import FaceGeometry, Faces
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, patch


def geometry(mesh, dtype=torch.float64):
    faces = Faces.of([mesh], dtype, torch.device("cpu"))
    return FaceGeometry.of(faces, torch.tensor(mesh.verts, dtype=dtype))


def drawn(mesh, count, seed=0, dtype=torch.float64):
    return sample(geometry(mesh, dtype), count, [torch.Generator().manual_seed(seed)])


def storeys(areas, *, scale=1.0):
    """Right triangles one above the other, so that a point's height tells its face; of area 0 where two verts meet."""
    verts = [[(x * a, y, f) for x, y in ((0, 0), (1, 0), (0, 2))] for f, a in enumerate(areas)]
    return Mesh(scale * np.array(verts, dtype=float).reshape(-1, 3), np.arange(3 * len(areas)).reshape(-1, 3))


def test_points_lie_on_the_face_whose_normal_they_have():
    mesh = mixed_open()
    corners = mesh.verts[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    samples = drawn(mesh, 2000)
    face = np.argmax(samples.normals.numpy() @ normals.T, axis=1)
    np.testing.assert_allclose(samples.normals.numpy(), normals[face], atol=1e-12)
    offsets = samples.points.numpy() - corners[face, 0]
    sides = np.stack([corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0], normals[face]], axis=2)
    u, v, height = np.linalg.solve(sides, offsets[:, :, None])[:, :, 0].T
    assert np.abs(height).max() < 1e-12
    assert min(u.min(), v.min(), (1 - u - v).min()) > -1e-12


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("seed", [0, 1])
def test_faces_are_picked_in_proportion_to_their_area(seed, dtype):
    areas, count = np.geomspace(0.1, 10, 20), 40_000
    heights = drawn(storeys(areas), count, seed, dtype).points[:, 2].numpy().round().astype(int)
    expected = count * areas / areas.sum()
    statistic = ((np.bincount(heights, minlength=20) - expected) ** 2 / expected).sum()
    assert chi2.ppf(0.001, 19) < statistic < chi2.ppf(0.999, 19)


def test_points_are_uniform_within_a_triangle():
    """Moments of the uniform density on the triangle (0, 0), (1, 0), (0, 1), each within 5 standard errors."""
    count = 100_000
    x, y, _ = (drawn(storeys([1.0]), count).points * torch.tensor([1, 0.5, 1])).numpy().T
    for power, moment in {(1, 0): 1 / 3, (0, 1): 1 / 3, (2, 0): 1 / 6, (0, 2): 1 / 6, (1, 1): 1 / 12}.items():
        values = x ** power[0] * y ** power[1]
        assert abs(values.mean() - moment) < 5 * values.std() / np.sqrt(count), power
    counts = np.histogram2d(x, y, bins=4, range=[[0, 1], [0, 1]])[0]
    inside = counts[np.add.outer(np.arange(4), np.arange(4)) < 3]  # squares wholly within the triangle
    np.testing.assert_allclose(inside, count / 8, rtol=0.05)


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e7])
@over("dtype", [torch.float32, torch.float64])
def test_faces_without_area_are_never_picked(dtype, scale):
    areas = [0, 0, 1, 0, 2, 0, 0]
    heights = drawn(storeys(areas, scale=scale), 5000, dtype=dtype).points[:, 2] / scale
    assert set(heights.round().int().tolist()) == {2, 4}


def test_even_the_smallest_draw_does_not_pick_a_face_without_area(monkeypatch):
    monkeypatch.setattr(torch.Tensor, "uniform_", lambda numbers, **_: numbers.zero_())
    assert drawn(storeys([0, 0, 1, 0]), 5).points[:, 2].tolist() == [2.0] * 5


def test_the_same_points_are_drawn_whatever_the_scale():
    mesh = mixed_open()
    small = drawn(Mesh(1e-6 * mesh.verts, mesh.faces), 500)
    torch.testing.assert_close(small.points * 1e6, drawn(mesh, 500).points)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_generator_advances_by_three_numbers_a_point_whatever_the_mesh(dtype):
    reference = torch.Generator().manual_seed(4)
    torch.rand(3, 77, generator=reference)  # in single precision for both
    for make in (*SOLIDS.values(), mixed_open):
        generator = torch.Generator().manual_seed(4)
        sample(geometry(make(), dtype), 77, [generator])
        assert torch.equal(generator.get_state(), reference.get_state())


def test_a_seed_draws_the_same_points_again_and_a_used_generator_others():
    faces, generator = geometry(mixed_open()), torch.Generator().manual_seed(3)
    first, second = sample(faces, 100, [generator]), sample(faces, 100, [generator])
    again = drawn(mixed_open(), 100, seed=3)
    assert torch.equal(first.points, again.points)
    assert torch.equal(first.normals, again.normals)
    assert not (first.points == second.points).all(dim=1).any()


def test_draws_of_different_seeds_are_not_correlated():
    """Of 28 pairs of seeds, each correlation within 5 standard errors of 0.

    Points come in the order of their faces, so what is correlated is where on its face each lies, and how many lie on
    each face.
    """
    mesh = patch(41, 41)
    draws = [drawn(mesh, 4000, seed) for seed in range(8)]
    centres = mesh.verts[mesh.faces].mean(axis=1)
    within = np.stack([samples.points.numpy() - centres[samples.picked.numpy()] for samples in draws])
    on_face = np.stack([np.bincount(samples.picked.numpy(), minlength=mesh.num_faces) for samples in draws])
    for values in (within[:, :, 0], within[:, :, 1], on_face):
        correlations = np.corrcoef(values)
        assert np.abs(correlations - np.eye(8)).max() < 5 / np.sqrt(values.shape[1])


def test_a_draw_is_constant_in_the_backward_pass_and_points_move_with_their_corners():
    mesh = mixed_open()
    faces = Faces.of([mesh], torch.float64, torch.device("cpu"))
    verts = torch.tensor(mesh.verts, requires_grad=True)
    points = sample(FaceGeometry.of(faces, verts), 50, [torch.Generator().manual_seed(0)]).points
    (gradient,) = torch.autograd.grad(points[:, 0].sum(), verts)
    assert float(gradient[:, 0].sum()) == pytest.approx(50)
    assert not gradient[:, 1:].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_meshes_side_by_side_are_sampled_as_each_would_be_alone(dtype):
    meshes = [mixed_open(), SOLIDS["tetrahedron"](), storeys([0, 2, 1])]
    verts = torch.cat([torch.tensor(mesh.verts, dtype=dtype) for mesh in meshes])
    faces = FaceGeometry.of(Faces.of(meshes, dtype, torch.device("cpu")), verts)
    together = sample(faces, 70, [torch.Generator().manual_seed(seed) for seed in range(3)])
    alone = [drawn(mesh, 70, seed, dtype) for seed, mesh in enumerate(meshes)]
    assert torch.equal(together.points, torch.cat([samples.points for samples in alone]))
    assert torch.equal(together.normals, torch.cat([samples.normals for samples in alone]))


def test_points_come_in_the_order_of_their_faces():
    picked = drawn(mixed_open(), 500).picked
    assert torch.equal(picked, picked.sort().values)


def test_the_table_for_other_devices_picks_the_faces_that_the_one_for_the_cpu_picks():
    meshes = [mixed_open(), SOLIDS["tetrahedron"](), storeys([0, 2, 1, 0]), mixed_closed()]
    geometry = FaceGeometry.of(
        Faces.of(meshes, torch.float64, torch.device("cpu")), torch.cat([torch.tensor(mesh.verts) for mesh in meshes])
    )
    table, segments = AreaTable.of(geometry), geometry.faces.segments
    padded = AreaTable(segments.padded(geometry.double_area).cumsum(1), segments)
    uniform = torch.rand(4, 400, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert torch.equal(padded.pick(uniform), table.pick(uniform))
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64).repeat(4, 1)
    assert torch.equal(padded.pick(ends), table.pick(ends))


def test_points_combine_the_corners_of_their_faces_by_the_square_root_map():
    mesh = mixed_open()
    samples = drawn(mesh, 300)
    corners = mesh.verts[mesh.faces[samples.picked.numpy()]]
    numbers = torch.rand(3, 300, generator=torch.Generator().manual_seed(0)).double().numpy()
    root, third = np.sqrt(numbers[1]), numbers[2]
    weights = np.stack([1 - root, root * (1 - third), root * third], axis=1)
    np.testing.assert_allclose(samples.points.numpy(), (weights[:, :, None] * corners).sum(axis=1), rtol=0, atol=1e-14)


def test_precision_does_not_change_the_draw():
    """So that a fit in single and one in double precision, of one seed, are a pair."""
    single, double = (drawn(mixed_closed(), 3000, seed=4, dtype=dtype) for dtype in (torch.float32, torch.float64))
    apart = (single.points.double() - double.points).norm(dim=1)
    assert (apart < 1e-5).double().mean() > 0.999  # a number at the edge of a face may fall on its neighbour
    assert double.points.dtype == torch.float64
