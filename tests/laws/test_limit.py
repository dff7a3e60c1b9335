"""Loop's limit positions: refining first changes none of them, and the limit of a plane, and of a line, is itself."""

import numpy as np
import pytest

from meshfit.mesh.topology import Topology
from meshfit.subdivision.choose import scheme_of
from meshfit.subdivision.limit import loop_limit
from meshfit.subdivision.refine import refine
from tests.shapes import mixed_closed, mixed_open, patch


@pytest.mark.parametrize("mesh", [mixed_closed(), mixed_open()], ids=["closed", "open"])
def test_the_limit_of_a_refined_mesh_is_that_of_the_mesh(mesh):
    topology = Topology.of(mesh)
    refinement = refine(topology, scheme_of("loop"), 2)
    fine = loop_limit(Topology(refinement.matrix.shape[0], refinement.faces)) @ refinement.matrix
    np.testing.assert_allclose(fine.toarray()[: mesh.num_verts], loop_limit(topology).toarray(), atol=1e-12)


@pytest.mark.parametrize("mesh", [mixed_closed(), mixed_open()], ids=["closed", "open"])
def test_refinement_comes_ever_nearer_to_the_limit(mesh):
    topology = Topology.of(mesh)
    goal = loop_limit(topology) @ mesh.verts
    errors = [
        np.abs(refine(topology, scheme_of("loop"), levels)(mesh.verts)[: mesh.num_verts] - goal).max()
        for levels in (1, 3, 5)
    ]
    assert errors[2] < errors[1] / 3 < errors[0] / 9


@pytest.mark.parametrize("mesh", [mixed_closed(), mixed_open(), patch(5, 4)], ids=["closed", "open", "patch"])
def test_rows_sum_to_one(mesh):
    np.testing.assert_allclose(loop_limit(Topology.of(mesh)).sum(axis=1), 1, atol=1e-14)
