"""Masks check themselves, and the statements of the table about each scheme are true."""

from dataclasses import FrozenInstanceError
from fractions import Fraction

import numpy as np
import pytest

from meshfit.errors import SchemeError
from meshfit.mesh.topology import Topology
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.refine import refine
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.scheme import EdgeMask, FaceMask, Split, SpokeMask, TriangleScheme, VertMask
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, patch, torus

HALF = Fraction(1, 2)
KEPT = {0: Fraction(1)}


@over(
    ("make", "message"),
    [
        (lambda: EdgeMask(Fraction(3, 8)), "an edge mask sum to 3/4, not to 1"),
        (lambda: EdgeMask(HALF, opposite=Fraction(1, 8), wing=Fraction(1, 16)), "an edge mask sum to 3/2"),
        (lambda: SpokeMask(lambda n: (1 + 1e-9, *[0.0] * n)), "a spoke mask at valence 3"),
        (lambda: FaceMask(Fraction(1, 3), across=Fraction(1, 9)), "a face mask sum to 4/3"),
        (lambda: FaceMask(Fraction(32, 81), wing=Fraction(-2, 81)), "a face mask sum to 28/27"),
        (lambda: CurveMask({0: HALF}, ()), "the vertex mask of a curve sum to 1/2"),
        (lambda: CurveMask(KEPT, ({0: HALF, 1: HALF}, {0: HALF})), "the edge mask of a curve sum to 1/2"),
        (lambda: SpokeMask(lambda n: (3 / 4, *[1 / (2 * n)] * n)), "a spoke mask at valence 3 sum to 1.25"),
        (lambda: SpokeMask(lambda n: (0.5, 0.5)), "has 2 weights at valence 3, not 4"),
        (lambda: SpokeMask(lambda n: (1.0, *[0.0] * n) if n < 12 else (2.0, *[0.0] * n)), "at valence 12 sum to 2"),
    ],
)
def test_masks_that_do_not_sum_to_one_are_refused(make, message):
    with pytest.raises(SchemeError, match=message):
        make()


def test_fractions_must_sum_exactly_and_floats_but_for_rounding():
    almost = HALF + Fraction(1, 10**15)
    with pytest.raises(SchemeError, match="not to 1"):
        EdgeMask(almost)
    SpokeMask(lambda n: (1 + 1e-15, *[0.0] * n))


@over("name", TRIANGLE_SCHEMES)
def test_kind_in_the_table_is_what_the_scheme_does(name):
    mesh = mixed_open()
    kept = refine(Topology.of(mesh), resolve(name), 2).matrix.toarray()[: mesh.num_verts]
    assert np.array_equal(kept, np.eye(mesh.num_verts)) == (TRIANGLE_SCHEMES[name].kind == "interpolatory")


@over("name", TRIANGLE_SCHEMES)
def test_parameters_in_the_table_matter_and_their_defaults_are_allowed(name):
    mesh = mixed_closed()
    entry, topology = TRIANGLE_SCHEMES[name], Topology.of(mesh)
    for key, parameter in entry.parameters.items():
        assert parameter.check(key, parameter.default) == parameter.default
        matrices = [refine(topology, resolve(name, **{key: value}), 1).matrix.toarray() for value in parameter.allowed]
        assert np.abs(matrices[0] - matrices[1]).max() > 1e-3, f"{key} changes nothing"


@over("name", TRIANGLE_SCHEMES)
def test_every_entry_tells_title_continuity_and_source(name):
    entry = TRIANGLE_SCHEMES[name]
    assert name == name.lower()
    assert " " not in name
    for text in (entry.title, entry.continuity, entry.source):
        assert len(text) > 1
    assert all(len(parameter.meaning) > 3 for parameter in entry.parameters.values())


def test_declared_schemes_are_frozen():
    scheme = resolve("loop")
    with pytest.raises(FrozenInstanceError):
        scheme.split = Split.SQRT3
    with pytest.raises(FrozenInstanceError):
        scheme.inserted.end = HALF


