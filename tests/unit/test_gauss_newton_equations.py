"""The equations of a step, against the same least squares as dense matrices in numpy."""

from functools import partial

import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton import equations
from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.equations import ControlledSurface, SparsityPattern, conjugate_gradients, solve_step
from meshfit.fitting.gauss_newton.fairness import Fairness, Tension
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.loss.sparse import Sparse
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import resolve
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, torus

MESHES = {"closed": mixed_closed, "open": mixed_open, "torus": lambda: torus(6, 5)}
EACH = pytest.mark.parametrize("mesh", [make() for make in MESHES.values()], ids=MESHES)
UPPER = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def connectivity(mesh):
    return Connectivity(torch.tensor(mesh.faces), mesh.num_verts, torch.float64)


def some_pairs(mesh, seed=0, count=400):
    generator = np.random.default_rng(seed)
    normals = generator.normal(size=(count, 3))
    return Correspondences(
        face=torch.tensor(generator.integers(mesh.num_faces, size=count)),
        corners=torch.tensor(generator.dirichlet([1.0] * 3, count)),
        normals=torch.tensor(normals / np.linalg.norm(normals, axis=1, keepdims=True)),
        residuals=torch.tensor(generator.normal(size=(count, 3))),
        weights=torch.tensor(generator.uniform(0, 2 / max(count, 1), count)),
        matched=1.0,
        reached=1.0,
        membranes=torch.zeros(mesh.num_verts, dtype=torch.float64),
    )


def some_fairness(mesh, size=0.1, *, tension=False):
    generator = np.random.default_rng(1)
    weights = generator.uniform(0.5, 2, (mesh.num_verts, 1)) * size / mesh.num_verts
    shape = (len(connectivity(mesh).edges.keys), 1)
    pull = Tension(*(torch.tensor(generator.uniform(0, most, shape)) for most in (1 / mesh.num_verts, 1)))
    return Fairness(connectivity(mesh), torch.tensor(weights), pull if tension else None)


def umbrella(mesh):
    """Each vertex less the mean of its neighbours."""
    adjacent = np.zeros((mesh.num_verts,) * 2)
    for a, b, c in mesh.faces:
        adjacent[[a, b, c, b, c, a], [b, c, a, a, b, c]] = 1
    return np.eye(mesh.num_verts) - adjacent / adjacent.sum(axis=1, keepdims=True)


def system(mesh, pairs, fairness, point_weight, fine=None, operator=None):
    """Rows and right side of which the step is the least-squares solution, of a control mesh if there is a fine one."""
    count, three, faces = len(pairs.face), np.eye(3), (fine or mesh).faces
    at = np.zeros((count, (fine or mesh).num_verts))
    np.put_along_axis(at, faces[pairs.face], pairs.corners.numpy(), axis=1)
    at = at if operator is None else at @ operator
    n, r, w = pairs.normals.numpy(), pairs.residuals.numpy(), pairs.weights.sqrt().numpy()
    across = (w[:, None, None] * at[:, :, None] * n[:, None, :]).reshape(count, -1)
    points = np.kron(np.sqrt(point_weight) * w[:, None] * at, three)
    smooth = fairness.weights.sqrt().numpy() * umbrella(mesh)
    taut = np.zeros((0, mesh.num_verts))
    if fairness.tension is not None:
        tail, head = fairness.connectivity.ends.numpy()
        taut = fairness.tension.weights.sqrt().numpy() * (np.eye(mesh.num_verts)[tail] - np.eye(mesh.num_verts)[head])
    rows = np.concatenate([across, points, np.kron(smooth, three), np.kron(taut, three)])
    right = [w * (n * r).sum(axis=1), np.sqrt(point_weight) * w[:, None] * r, -smooth @ mesh.verts]
    right.append(-taut @ mesh.verts * (0 if fairness.tension is None else 1 - fairness.tension.rest.numpy()))
    return rows, np.concatenate([part.reshape(-1) for part in right])


def solved(mesh, pairs, fairness, point_weight):
    step, _ = solve_step(SparsityPattern(connectivity(mesh)), torch.tensor(mesh.verts), pairs, fairness, point_weight)
    return step.numpy()


@pytest.fixture
def to_the_end(monkeypatch):
    """Iterations until nothing is left to gain."""
    monkeypatch.setattr(equations, "_TOLERANCE", 1e-12)
    monkeypatch.setattr(equations, "conjugate_gradients", partial(conjugate_gradients, most=500))


@EACH
@pytest.mark.parametrize("tension", [False, True])
@pytest.mark.parametrize("point_weight", [0.0, 0.05, 1.0])
@pytest.mark.usefixtures("to_the_end")
def test_the_step_is_the_least_squares_solution(mesh, point_weight, tension):
    arguments = (mesh, some_pairs(mesh), some_fairness(mesh, tension=tension), point_weight)
    expected = np.linalg.lstsq(*system(*arguments))[0].reshape(-1, 3)
    np.testing.assert_allclose(solved(*arguments), expected, atol=1e-9 * np.abs(expected).max())


