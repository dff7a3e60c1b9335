"""Step limiting: steps end where the surface is sound, and are full steps where nothing is in the way."""

import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.step_limiting import faults_of, limit_step, unsound_faces, untangle
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.measuring.quality import degenerate_faces, flipped_faces
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import self_intersecting_faces
from meshfit.mesh.solids import icosahedron, tetrahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.shapes import patch, torus


def ball(levels=2):
    mesh = subdivide(icosahedron(), "midpoint", levels)
    return Mesh(mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def bowl():
    """The lower part of a ball."""
    mesh = ball()
    used, faces = np.unique(mesh.faces[(mesh.verts[mesh.faces][:, :, 2] < 0.3).all(axis=1)], return_inverse=True)
    return Mesh(mesh.verts[used], faces.reshape(-1, 3))


def sheets():
    """Two balls that all but touch."""
    one = ball()
    return Mesh(
        np.concatenate([one.verts, one.verts + np.array([2.01, 0, 0])]), np.concatenate([one.faces, one.faces + 162])
    )


SURFACES = {"ball": ball(), "torus": torus(16, 10), "bowl": bowl(), "patch": patch(9, 8), "two balls": sheets()}
EACH = pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)
EACH_DTYPE = over("dtype", [torch.float32, torch.float64])


def connectivity(mesh, dtype=torch.float64):
    return Connectivity(torch.tensor(mesh.faces), mesh.num_verts, dtype)


def moved(mesh, step, dtype=torch.float64):
    """The surface after a limited step, and which verts were held back."""
    start = torch.tensor(mesh.verts, dtype=dtype)
    verts, held = limit_step(connectivity(mesh, dtype), start, start + torch.tensor(step, dtype=dtype))
    return Mesh(verts.double().numpy(), mesh.faces), held.numpy()


def num_unsound(mesh):
    flipped, crossing = flipped_faces(mesh, Topology.of(mesh)), self_intersecting_faces(mesh)
    return int((flipped | crossing | degenerate_faces(mesh)).sum())


def edge_length(mesh):
    a, b = mesh.verts[mesh.faces[:, 0]], mesh.verts[mesh.faces[:, 1]]
    return np.linalg.norm(a - b, axis=1).mean()


def pushed_through(mesh, number=0, depth=0.4):
    """The mesh with a vertex of it, and its neighbours less far, on the other side of the surface."""
    away = np.linalg.norm(mesh.verts - mesh.verts[number], axis=1)
    weight = np.clip(1 - away / (2.2 * edge_length(mesh)), 0, None)[:, None]
    noise = np.random.default_rng(number).normal(size=mesh.verts.shape) * edge_length(mesh)
    return Mesh(mesh.verts + weight * (noise - depth * mesh.verts[number]), mesh.faces)


@EACH
def test_the_surfaces_are_sound_to_begin_with(mesh):
    assert num_unsound(mesh) == 0


@EACH
@EACH_DTYPE
@over("size", [0.3, 5.0])
def test_a_sound_surface_stays_sound_under_wild_steps(mesh, dtype, size):
    generator, before = np.random.default_rng(7), mesh
    for _ in range(1 + (size < 1)):
        mesh = moved(mesh, size * edge_length(mesh) * generator.normal(size=mesh.verts.shape), dtype)[0]
        assert num_unsound(mesh) == 0
        assert np.isfinite(mesh.verts).all()
    if size < 1:
        assert np.abs(mesh.verts - before.verts).max() > 0.05 * edge_length(before)


@EACH
def test_what_moves_as_a_whole_moves_all_the_way(mesh):
    step = np.tile([5.0, -3.0, 0.1], (mesh.num_verts, 1))
    after, held = moved(mesh, step)
    np.testing.assert_allclose(after.verts, mesh.verts + step, atol=1e-14)
    assert not held.any()


@EACH
def test_a_step_to_a_sound_place_is_taken_to_the_bit(mesh):
    start = torch.tensor(mesh.verts)
    end = start * torch.tensor([1.0, 1.25, 0.5])
    verts, held = limit_step(connectivity(mesh), start, end)
    torch.testing.assert_close(verts, start + (end - start), rtol=0, atol=0)
    assert not held.any()


def test_no_step_is_none():
    after, held = moved(ball(), np.zeros_like(ball().verts))
    np.testing.assert_array_equal(after.verts, ball().verts)
    assert not held.any()


