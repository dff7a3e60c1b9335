"""Factors of matrices over a mesh: they solve, in an order that keeps them sparse."""

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sparse_factors import SymmetricFactors, nested_dissection
from meshfit.mesh.topology import Topology
from meshfit.subdivision.sphere import icosphere
from tests.loops import over


def laplacian(mesh):
    tail, head = Topology.of(mesh).edges.T
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    links = csr_array((np.ones(len(ends[0])), ends), shape=(mesh.num_verts, mesh.num_verts))
    return csr_array(diags_array(links.sum(axis=1) + 0.1) - links)


def two_balls_and_a_point():
    ball = icosphere(2)
    verts = np.concatenate([ball.verts, ball.verts + np.array([5.0, 0, 0]), [[9.0, 9.0, 9.0]]])
    return Mesh(verts, np.concatenate([ball.faces, ball.faces + ball.num_verts]))


@over("mesh", [icosphere(0), icosphere(3), two_balls_and_a_point()])
def test_factors_solve(mesh):
    matrix = laplacian(mesh)
    order = nested_dissection(matrix, mesh.verts)
    np.testing.assert_array_equal(np.sort(order), np.arange(mesh.num_verts))
    wanted = np.random.default_rng(0).normal(size=(mesh.num_verts, 3))
    found = SymmetricFactors(matrix, order).solve(matrix @ wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-10)


def test_points_in_one_place_are_taken_in_any_order():
    mesh = icosphere(2)
    order = nested_dissection(laplacian(mesh), np.zeros_like(mesh.verts))
    np.testing.assert_array_equal(np.sort(order), np.arange(mesh.num_verts))


def test_the_order_leaves_few_entries():
    mesh = icosphere(4)
    matrix = laplacian(mesh)
    order = nested_dissection(matrix, mesh.verts)
    options = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    dissected = splu(matrix[order][:, order].tocsc(), **options).L.nnz
    minimum_degree = splu(matrix.tocsc(), **options | {"permc_spec": "MMD_AT_PLUS_A"}).L.nnz
    assert dissected < 1.4 * minimum_degree < 0.4 * splu(matrix.tocsc(), **options).L.nnz
