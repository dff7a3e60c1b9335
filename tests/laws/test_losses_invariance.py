"""Loss terms under rigid motions, scaling and renumbering of source and target."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from meshfit.fitting.nearest_neighbours import match_nearest
from meshfit.fitting.sampling import sample
from meshfit.loss.operators import FaceGeometry, MeshOperators
from meshfit.loss.terms import LAPLACIANS, TERMS, LossInputs
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, permuted

ALL_TERMS = TERMS | {"cotangent": LAPLACIANS["cotangent"]}
DEGREES = {"chamfer": 2, "normal": 0, "edge": 2, "laplacian": 1, "cotangent": 1, "consistency": 0}
LOOSE = Mesh(np.concatenate([mixed_open(2).verts, [[3.0, 4.0, 5.0]]]), mixed_open(2).faces)
SOURCES = over("source", [mixed_closed(2), mixed_open(2), LOOSE], ids=["closed", "open", "with a vertex of no face"])


def values(source, target):
    place = {"dtype": torch.float64, "device": torch.device("cpu")}
    surfaces = [MeshOperators.of([mesh], **place) for mesh in (source, target)]
    faces = [FaceGeometry.of(s.faces, torch.tensor(m.verts)) for s, m in zip(surfaces, (source, target), strict=True)]
    generator = torch.Generator().manual_seed(1)
    p, q = (sample(part, 200, [generator]) for part in faces)
    state = LossInputs(torch.tensor(source.verts), surfaces[0], faces[0], p, q, match_nearest(p.points, q.points))
    return {name: float(term(state)) for name, term in ALL_TERMS.items()}


def mapped(mesh, matrix, shift):
    return Mesh(mesh.verts @ np.asarray(matrix).T + shift, mesh.faces)


def assert_same(found, expected):
    assert found.keys() == DEGREES.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-8), name


@SOURCES
def test_no_term_changes_under_a_rigid_motion_of_both(source):
    turn = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    moved = (mapped(mesh, turn, [3.0, -2.0, 7.0]) for mesh in (source, cube()))
    assert_same(values(*moved), values(source, cube()))


@SOURCES
def test_no_term_changes_under_a_reflection_of_both(source):
    moved = (mapped(mesh, np.diag([1, 1, -1]), 0) for mesh in (source, cube()))
    assert_same(values(*moved), values(source, cube()))


@SOURCES
@over("factor", [0.01, 3.0, 1000.0])
def test_every_term_scales_by_its_degree(source, factor):
    before = values(source, cube())
    after = values(*(mapped(mesh, factor * np.eye(3), 0) for mesh in (source, cube())))
    assert_same(after, {name: value * factor ** DEGREES[name] for name, value in before.items()})


@SOURCES
def test_no_term_depends_on_how_verts_are_numbered(source):
    order = np.random.default_rng(0).permutation(source.num_verts)
    assert_same(values(permuted(source, order), cube()), values(source, cube()))


@SOURCES
@pytest.mark.parametrize("name", ["chamfer", "normal"])
def test_terms_between_the_two_do_change_when_one_of_them_is_turned(source, name):
    turn = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    assert values(mapped(source, turn, 0.5), cube())[name] != pytest.approx(values(source, cube())[name], rel=0.01)


@SOURCES
def test_terms_of_the_source_do_not_look_at_the_target(source):
    before, after = values(source, cube()), values(source, mapped(cube(), 2 * np.eye(3), 1))
    own = ("edge", "laplacian", "cotangent", "consistency")
    assert {name: after[name] for name in own} == {name: before[name] for name in own}
