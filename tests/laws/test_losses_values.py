"""Loss terms with values known by hand, and their precision in float32."""

from functools import partial

import numpy as np
import pytest
import torch

from meshfit.fitting.nearest_neighbours import brute_force, match_nearest
from meshfit.loss.chamfer import Matches, chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.operators import FaceGeometry, MeshOperators
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS, cube, octahedron
from tests.shapes import patch, wheel


def prepared(mesh):
    return torch.tensor(mesh.verts), MeshOperators.of([mesh], torch.float64, torch.device("cpu"))


def of_edges(term, mesh):
    verts, surface = prepared(mesh)
    return float(term(surface.edges @ verts, surface))


def of_verts(term, mesh):
    return float(term(*prepared(mesh)))


def bend(mesh):
    verts, surface = prepared(mesh)
    return float(consistency(FaceGeometry.of(surface.faces, verts), surface))


@pytest.mark.parametrize("mesh", [patch(5, 4), wheel(7, 2)], ids=["patch", "wheel"])
def test_consistency_is_0_on_a_plane_whichever_way_faces_are_wound(mesh):
    turned = np.arange(mesh.num_faces) % 3 == 0
    assert bend(mesh) == pytest.approx(0, abs=1e-15)
    wound = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    assert bend(Mesh(mesh.verts, wound)) == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("solid", "value"),
    [("octahedron", 1 - 1 / 3), ("tetrahedron", 1 + 1 / 3), ("icosahedron", 1 - 5**0.5 / 3), ("cube", 12 / 18)],
)
def test_consistency_of_a_solid_follows_from_its_dihedral_angle(solid, value):
    assert bend(SOLIDS[solid]()) == pytest.approx(value)


def test_consistency_of_a_triangle_folded_flat_onto_its_neighbour_is_2():
    verts = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 2, 0]], dtype=float)
    assert bend(Mesh(verts, np.array([[0, 1, 2], [1, 0, 3]]))) == pytest.approx(2)


def test_consistency_without_neighbouring_faces_is_0_with_a_gradient_of_0():
    verts, surface = prepared(Mesh(octahedron().verts, octahedron().faces[:1]))
    value = consistency(FaceGeometry.of(surface.faces, verts.requires_grad_()), surface)
    value.backward()
    assert value.item() == 0
    assert not verts.grad.any()


def test_edge_of_a_triangle_of_sides_3_4_5_is_the_mean_of_their_squares():
    mesh = Mesh(np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]]))
    assert of_edges(edge, mesh) == pytest.approx(50 / 3)


def test_edge_counts_an_edge_of_two_faces_once():
    side = 2 / 3**0.5  # of a cube on the unit sphere; 12 sides and 6 diagonals
    assert of_edges(edge, cube()) == pytest.approx((12 * side**2 + 6 * 2 * side**2) / 18)


LAPLACIANS = pytest.mark.parametrize(
    "laplacian", [partial(of_edges, laplacian_uniform), partial(of_verts, laplacian_cotangent)], ids=["uniform", "cot"]
)


@LAPLACIANS
def test_laplacian_of_an_octahedron_is_its_radius(laplacian):
    """The neighbours of each vertex are centred on the origin."""
    assert laplacian(octahedron()) == pytest.approx(1)


@LAPLACIANS
def test_laplacian_of_verts_without_neighbours_is_0_wherever_they_lie(laplacian):
    """It is a mean over all vertices, to whose sum the three loose ones add nothing."""
    mesh = Mesh(np.concatenate([octahedron().verts, np.full((3, 3), 9.0)]), octahedron().faces)
    assert laplacian(mesh) == pytest.approx(6 / 9)


def cloud(seed, count=50):
    return torch.tensor(np.random.default_rng(seed).normal(size=(count, 3)))


def test_chamfer_of_a_set_and_itself_in_another_order_is_0():
    p = cloud(0)
    q = p[torch.randperm(len(p), generator=torch.Generator().manual_seed(0))]
    assert float(chamfer(p, q, match_nearest(p, q))) == 0


def test_chamfer_adds_both_directions_each_a_mean_of_its_own():
    p, q = torch.tensor([[0.0, 0, 0]]), torch.tensor([[1.0, 0, 0], [3.0, 0, 0]])
    assert float(chamfer(p, q, match_nearest(p, q))) == pytest.approx(1 + (1 + 9) / 2)


def test_normal_is_0_for_flipped_normals_and_2_for_perpendicular_ones():
    p, normals = cloud(0), torch.nn.functional.normalize(cloud(1), dim=1)
    matches = match_nearest(p, p)
    assert float(normal(normals, normals, matches)) == pytest.approx(0, abs=1e-12)
    assert float(normal(normals, -normals, matches)) == pytest.approx(0, abs=1e-12)
    across = torch.linalg.cross(normals, torch.nn.functional.normalize(cloud(2), dim=1))
    assert float(normal(normals, across, matches)) == pytest.approx(2)


def test_normal_matched_by_hand_takes_the_cosine_of_each_pair():
    p_normals, q_normals = torch.eye(3)[:2], torch.tensor([[0.6, 0.8, 0.0]])
    matches = Matches(torch.tensor([0, 0]), torch.tensor([1]))
    assert float(normal(p_normals, q_normals, matches)) == pytest.approx((0.4 + 0.2) / 2 + 0.2)


def far_and_near(count=200):
    """Points a thousand from the origin and their partners about 1e-4 away, in float32."""
    generator = np.random.default_rng(0)
    p = 1000 + generator.uniform(-1, 1, size=(count, 3))
    q = p + 2e-4 * generator.choice([-1, 1], size=(count, 3))
    return torch.tensor(p, dtype=torch.float32), torch.tensor(q, dtype=torch.float32)


def test_chamfer_keeps_its_digits_in_float32_far_from_the_origin():
    p, q = far_and_near()
    pairs = Matches(torch.arange(len(p)), torch.arange(len(p)))
    exact = float(chamfer(p.double(), q.double(), pairs))
    assert 1e-8 < exact < 1e-6
    assert float(chamfer(p, q, pairs)) == pytest.approx(exact, rel=1e-4)
    expanded = (p.square().sum(1) + q.square().sum(1) - 2 * (p * q).sum(1)).mean()
    assert abs(float(expanded) - exact / 2) > exact  # the shorter formula has no digit right


@pytest.mark.parametrize(
    "nearest",
    [lambda p, q: match_nearest(p, q).forward, lambda p, q: brute_force(p[None], q[None])[0][0]],
    ids=["tree", "blocks"],
)
def test_matches_are_right_in_float32_far_from_the_origin(nearest):
    p, q = far_and_near()
    exact = torch.cdist(p.double(), q.double(), compute_mode="donot_use_mm_for_euclid_dist")
    found = exact[torch.arange(len(p)), nearest(p, q)]
    torch.testing.assert_close(found, exact.min(1).values, rtol=1e-5, atol=0)
