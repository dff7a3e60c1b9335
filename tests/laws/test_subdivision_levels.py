"""Several levels at once, in sequence, and on values other than positions, in numpy and torch."""

import numpy as np
import pytest
import torch

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.assemble import assemble
from meshfit.subdivision.triangles.splits import divide
from tests.laws.variants import QUADRISECTING, SQRT3, by_variant, refined
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open

MESHES = (mixed_closed, mixed_open)
SHAPES = [(), (3,), (2, 2)]


@by_variant
@over("make", lambda spec: MESHES if spec in QUADRISECTING else MESHES[:1])
def test_three_levels_are_three_times_one(spec, make):
    at_once = subdivide(make(), spec, 3)
    in_turn = make()
    for _ in range(3):
        in_turn = subdivide(in_turn, spec, 1)
    assert np.array_equal(at_once.faces, in_turn.faces)
    np.testing.assert_allclose(at_once.verts, in_turn.verts, rtol=0, atol=1e-14)


@pytest.mark.parametrize("spec", SQRT3)
def test_sqrt3_on_an_open_mesh_composes_in_pairs(spec):
    """The boundary is trisected at every second level, so that a pair of levels is the same wherever it starts."""
    four = subdivide(mixed_open(), spec, 4)
    pairs = subdivide(subdivide(mixed_open(), spec, 2), spec, 2)
    assert np.array_equal(four.faces, pairs.faces)
    np.testing.assert_allclose(four.verts, pairs.verts, rtol=0, atol=1e-14)
    singly = subdivide(subdivide(mixed_open(), spec, 1), spec, 1)
    assert len(subdivide(mixed_open(), spec, 2).verts) != len(singly.verts)


@pytest.mark.parametrize("spec", SQRT3)
def test_sqrt3_levels_follow_the_parity_of_the_step(spec):
    mesh, scheme = mixed_open(), resolve(spec)
    topology = Topology.of(mesh)
    for step, operator in enumerate(refined(mesh, spec, 3).operators):
        division = divide(topology, scheme.split, step)
        assert (len(division.border) > 0) == division.moves_border == (step % 2 == 1)
        assert np.array_equal(assemble(topology, scheme, division).toarray(), operator.toarray())
        topology = Topology(topology.num_verts + division.num_new, division.faces)


@by_variant
@over("make", MESHES)
def test_the_matrix_is_the_product_of_its_levels(spec, make):
    mesh = make()
    refinement = refined(mesh, spec, 3)
    assert len(refinement.operators) == 3
    assert refinement.matrix.shape == (refinement.faces.max() + 1, mesh.num_verts)
    np.testing.assert_allclose(refinement.matrix @ mesh.verts, refinement(mesh.verts), rtol=0, atol=1e-14)
    np.testing.assert_allclose(subdivide(mesh, spec, 3).verts, refinement(mesh.verts), rtol=0, atol=0)


@by_variant
@over("make", MESHES)
@over("shape", SHAPES)
def test_any_attribute_of_the_verts_is_carried(spec, make, shape):
    mesh = make()
    refinement = refined(mesh, spec, 2)
    values = np.random.default_rng(0).standard_normal((mesh.num_verts, *shape))
    expected = np.einsum("ij,j...->i...", refinement.matrix.toarray(), values)
    found = refinement(values)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    tensor = refinement(torch.from_numpy(values))
    assert tensor.shape == expected.shape
    assert tensor.dtype == torch.float64
    np.testing.assert_allclose(tensor.numpy(), found, rtol=0, atol=1e-14)


@by_variant
@over("make", MESHES)
def test_single_precision_stays_single(spec, make):
    mesh = make()
    refinement = refined(mesh, spec, 2)
    tensor = refinement(torch.tensor(mesh.verts, dtype=torch.float32))
    assert tensor.dtype == torch.float32
    np.testing.assert_allclose(tensor.numpy(), refinement(mesh.verts), rtol=0, atol=2e-6)


def test_single_precision_stays_single_in_numpy_too():
    mesh = mixed_open()
    assert refined(mesh, "loop", 2)(mesh.verts.astype(np.float32)).dtype == np.float32


@pytest.mark.parametrize("spec", ["loop", "interp-loop:alpha=0.5", "sqrt3", "interp-sqrt3"])
def test_gradients_flow_through_every_level(spec):
    mesh = mixed_open()
    refinement = refined(mesh, spec, 2)
    verts = torch.tensor(mesh.verts[:, :1], requires_grad=True)
    assert torch.autograd.gradcheck(refinement, (verts,))


@by_variant
@over("make", MESHES)
def test_the_gradient_is_the_transposed_matrix(spec, make):
    mesh = make()
    refinement = refined(mesh, spec, 2)
    verts = torch.tensor(mesh.verts, requires_grad=True)
    upstream = np.random.default_rng(1).standard_normal((refinement.matrix.shape[0], 3))
    refinement(verts).backward(torch.from_numpy(upstream))
    np.testing.assert_allclose(verts.grad.numpy(), refinement.matrix.T @ upstream, rtol=0, atol=1e-13)


@by_variant
def test_no_level_changes_nothing(spec):
    mesh = mixed_open()
    refinement = refined(mesh, spec, 0)
    assert refinement.operators == ()
    assert np.array_equal(refinement.faces, mesh.faces)
    assert np.array_equal(refinement(mesh.verts), mesh.verts)
    assert np.array_equal(refinement.matrix.toarray(), np.eye(mesh.num_verts))


def test_refinement_sees_connectivity_only():
    """One refinement serves any positions on the same faces, as fitting needs it."""
    mesh = mixed_closed()
    refinement = refined(mesh, "interp-loop:alpha=0.5", 2)
    moved = mesh.verts + np.random.default_rng(2).standard_normal(mesh.verts.shape)
    expected = subdivide(Mesh(moved, mesh.faces), "interp-loop:alpha=0.5", 2)
    assert np.array_equal(refinement(moved), expected.verts)
    assert np.array_equal(refinement.faces, expected.faces)


def test_per_vertex_alpha_reaches_every_level():
    mesh = mixed_closed()
    alphas = np.random.default_rng(3).random(mesh.num_verts)
    refinement = refine(Topology.of(mesh), resolve("interp-loop").with_alpha(alphas), 2)
    fine_alphas = refined(mesh, "midpoint", 1)(alphas)
    second = refine(Topology.of(subdivide(mesh, "midpoint", 1)), resolve("interp-loop").with_alpha(fine_alphas), 1)
    np.testing.assert_allclose(refinement.operators[1].toarray(), second.matrix.toarray(), rtol=0, atol=1e-15)
