"""Loop's limit positions: refining first changes none of them, and the limit of a plane, and of a line, is itself."""

import numpy as np
import pytest

from meshfit.errors import SchemeError
from meshfit.mesh.topology import Topology
from meshfit.subdivision.limit import has_loop_limit, loop_limit
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import resolve
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, patch


@pytest.mark.parametrize("spec", ["loop", "loop:weights=warren"])
@over("mesh", [mixed_closed(), mixed_open()])
def test_the_limit_of_a_refined_mesh_is_that_of_the_mesh(mesh, spec):
    topology, scheme = Topology.of(mesh), resolve(spec)
    refinement = refine(topology, scheme, 2)
    fine = loop_limit(Topology(refinement.matrix.shape[0], refinement.faces), scheme) @ refinement.matrix
    np.testing.assert_allclose(fine.toarray()[: mesh.num_verts], loop_limit(topology, scheme).toarray(), atol=1e-12)


@pytest.mark.parametrize("spec", ["interp-loop", "midpoint", "modified-butterfly", "sqrt3"])
def test_no_limit_is_claimed_for_other_schemes(spec):
    assert not has_loop_limit(resolve(spec))
    with pytest.raises(SchemeError, match="loop only"):
        loop_limit(Topology.of(mixed_closed()), resolve(spec))


@over("mesh", [mixed_closed(), mixed_open()])
def test_refinement_comes_ever_nearer_to_the_limit(mesh):
    topology = Topology.of(mesh)
    goal = loop_limit(topology) @ mesh.verts
    errors = [
        np.abs(refine(topology, resolve("loop"), levels)(mesh.verts)[: mesh.num_verts] - goal).max()
        for levels in (1, 3, 5)
    ]
    assert errors[2] < errors[1] / 3 < errors[0] / 9


@over("mesh", [mixed_closed(), mixed_open(), patch(5, 4)])
def test_rows_sum_to_one(mesh):
    np.testing.assert_allclose(loop_limit(Topology.of(mesh)).sum(axis=1), 1, atol=1e-14)
