"""Gradients of every differentiable function against finite differences, in float64."""

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from meshfit.fitting.nearest_neighbours import match_nearest
from meshfit.fitting.sampling import sample
from meshfit.loss.chamfer import chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.operators import FaceGeometry, MeshOperators
from meshfit.mesh.mesh import Mesh
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open

OPEN, CLOSED = mixed_open(4), mixed_closed(4, inserted=6)
TRIANGLE = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5], [2, 2, 2]]), np.array([[0, 1, 2]]))
MESHES = over(
    "meshes", [[CLOSED], [OPEN], [TRIANGLE, OPEN, mixed_closed(5, inserted=1)]], ids=["closed", "open", "side by side"]
)
MEMBERS = pytest.mark.parametrize("members", [1, 3])


def surface_of(*meshes):
    return MeshOperators.of(meshes, torch.float64, torch.device("cpu"))


def verts_of(*meshes):
    return torch.tensor(np.concatenate([mesh.verts for mesh in meshes]), requires_grad=True)


def clouds():
    generator = torch.Generator().manual_seed(2)
    return torch.randn(4, 9, 3, generator=generator, dtype=torch.float64).unbind()


@MEMBERS
def test_chamfer_with_respect_to_both_sets(members):
    p, q, *_ = clouds()
    matches = match_nearest(p, q, members)
    assert gradcheck(lambda p, q: chamfer(p, q, matches), (p.requires_grad_(), q.requires_grad_()))


@MEMBERS
def test_normal_with_respect_to_both_normals(members):
    p, q, p_normals, q_normals = clouds()
    matches = match_nearest(p, q, members)
    assert gradcheck(lambda a, b: normal(a, b, matches), (p_normals.requires_grad_(), q_normals.requires_grad_()))


@MESHES
@pytest.mark.parametrize("term", [edge, laplacian_uniform])
def test_a_term_of_edges(meshes, term):
    surface = surface_of(*meshes)
    assert gradcheck(lambda verts: term(surface.edges @ verts, surface), verts_of(*meshes))


@MESHES
def test_consistency(meshes):
    surface = surface_of(*meshes)
    assert gradcheck(lambda verts: consistency(FaceGeometry.of(surface.faces, verts), surface), verts_of(*meshes))


@MESHES
def test_points_and_normals_of_a_fixed_draw(meshes):
    faces = surface_of(*meshes).faces

    def drawn(verts):
        generators = [torch.Generator().manual_seed(seed) for seed in range(len(meshes))]
        samples = sample(FaceGeometry.of(faces, verts), 12, generators)
        return samples.points, samples.normals

    assert gradcheck(drawn, verts_of(*meshes))


@pytest.mark.parametrize("mesh", [CLOSED, OPEN], ids=["closed", "open"])
def test_the_gradient_of_the_cotangent_term_holds_its_weights_constant(mesh):
    corners = mesh.verts[mesh.faces]
    weights = np.zeros((mesh.num_verts, mesh.num_verts))
    for k in range(3):
        a, b = (corners[:, (k + i) % 3] - corners[:, k] for i in (1, 2))
        cotangent = (a * b).sum(axis=1) / np.linalg.norm(np.cross(a, b), axis=1)
        i, j = mesh.faces[:, (k + 1) % 3], mesh.faces[:, (k + 2) % 3]
        np.add.at(weights, (i, j), cotangent)
        np.add.at(weights, (j, i), cotangent)
    operator = torch.tensor(weights / weights.sum(axis=1, keepdims=True) - np.eye(mesh.num_verts))
    ours, held = verts_of(mesh), verts_of(mesh)
    laplacian_cotangent(ours, surface_of(mesh)).backward()
    (operator @ held).norm(dim=1).mean().backward()
    torch.testing.assert_close(ours.grad, held.grad, rtol=1e-9, atol=1e-12)


COLLAPSED = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float),
    np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4], [4, 4, 4]]),
)


@pytest.mark.parametrize("term", ["consistency", "edge", "uniform", "cotangent", "normals of samples"])
def test_gradients_are_finite_where_faces_have_collapsed(term):
    surface, verts = surface_of(COLLAPSED), verts_of(COLLAPSED)
    faces = FaceGeometry.of(surface.faces, verts)
    value = {
        "consistency": lambda: consistency(faces, surface),
        "edge": lambda: edge(surface.edges @ verts, surface),
        "uniform": lambda: laplacian_uniform(surface.edges @ verts, surface),
        "cotangent": lambda: laplacian_cotangent(verts, surface),
        "normals of samples": (faces.normals * torch.arange(3.0)).sum,
    }[term]()
    assert value.isfinite()
    value.backward()
    assert verts.grad.isfinite().all()


def test_normals_of_faces_with_next_to_no_area():
    small = Mesh(1e-6 * OPEN.verts, OPEN.faces)
    faces = surface_of(small).faces
    assert float(FaceGeometry.of(faces, torch.tensor(small.verts)).normals.norm(dim=1).max()) < 0.1
    assert gradcheck(lambda verts: FaceGeometry.of(faces, verts).normals, verts_of(small), eps=1e-8)