def test_only_the_surroundings_of_what_would_cross_are_held_back():
    """One vertex is thrown sideways, under its neighbours; the others are to grow."""
    mesh = ball(3)
    step = 0.1 * mesh.verts
    step[0] = 3 * edge_length(mesh) * np.cross(mesh.verts[0], mesh.verts[1]) - 0.2 * mesh.verts[0]
    after, held = moved(mesh, step)
    assert num_unsound(after) == 0
    near = np.linalg.norm(mesh.verts - mesh.verts[0], axis=1) < 6 * edge_length(mesh)
    assert held[0]
    assert not held[~near].any()
    np.testing.assert_allclose(after.verts[~held], 1.1 * mesh.verts[~held], rtol=1e-12)


def test_two_that_come_together_stop_before_they_meet():
    mesh = sheets()
    step = np.where(np.arange(mesh.num_verts)[:, None] < 162, 0.3, -0.3) * [1.0, 0, 0]
    after, held = moved(mesh, step)
    assert num_unsound(after) == 0
    assert held.any()
    assert not held.all()


def test_what_is_unsound_already_does_not_stop_the_rest():
    mesh = pushed_through(ball(3))
    assert num_unsound(mesh) > 0
    after, held = moved(mesh, 0.1 * mesh.verts)
    assert num_unsound(after) <= num_unsound(mesh)
    assert held.mean() < 0.2


def test_needles_are_unsound_and_triangles_of_twice_their_height_are_not():
    """Of a flat strip whose faces have a height of so much of their base."""
    for height, expected in ((0.009, 8), (0.021, 0)):
        x = np.arange(10) / 2
        mesh = Mesh(
            np.stack([x, height * (np.arange(10) % 2), 0 * x], axis=1),
            np.array([[k, k + 1 + k % 2, k + 2 - k % 2] for k in range(8)])[:, [0, 2, 1]],
        )
        found = unsound_faces(Shape(connectivity(mesh), torch.tensor(mesh.verts)))
        assert int(found.sum()) == expected


@EACH
@EACH_DTYPE
def test_a_sound_surface_is_left_as_it_is_by_untangling(mesh, dtype):
    verts = torch.tensor(mesh.verts, dtype=dtype)
    after, left = untangle(connectivity(mesh, dtype), verts)
    assert left == 0
    assert after.numpy().tobytes() == verts.numpy().tobytes()


@pytest.mark.parametrize("mesh", [ball(3), bowl()], ids=["ball", "bowl"])
@over("number", [0, 5, 40])
def test_a_surface_with_some_verts_pushed_through_it_is_mended(mesh, number):
    broken = pushed_through(mesh, number)
    assert num_unsound(broken) > 0
    verts, left = untangle(connectivity(mesh), torch.tensor(broken.verts))
    after = Mesh(verts.numpy(), mesh.faces)
    assert left == 0
    assert num_unsound(after) == 0
    far = np.linalg.norm(mesh.verts - mesh.verts[number], axis=1) > 10 * edge_length(mesh)
    np.testing.assert_array_equal(after.verts[far], broken.verts[far])


def test_what_cannot_be_mended_is_no_worse_than_before():
    """All faces of a regular tetrahedron look away from their neighbours, however small it is."""
    mesh = tetrahedron()
    verts, left = untangle(connectivity(mesh), torch.tensor(mesh.verts))
    assert left == 4
    assert int(unsound_faces(Shape(connectivity(mesh), verts)).sum()) == 4


def test_faces_that_cross_or_have_a_tiny_angle_are_named_with_their_number():
    mesh = ball(1)

    def faults(verts, faces, *, crossing=False):
        connectivity = Connectivity(torch.tensor(faces), len(verts), torch.float64, crossing)
        return faults_of(Shape(connectivity, torch.tensor(verts)))

    assert faults(mesh.verts, mesh.faces) == []
    both = (
        np.concatenate([mesh.verts, mesh.verts + np.array([1.0, 0.1, 0.2])]),
        np.concatenate([mesh.faces, mesh.faces + 42]),
    )
    (text,) = faults(*both)
    assert text.startswith("self-intersecting: ")
    assert faults(*both, crossing=True) == []
    flat = mesh.verts.copy()
    start, end, third = mesh.faces[0]
    flat[third] = 0.5 * (flat[start] + flat[end]) + 1e-4 * (flat[third] - flat[start])
    assert any(text.startswith("thin faces: ") for text in faults(flat, mesh.faces))


def test_pieces_have_a_least_number_of_vertices():
    mesh = icosahedron()
    verts, faces = np.concatenate([mesh.verts, mesh.verts + 5]), np.concatenate([mesh.faces, mesh.faces + 12])
    state = FitState.of(torch.tensor(verts), torch.tensor(faces))
    assert state.least_verts == 8
    assert state.remeshed(7.0, None) is state