def test_with_alpha_leaves_the_scheme_it_came_from():
    scheme = resolve("interp-loop:alpha=0.5,valence3=zorin")
    other = scheme.with_alpha(0.25)
    assert (scheme.alpha, other.alpha) == (0.5, 0.25)
    assert other.at_valence3 is scheme.at_valence3
    with pytest.raises(SchemeError, match="no parameter alpha; interp-loop, interp"):
        resolve("loop").with_alpha(0.5)


def test_a_scheme_of_ones_own_is_laid_down_by_its_masks():
    """The ten-point butterfly family's member without wings' ends, under vertex smoothing of a fifth, on a torus."""
    mesh = torus(6, 5)
    masks = EdgeMask(Fraction(5, 8), opposite=Fraction(1, 8), wing=Fraction(-1, 8))
    own = TriangleScheme(
        Split.QUADRISECT, masks, CurveMask(KEPT, ({0: HALF, 1: HALF},)), vert=VertMask(lambda n: n / 30)
    )
    matrix = refine(Topology.of(mesh), own, 1).matrix.toarray()
    old, new = matrix[: mesh.num_verts], matrix[mesh.num_verts :]
    np.testing.assert_allclose(np.diag(old), 4 / 5, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.sort(old, axis=1)[:, -7:-1], 1 / 30, rtol=0, atol=1e-15)
    assert {tuple(np.sort(row[row != 0])) for row in new} == {(*[-1 / 8] * 4, *[1 / 8] * 2, *[5 / 8] * 2)}


def test_push_back_works_on_any_split():
    """Blending √3 towards interpolation: at 1 old verts stay, new ones get the mean displacement of their face."""
    mesh = mixed_closed()
    base, topology = resolve("sqrt3"), Topology.of(mesh)
    smooth = refine(topology, base, 1).matrix.toarray()
    for alpha in (0.0, 0.5, 1.0):
        blend = TriangleScheme(base.split, base.inserted, base.boundary, base.vert, alpha=alpha)
        found = refine(topology, blend, 1).matrix.toarray()
        displacement = np.eye(mesh.num_verts) - smooth[: mesh.num_verts]
        expected_new = smooth[mesh.num_verts :] + alpha * displacement[mesh.faces].mean(axis=1)
        np.testing.assert_allclose(found[: mesh.num_verts], smooth[: mesh.num_verts] + alpha * displacement, atol=1e-15)
        np.testing.assert_allclose(found[mesh.num_verts :], expected_new, atol=1e-15)


def test_unified_sqrt3_has_the_weights_derived_for_it():
    """Regular, α = 1: 11/27 at the corners, -1/27 across the edges, -1/54 at the six others."""
    mesh, base = torus(9, 8), resolve("sqrt3")
    blend = TriangleScheme(base.split, base.inserted, base.boundary, base.vert, alpha=1.0)
    rows = refine(Topology.of(mesh), blend, 1).matrix.toarray()[mesh.num_verts :]
    expected = np.array([-1 / 27] * 3 + [-1 / 54] * 6 + [11 / 27] * 3)
    for row in rows:
        np.testing.assert_allclose(np.sort(row[np.abs(row) > 1e-15]), np.sort(expected), rtol=0, atol=1e-15)


def test_pushed_back_ternary_bspline_is_labsik_and_greiners_boundary_rule():
    """Two thirds and one third of the displacements turn (1, 16, 10) / 27 into (-5, 60, 30, -4) / 81."""
    mesh, base = patch(9, 6), resolve("sqrt3")
    blend = TriangleScheme(base.split, base.inserted, base.boundary, base.vert, alpha=1.0)
    rows = refine(Topology.of(mesh), blend, 2).operators[1].toarray()
    for weights in ([-5, 60, 30, -4], [-4, 30, 60, -5]):
        expected = np.zeros(rows.shape[1])
        expected[2:6] = np.array(weights) / 81
        assert (np.abs(rows - expected).max(axis=1) < 1e-15).sum() == 1
