"""Known answers and laws of the surface distances."""

import math

import numpy as np
import pytest

from meshfit.measuring.distance import surface_distances
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS, cube, icosahedron
from meshfit.mesh.topology import Topology
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


ROUNDING = 1e-12
NOTHING = 1e-14  # what identical surfaces are apart, in diagonals: the rounding of a point on a face
SAMPLES = 2000


def square(side=1.0, height=0.0, cuts=1):
    ticks = np.linspace(0, side, cuts + 1)
    verts = np.array([(x, y, height) for x in ticks for y in ticks])
    corner = np.array([i * (cuts + 1) + j for i in range(cuts) for j in range(cuts)])
    a, b, c, d = corner, corner + cuts + 1, corner + cuts + 2, corner + 1
    return Mesh(verts, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))


def sphere(radius=1.0, times=3):
    mesh = icosahedron()
    for _ in range(times):
        topology = Topology.of(mesh)
        middle = mesh.verts[topology.edges].mean(axis=1)
        edge = mesh.num_verts + topology.edge_of.reshape(-1, 3)
        (a, b, c), (ab, bc, ca) = mesh.faces.T, edge.T
        rows = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        verts = np.concatenate([mesh.verts, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        mesh = Mesh(verts, np.concatenate([np.stack(row, axis=1) for row in rows]))
    return Mesh(mesh.verts * radius, mesh.faces)


def moved(mesh, rotation=None, scale=1.0, shift=(0.0, 0.0, 0.0)):
    rotation = np.eye(3) if rotation is None else rotation
    return Mesh(scale * mesh.verts @ rotation.T + shift, mesh.faces)


def rough_sphere(seed):
    base = sphere(times=2)
    return Mesh(base.verts + np.random.default_rng(seed).normal(size=base.verts.shape) * 0.05, base.faces)


def some_rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.linalg.det(q)


def all_distances(result, target, samples=SAMPLES, seed=0):
    hausdorff, distance, _, _ = surface_distances(result, target, samples, seed)
    lengths = [hausdorff.forward, hausdorff.backward, hausdorff.symmetric]
    return np.array([*lengths, *vars(distance).values()])


@over("mesh", [*(make() for make in SOLIDS.values()), square(), sphere(), rough_sphere(1)])
def test_a_mesh_is_at_no_distance_from_itself(mesh):
    assert all_distances(mesh, mesh).max() <= NOTHING * bounding_box_diagonal(mesh.verts)


@over("height", [1e-3, 0.25, 3.0])
def test_a_lifted_square_is_everywhere_as_far_as_it_was_lifted(height):
    assert all_distances(square(height=height), square()) == pytest.approx(height, rel=ROUNDING)


def test_concentric_spheres_keep_the_distances_of_their_polyhedra():
    """A sphere of verts at r with its faces no nearer the centre than s r: all distances lie within the two shells."""
    inner, outer = 1.0, 1.3
    unit = sphere()
    inset = np.linalg.norm(unit.verts[unit.faces].mean(axis=1), axis=1).min()
    found = all_distances(sphere(inner), sphere(outer))
    assert found.max() <= (outer - inset * inner) * (1 + ROUNDING)
    assert found.min() >= (inset * outer - inner) * (1 - ROUNDING)


def test_scaled_concentric_polyhedra_are_a_known_distance_apart():
    """Cubes of half-sides a < b: √3 (b - a) from the vertex of the larger; the other way b - a from everywhere."""
    found, distance, _, _ = surface_distances(moved(cube(), scale=1.5), cube(), SAMPLES, 0)
    side = 1 / math.sqrt(3)
    assert found.forward == pytest.approx(math.sqrt(3) * 0.5 * side, rel=ROUNDING)
    assert found.backward == pytest.approx(0.5 * side, rel=ROUNDING)
    assert distance.backward_mean == pytest.approx(0.5 * side, rel=ROUNDING)
    assert found.percent_of_diagonal == pytest.approx(100 * found.symmetric / 2)


def test_a_translated_copy_is_no_farther_than_it_was_moved():
    shift = np.array([0.02, -0.01, 0.03])
    found = all_distances(moved(sphere(), shift=shift), sphere())
    length = np.linalg.norm(shift)
    assert found.max() <= length * (1 + ROUNDING)
    assert found[:2] == pytest.approx(length, rel=0.01)  # where the sphere faces along the shift


def test_a_spike_is_seen_from_its_own_side_only():
    """A tip over the middle of a fine square: its height away from the square, which is no farther than its base."""
    height, cuts = 0.35, 40
    flat = square(cuts=cuts)
    tip = int(np.argmin(np.linalg.norm(flat.verts - [0.5, 0.5, 0], axis=1)))
    verts = flat.verts.copy()
    verts[tip, 2] = height
    spiky = Mesh(verts, flat.faces)
    for result, target in ((spiky, flat), (flat, spiky)):
        found, distance, _, _ = surface_distances(result, target, 200, 0)
        high, low = (found.forward, found.backward) if result is spiky else (found.backward, found.forward)
        assert high == pytest.approx(height, rel=ROUNDING)
        assert low <= 1 / cuts
        assert found.symmetric == high
        assert distance.mean < 0.02


@over("diagonals", [5, 50])
def test_a_total_failure_is_not_reported_as_a_fit(diagonals):
    mesh = sphere(times=2)
    shift = diagonals * bounding_box_diagonal(mesh.verts)
    found = all_distances(moved(mesh, shift=(shift, 0, 0)), mesh, samples=500)
    assert found[:3] == pytest.approx(shift, rel=0.02)
    assert found.min() > shift - 2


def test_verts_that_no_face_uses_are_not_part_of_the_surface():
    mesh = sphere(times=2)
    littered = Mesh(np.concatenate([mesh.verts, [[0, 0, 0]]]), mesh.faces)
    assert all_distances(littered, mesh).max() <= NOTHING * 4


@over("seed", range(3))
def test_swapping_the_meshes_swaps_the_directions(seed):
    """Exactly so for the largest, up to how far apart the points are; means agree within their standard errors."""
    first, second = rough_sphere(seed), rough_sphere(seed + 10)
    one, one_mean, _, _ = surface_distances(first, second, SAMPLES, 0)
    other, other_mean, _, _ = surface_distances(second, first, SAMPLES, 0)
    assert one.symmetric == pytest.approx(other.symmetric, rel=0.05)
    assert one.forward == pytest.approx(other.backward, rel=0.05)
    assert one_mean.mean == pytest.approx(other_mean.mean, rel=0.1)
    assert one_mean.rms == pytest.approx(other_mean.rms, rel=0.1)


@over("seed", range(3))
def test_figures_are_those_of_the_shape_not_of_its_place(seed):
    """Under a rigid motion and a scaling the same points are drawn, so only rounding differs."""
    first, second = rough_sphere(seed), rough_sphere(seed + 10)
    motion = {"rotation": some_rotation(seed), "shift": (3.0, -2.0, 1.0)}
    before = all_distances(first, second)
    assert all_distances(moved(first, **motion), moved(second, **motion)) == pytest.approx(before, rel=1e-6)
    scaled = all_distances(moved(first, scale=100.0), moved(second, scale=100.0))
    assert scaled == pytest.approx(100 * before, rel=1e-6)


def test_the_same_call_gives_the_same_bits_whatever_came_between():
    first, second = rough_sphere(0), rough_sphere(1)
    before = all_distances(first, second)
    assert np.array_equal(all_distances(first, second), before)
    all_distances(second, square(), samples=777, seed=9)
    np.random.default_rng(3).random(10)
    assert np.array_equal(all_distances(first, second), before)
    assert not np.array_equal(all_distances(first, second, seed=1)[3:], before[3:])


def test_mean_and_rms_combine_both_directions():
    _, found, _, _ = surface_distances(rough_sphere(0), sphere(1.2), SAMPLES, 0)
    assert found.mean == (found.forward_mean + found.backward_mean) / 2
    assert found.rms == pytest.approx(math.sqrt((found.forward_rms**2 + found.backward_rms**2) / 2), rel=1e-15)


def test_mean_is_over_the_area_not_over_the_verts():
    """Nearly all verts of the tilted square are crowded where its height is 0; over its area the mean height is 1/2."""
    coarse = triangles([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    fine = square(side=1.0, cuts=1)
    crowd = np.random.default_rng(0).random((500, 2)) * 1e-3
    fan = np.concatenate([coarse.verts, np.column_stack([crowd, crowd[:, 0]])])
    faces = np.concatenate([coarse.faces, [[4 + i, 5 + i, 6 + i] for i in range(0, 498, 3)]])
    _, found, _, _ = surface_distances(Mesh(fan, faces), fine, 20_000, 0)
    assert found.forward_mean == pytest.approx(0.5, abs=0.01)
