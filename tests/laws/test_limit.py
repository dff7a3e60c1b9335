"""Loop's limit positions: refining first changes none of them, and the limit of a plane, and of a line, is itself."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from meshfit.errors import SchemeError
from meshfit.mesh.topology import Topology
from meshfit.subdivision.limit import has_loop_limit, loop_limit
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.scheme import VertMask
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


def test_vertices_without_faces_stay():
    limit = loop_limit(Topology(4, np.array([[0, 1, 2]]))).toarray()
    np.testing.assert_array_equal(limit[3], [0, 0, 0, 1])


def test_the_vertex_rule_is_used_only_at_valences_of_inner_vertices():
    """A rule of one's own may have no value below valence 3, as boundary vertices have."""
    mesh, loop = mixed_open(), resolve("loop:weights=warren")
    rule = replace(loop, vert=VertMask(lambda n: loop.vert.ring(n) + 0 * sqrt(n - 3)))
    found, expected = (loop_limit(Topology.of(mesh), scheme).toarray() for scheme in (rule, loop))
    np.testing.assert_array_equal(found, expected)