@EACH
@pytest.mark.usefixtures("to_the_end")
def test_the_step_of_a_control_mesh_is_the_least_squares_solution_of_its_own_verts(mesh):
    refinement = refine(Topology.of(mesh), resolve("loop"))
    fine, matrix = Mesh(refinement(mesh.verts), refinement.faces), refinement.matrix
    operators = (Sparse.of(entries, torch.float64, torch.device("cpu")) for entries in (matrix, matrix.power(2)))
    surface = ControlledSurface(SparsityPattern(connectivity(fine)), *operators)
    pairs, fairness = some_pairs(fine), some_fairness(mesh)
    pattern, verts = SparsityPattern(connectivity(mesh)), torch.tensor(mesh.verts)
    step, _ = solve_step(pattern, verts, pairs, fairness, 0.3, surface)
    expected = np.linalg.lstsq(*system(mesh, pairs, fairness, 0.3, fine, matrix.toarray()))[0].reshape(-1, 3)
    np.testing.assert_allclose(step.numpy(), expected, atol=1e-9 * np.abs(expected).max())


@EACH
def test_the_iterations_stop_where_a_thousandth_of_the_right_side_is_left(mesh):
    arguments = (mesh, some_pairs(mesh), some_fairness(mesh), 0.5)
    rows, right = system(*arguments)
    left = rows.T @ (right - rows @ solved(*arguments).reshape(-1))
    assert np.linalg.norm(left) < 1.001e-3 * np.linalg.norm(rows.T @ right)


@EACH
@pytest.mark.usefixtures("to_the_end")
def test_without_pairs_the_surface_is_as_smooth_as_can_be(mesh):
    step = solved(mesh, some_pairs(mesh, count=0), some_fairness(mesh), 0.5)
    laplacian = umbrella(mesh)
    np.testing.assert_allclose(laplacian @ (mesh.verts + step), 0, atol=1e-7)


@EACH
def test_blocks_and_their_products_are_those_of_the_dense_matrix(mesh):
    generator = np.random.default_rng(2)
    per_face = generator.normal(size=(mesh.num_faces, 6, 6))
    dense = np.zeros((mesh.num_verts, 3) * 2)
    for face, values in zip(mesh.faces, per_face, strict=True):
        for (i, j), of_pair in zip(UPPER, values, strict=True):
            block = np.zeros((3, 3))
            for (p, q), value in zip(UPPER, of_pair, strict=True):
                block[p, q] = block[q, p] = value
            for a, b in {(face[i], face[j]), (face[j], face[i])}:
                dense[a, :, b, :] += block
    pattern = SparsityPattern(connectivity(mesh))
    blocks = pattern.blocks(torch.tensor(per_face))
    rows, columns = pattern.rows.numpy(), pattern.columns.numpy()
    np.testing.assert_allclose(blocks.numpy(), dense[rows, :, columns, :], atol=1e-12)
    np.testing.assert_array_equal(rows[pattern.diagonal], columns[pattern.diagonal])
    assert np.count_nonzero(np.abs(dense).sum(axis=(1, 3))) == len(blocks)
    x = generator.normal(size=(mesh.num_verts, 3))
    expected = np.einsum("iajb,jb->ia", dense, x)
    np.testing.assert_allclose(pattern.times(blocks)(torch.tensor(x)).numpy(), expected, atol=1e-11)


@EACH
def test_fairness_is_the_weighted_square_of_the_umbrella(mesh):
    fairness, laplacian = some_fairness(mesh), umbrella(mesh)
    dense = laplacian.T @ (fairness.weights.numpy() * laplacian)
    x = np.random.default_rng(4).normal(size=(mesh.num_verts, 3))
    np.testing.assert_allclose(fairness(torch.tensor(x)).numpy(), dense @ x, atol=1e-14)
    np.testing.assert_allclose(fairness.diagonal().numpy()[:, 0], dense.diagonal(), rtol=1e-13)


@pytest.mark.parametrize("size", [1, 4, 20])
def test_conjugate_gradients_solve(size):
    generator = np.random.default_rng(size)
    root, right = generator.normal(size=(3 * size, 3 * size)), generator.normal(size=(size, 3))
    matrix = root @ root.T + np.eye(3 * size)
    times, diagonal = torch.tensor(matrix), torch.diag_embed(torch.tensor(matrix.diagonal().reshape(-1, 3)))
    found, count = conjugate_gradients(
        lambda x: (times @ x.reshape(-1)).view(-1, 3), torch.tensor(right), diagonal, 1e-13, 1000
    )
    np.testing.assert_allclose(found.numpy().reshape(-1), np.linalg.solve(matrix, right.reshape(-1)), rtol=1e-9)
    assert count < 1000


def test_of_nothing_the_solution_is_nothing():
    found, _ = conjugate_gradients(lambda x: 2 * x, torch.zeros(4, 3), 2 * torch.eye(3).expand(4, 3, 3), 1e-3)
    torch.testing.assert_close(found, torch.zeros(4, 3), rtol=0, atol=0)


@EACH
@pytest.mark.usefixtures("to_the_end")
def test_a_translated_copy_moves_back_in_one_step(mesh):
    away = np.array([0.3, -0.2, 0.5])
    pairs, moved = some_pairs(mesh), Mesh(mesh.verts + away, mesh.faces)
    pairs = Correspondences(**vars(pairs) | {"residuals": torch.tensor(-away).expand(len(pairs.face), 3)})
    step = solved(moved, pairs, some_fairness(mesh, 1e-9), 1.0)
    np.testing.assert_allclose(moved.verts + step, mesh.verts, atol=1e-5)


@EACH
@over("tension", [False, True])
def test_the_diagonal_of_fairness_is_that_of_its_matrix(mesh, tension):
    fairness = some_fairness(mesh, tension=tension)
    matrix = torch.stack([fairness(row[:, None].expand(-1, 3))[:, 0] for row in torch.eye(mesh.num_verts).double()])
    torch.testing.assert_close(fairness.diagonal()[:, 0], matrix.diagonal())
