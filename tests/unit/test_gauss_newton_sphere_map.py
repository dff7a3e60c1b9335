"""Sphere maps: one to one, less distorted after improvement, point location, and under remeshing."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton.equations import SparsityPattern
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.sphere_map import SphereMap, initial_sphere_map
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron, octahedron
from meshfit.remeshing.remesh import remesh_state
from meshfit.remeshing.state import RemeshState
from meshfit.remeshing.triangle_geometry import turned_over, unit
from meshfit.subdivision.refine import subdivide
from tests.shapes import opened, table, torus


def ball(levels=2, solid=icosahedron):
    mesh = subdivide(solid(), "midpoint", levels)
    return Mesh(mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def bumpy(levels=2, size=0.35):
    """A ball with waves, mapped to where it was."""
    mesh = ball(levels)
    x, y, z = mesh.verts.T
    radius = 1 + size * np.sin(4 * x + 1) * np.cos(3 * y) + size * z**3
    return Mesh(mesh.verts * radius[:, None] * [1.5, 1.0, 0.7], mesh.faces)


def pulled(places):
    """The sphere with all drawn towards one point, one to one: a Möbius map, as it is of the plane, by 3."""
    x, y, z = places.T
    scale = 2 * 3 / ((1 - z) * 9 + (1 + z))
    return np.stack([scale * x, scale * y, ((1 + z) - (1 - z) * 9) / ((1 + z) + (1 - z) * 9)], axis=1)


def sphere_map(mesh):
    return SphereMap(
        SparsityPattern(Connectivity(torch.tensor(mesh.faces), mesh.num_verts, torch.float64)), tensor(mesh)
    )


def tensor(mesh):
    return torch.tensor(mesh.verts)


def mean_energy(mesh, places, power=1, lengths=None):
    """|J|² + |J⁻¹|² by singular values, in numpy, of faces laid flat and scaled to the sphere's area.

    They are seen from above the middle of the face on the sphere.
    """
    a, b, c = (mesh.verts[mesh.faces[:, k]] for k in range(3))
    unit_of = np.ones(mesh.num_faces) if lengths is None else lengths[mesh.faces].mean(1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2 / unit_of**2
    p, q, r = (places.numpy()[mesh.faces[:, k]] for k in range(3))
    total = 0.0
    for k in range(mesh.num_faces):
        sides = np.stack([b[k] - a[k], c[k] - a[k]], axis=1) * np.sqrt(4 * np.pi / area.sum()) / unit_of[k]
        flat = np.linalg.qr(sides)[1]
        seen = np.linalg.svd((p[k] + q[k] + r[k])[None])[2][1:]
        there = seen @ np.stack([q[k] - p[k], r[k] - p[k]], axis=1)
        stretch = np.linalg.svd(there @ np.linalg.inv(flat), compute_uv=False)
        total += area[k] / area.sum() * (stretch**2 + stretch**-2.0).sum() ** power
    return total


def least_sine(places, faces):
    """The least volume under a face, over its mean: above 0, the map is one to one."""
    a, b, c = (places[faces[:, k]] for k in range(3))
    volume = (torch.linalg.cross(a, b) * c).sum(1)
    return float(volume.min() / volume.mean())


MAPS = {
    "ball, pulled": (ball(), torch.tensor(pulled(ball().verts))),
    "octahedral ball, pulled": (ball(2, octahedron), torch.tensor(pulled(ball(2, octahedron).verts))),
    "bumpy": (bumpy(), torch.tensor(ball().verts)),
    "bumpy, pulled": (bumpy(), torch.tensor(pulled(ball().verts))),
    "its rays": (bumpy(), unit(tensor(bumpy()))),
}
EACH = pytest.mark.parametrize(("mesh", "places"), MAPS.values(), ids=MAPS)


@EACH
def test_the_energy_is_that_of_the_singular_values(mesh, places):
    own = sphere_map(mesh)
    density, _ = own.energy(places)
    weights = own._gradients[1]
    assert float((weights * density).sum()) == pytest.approx(mean_energy(mesh, places), rel=1e-9)
    assert float(density.min()) >= 4 - 1e-12


@EACH
def test_lengths_measure_the_surface_where_they_differ(mesh, places):
    lengths = np.random.default_rng(2).uniform(0.5, 2, mesh.num_verts)
    own = replace(sphere_map(mesh), lengths=torch.tensor(lengths))
    total = float((own._gradients[1] * own.energy(places)[0]).sum())
    assert total == pytest.approx(mean_energy(mesh, places, lengths=lengths), rel=1e-9)


@EACH
def test_a_step_goes_along_the_gradient_of_the_energy(mesh, places):
    """By differences, along random directions."""
    own, generator = sphere_map(mesh), torch.Generator().manual_seed(4)
    slope, size = own._slope(places), 1e-6
    for _ in range(2):
        way = torch.randn(places.shape, generator=generator, dtype=torch.float64)
        ahead, behind = (mean_energy(mesh, places + sign * size * way, own.power) for sign in (1, -1))
        assert float((slope * way).sum()) == pytest.approx((ahead - behind) / (2 * size), rel=1e-5)


def test_no_energy_is_lower_than_that_of_a_face_about_to_turn_over():
    """Three points on one great circle are a face without area on the sphere, though their triangle has some."""
    mesh, places = ball(), ball().verts.copy()
    a, b, c = mesh.faces[0]
    across = np.cross(places[a], places[b])
    places[c] -= (1 - 1e-4) * (places[c] @ across) / (across @ across) * across
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    before, after = (sphere_map(mesh).energy(torch.tensor(at))[0][0] for at in (ball().verts, places))
    assert float(after) > 1e4 * float(before)


@EACH
def test_improving_lowers_the_energy_and_turns_no_face_over(mesh, places):
    assert least_sine(places, torch.tensor(mesh.faces)) > 0
    energy = [mean_energy(mesh, places, 2)]
    for _ in range(5):
        places = sphere_map(mesh).improved(places, 1)
        energy.append(mean_energy(mesh, places, 2))
        assert least_sine(places, torch.tensor(mesh.faces)) > 0
        np.testing.assert_allclose(places.norm(dim=1), 1, atol=1e-12)
    assert (np.diff(energy) <= 1e-9).all()
    # Of what exceeds the least value that there is.
    assert energy[-1] - 16 < 0.5 * (energy[0] - 16)


@pytest.mark.parametrize("solid", [icosahedron, octahedron])
@pytest.mark.parametrize("levels", [0, 2])
def test_the_sphere_itself_has_the_least_energy_there_is_and_keeps_it(solid, levels):
    mesh = ball(levels, solid)
    own, places = sphere_map(mesh), tensor(mesh)
    scale = 4 * np.pi / (np.linalg.norm(area_vectors_of(mesh), axis=1).sum() / 2)
    # Faces lie a little below the sphere; scaled to its area they are larger than on it, all by the same factor.
    expected = 2 / scale + 2 * scale
    # But for being seen from above their middles, which are not quite those of their circles.
    np.testing.assert_allclose(own.energy(places)[0], expected, rtol=2e-3 if levels else 1e-9)
    assert mean_energy(mesh, own.improved(places, 20), 2) <= mean_energy(mesh, places, 2) * (1 + 1e-9)


def area_vectors_of(mesh):
    a, b, c = (mesh.verts[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def test_a_pulled_ball_comes_back_to_the_least_energy():
    mesh = ball()
    places = sphere_map(mesh).improved(torch.tensor(pulled(mesh.verts)), 60)
    assert mean_energy(mesh, places) < 1.002 * mean_energy(mesh, tensor(mesh))


@EACH
def test_points_are_found_with_their_face_and_their_weights_there(mesh, places):
    faces, generator = torch.tensor(mesh.faces), np.random.default_rng(3)
    weights = torch.tensor(generator.dirichlet([1.0] * 3, 700))
    weights[:200, 2] = 0
    weights = weights / weights.sum(1, keepdim=True)
    drawn = torch.tensor(generator.integers(mesh.num_faces, size=700))
    inside = unit((weights[:, :, None] * places[faces[drawn]]).sum(1))
    points = torch.cat([places, unit(places[faces[:, 0]] + places[faces[:, 1]]), inside])
    found, at = sphere_map(mesh).located(places, points)
    assert float(at.min()) >= 0
    np.testing.assert_allclose(at.sum(1), 1, atol=1e-12)
    np.testing.assert_allclose(unit((at[:, :, None] * places[faces[found]]).sum(1)), points, atol=1e-9)
    np.testing.assert_array_equal(found[-500:], drawn[-500:])
    np.testing.assert_allclose(at[: len(places)].amax(1), 1, atol=1e-9)


@pytest.mark.slow
def test_remeshing_keeps_the_map_one_to_one_and_each_vertex_near_its_place():
    """Where a vertex is on the sphere, there the surface was at first is no farther off than an edge of each remesh."""
    mesh, moved = bumpy(3), 0.0
    surface = RemeshState(tensor(mesh), torch.tensor(mesh.faces), torch.ones(642).double())
    surface = replace(surface, on_sphere=torch.tensor(ball(3).verts))
    for wanted in (0.15, 0.25, 0.1, 0.3):
        lengths, moved = torch.full_like(surface.lengths, wanted), moved + wanted
        surface = remesh_state(RemeshState(surface.verts, surface.faces, lengths, on_sphere=surface.on_sphere), 3)
        assert len(surface.on_sphere) == len(surface.verts)
        assert not bool(turned_over(surface.on_sphere, surface.faces).any())
        np.testing.assert_allclose(surface.on_sphere.norm(dim=1), 1, atol=1e-12)
        found, at = sphere_map(mesh).located(torch.tensor(ball(3).verts), surface.on_sphere)
        there = (at.numpy()[:, :, None] * mesh.verts[mesh.faces[found]]).sum(1)
        assert np.linalg.norm(there - surface.verts.numpy(), axis=1).max() < moved


def test_a_connectivity_put_on_its_own_surface_by_its_own_map_lies_where_it_was():
    mesh = bumpy()
    surface = FitState.of(tensor(mesh), torch.tensor(mesh.faces), torch.tensor(ball().verts))
    cloud = TargetCloud.of(mesh, torch.float64, torch.device("cpu"))
    better = surface.with_better_map(40, cloud)
    carried = surface.with_connectivity(torch.tensor(mesh.faces), better.on_sphere, cloud)
    np.testing.assert_allclose(carried.verts, mesh.verts, atol=1e-9)


def test_more_of_the_sphere_goes_to_where_lengths_are_short():
    mesh = ball(3)
    north = mesh.verts[:, 2] > 0
    places = replace(sphere_map(mesh), lengths=torch.tensor(np.where(north, 0.5, 1.0))).improved(tensor(mesh), 30)
    a, b, c = (places[torch.tensor(mesh.faces)[:, k]] for k in range(3))
    area = torch.linalg.cross(b - a, c - a).norm(dim=1).numpy()
    share = area[north[mesh.faces].all(1)].sum() / area.sum()
    assert 0.6 < share < 0.85


def test_a_sphere_has_a_map_by_its_rays():
    mesh = Mesh(3 * ball().verts + [5.0, 6.0, 7.0], ball().faces)
    np.testing.assert_allclose(initial_sphere_map(mesh), ball().verts, atol=1e-12)


def two_pieces():
    one = ball(1)
    return Mesh(np.concatenate([one.verts, one.verts + 3]), np.concatenate([one.faces, one.faces + one.num_verts]))


def bent():
    """A long ball bent to a horseshoe, which its mean is not inside of."""
    x, y, z = (ball(3).verts * [4.0, 0.3, 0.3]).T
    return Mesh(np.stack([(2 - y) * np.sin(x / 1.6), (2 - y) * np.cos(x / 1.6), z], axis=1), ball(3).faces)


def legged():
    """A ball with long legs."""
    return table(3)


@pytest.mark.parametrize("make", [bent, pytest.param(legged, marks=pytest.mark.slow)])
def test_shapes_without_a_central_projection_are_mapped_by_way_of_the_plane(make):
    mesh = make()
    rays = unit(tensor(mesh) - tensor(mesh).mean(0))
    assert bool(turned_over(rays, torch.tensor(mesh.faces)).any())
    places = initial_sphere_map(mesh)
    assert least_sine(places, torch.tensor(mesh.faces)) > 0
    np.testing.assert_allclose(places.norm(dim=1), 1, atol=1e-12)
    assert mean_energy(mesh, places) < 30


@pytest.mark.parametrize("make", [torus, lambda: opened(ball(), 0), two_pieces])
def test_only_spheres_have_a_map(make):
    assert initial_sphere_map(make()) is None
