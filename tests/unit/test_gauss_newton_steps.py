"""Gauss–Newton steps: their invariances, and what they leave unchanged."""

import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton import target
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.subdivision.refine import subdivide
from tests.shapes import mixed_closed, mixed_open


@pytest.fixture(autouse=True)
def fewer_points(monkeypatch):
    monkeypatch.setattr(target, "_POINTS", 3000)


def stepped(source, goal, *, dtype=torch.float64, fairness=0.1, point_weight=0.3):
    surface = FitState.of(torch.tensor(source.verts, dtype=dtype), torch.tensor(source.faces))
    cloud = TargetCloud.of(goal, dtype, torch.device("cpu"))
    return surface.step(cloud, fairness, point_weight, torch.Generator().manual_seed(1))


@pytest.mark.parametrize("mesh", [mixed_closed(), mixed_open()], ids=["closed", "open"])
def test_a_step_goes_with_rotations_translations_and_scale(mesh):
    """Of source and target together; the points drawn of the target move along."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= 2.5 * np.sign(np.linalg.det(turn))
    box = subdivide(cube(), "loop", 2)
    goal = Mesh(1.3 * box.verts + [0.1, 0.2, -0.1], box.faces)
    meshes = {"as it is": (mesh, goal)}
    meshes["turned"] = tuple(Mesh(each.verts @ turn.T + [1, 2, 3], each.faces) for each in (mesh, goal))
    taken = {name: stepped(*pair) for name, pair in meshes.items()}
    before, after = taken["as it is"], taken["turned"]
    np.testing.assert_allclose(after.state.verts, before.state.verts.numpy() @ turn.T + [1, 2, 3], atol=1e-9)
    assert np.abs(before.state.verts.numpy() - mesh.verts).max() > 1e-3
    assert after.held == before.held
    assert after.pairs.distance == pytest.approx(2.5 * before.pairs.distance)


@pytest.mark.parametrize("radius", [0.3, 1.0, 3.0])
def test_the_first_step_of_a_ball_leads_most_of_the_way_to_a_ball_about_it(radius):
    ball = subdivide(icosahedron(), "loop", 2)
    unit = ball.verts / np.linalg.norm(ball.verts, axis=1, keepdims=True)
    taken = stepped(Mesh(unit, ball.faces), Mesh(radius * unit, ball.faces), fairness=1e-6)
    found = np.linalg.norm(taken.state.verts.numpy(), axis=1)
    assert taken.held == 0
    assert taken.pairs.matched == 1
    assert float(taken.pairs.weights.sum()) == pytest.approx(2)
    assert np.abs(found - radius).max() < 0.1 * abs(radius - 1) + 0.02 * radius


def test_a_vertex_of_no_face_stays_where_it_is():
    ball = icosahedron()
    loose = Mesh(np.concatenate([ball.verts, [[7.0, 8.0, 9.0]]]), ball.faces)
    taken = stepped(loose, cube())
    np.testing.assert_array_equal(taken.state.verts[-1], [7, 8, 9])


def test_distances_are_those_of_the_surface_to_the_target_both_ways():
    """Of two parallel squares, exactly how far they are apart, when points find those across from them."""
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float), np.array([[0, 1, 2], [0, 2, 3]]))
    fine = subdivide(square, "midpoint", 3)
    pairs = stepped(fine, Mesh(fine.verts + np.array([0, 0, 0.25]), fine.faces)).pairs
    assert pairs.matched == 1
    assert pairs.distance == pytest.approx(0.25, rel=2e-3)


def test_opposite_faces_do_not_correspond():
    fine = subdivide(icosahedron(), "midpoint", 2)
    inside_out = Mesh(1.1 * fine.verts, fine.faces[:, ::-1].copy())
    assert stepped(fine, inside_out).pairs.matched == 0
