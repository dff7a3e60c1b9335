"""Eigenvalues around boundary vertices, against closed forms, tabulated values and the tests' own local matrices."""

from math import cos, pi, sqrt

import numpy as np
import pytest

from meshfit.analysis.analyse import NEIGHBOURS, analyse
from meshfit.analysis.extraordinary_vertex import analyse_boundary
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.errors import SchemeError
from meshfit.subdivision.registry import resolve
from tests.analysis.cases import analysed, by_scheme
from tests.laws.local_matrix import boundary_matrix
from tests.laws.test_subdivision_spectra import moduli
from tests.loops import over

INTERP_LOOP = {
    2: (0.5, 0.25, 0.25),
    3: (0.5, 0.391, 0.25),
    4: (0.5, 0.5, 0.25),
    5: (0.544, 0.5, 0.391),
    6: (0.566, 0.5, 0.459),
    7: (0.578, 0.5, 0.5),
}


def test_interp_loop():
    found = {place.neighbours: place for place in analysed("interp-loop", (5,)).boundary}
    assert tuple(found) == NEIGHBOURS
    for count, expected in INTERP_LOOP.items():
        np.testing.assert_allclose(found[count].moduli, expected, rtol=0, atol=6e-4)


@pytest.mark.slow
def test_loop_in_closed_form():
    """With k neighbours, 3/8 + cos(π j / (k - 1)) / 4 beside the curve's 1/2.

    From 7 on two of them are no less than 1/2, so that the boundary's tangent is not in the tangent plane (Biermann,
    Levin and Zorin 2000, Piecewise smooth subdivision surfaces with normal control).
    """
    for place in analyse(resolve("loop"), (5,)).boundary[1:]:
        k = place.neighbours
        across = [3 / 8 + cos(pi * j / (k - 1)) / 4 for j in range(1, k - 1)]
        expected = sorted([1 / 2, 1 / 4, *across], reverse=True)[:3]
        np.testing.assert_allclose(place.moduli, expected, rtol=0, atol=1e-7)  # 1/2 is double at 7
        assert place.in_order == (k < 7)


@by_scheme(["loop", "interp-loop", "butterfly", "modified-butterfly", "interp-loop:alpha=0.5"])
@over("count", [3, 5, 6])
def test_the_tests_own_matrices_have_the_same_eigenvalues(spec, count):
    place = analyse_boundary(stencil_meshes(resolve(spec)), 1, 2, 2, count)
    theirs = moduli(boundary_matrix(count, spec, 3))
    np.testing.assert_allclose(place.moduli, theirs[1:4], rtol=0, atol=1e-5)


def test_catmull_clark_in_closed_form():
    """What vanishes on the boundary is an odd function on a closed wheel of 2 (k - 1) spokes, in its j-th mode."""
    for place in analyse(resolve("catmull-clark"), (5,)).boundary:
        angles = [pi * j / (place.neighbours - 1) for j in range(1, place.neighbours - 1)]
        across = [(5 + cos(t) + cos(t / 2) * sqrt(2 * (9 + cos(t)))) / 16 for t in angles]
        if place.neighbours > 2:
            expected = sorted([1 / 2, 1 / 4, *across], reverse=True)[:3]
            np.testing.assert_allclose(place.moduli, expected, rtol=0, atol=1e-7)


@by_scheme(["kobbelt", "interp-catmull-clark", "sqrt2", "interp-sqrt2", "ternary"])
def test_straight_boundaries_of_quads_are_in_order(spec):
    """At three neighbours the mesh is regular up to its boundary, and the tangent plane has both directions."""
    found = {place.neighbours: place for place in analyse(resolve(spec), (4,)).boundary}
    assert found[3].in_order
    regular = 1 / 3 if spec == "ternary" else 1 / 2
    assert min(abs(modulus - regular) for modulus in found[3].moduli[:2]) < 1e-9


@pytest.mark.slow
def test_sqrt3_has_the_ternary_curves_eigenvalue():
    for name in ("sqrt3", "interp-sqrt3"):
        for place in analyse(resolve(name), (5,)).boundary:
            assert min(abs(value - 1 / 3) for value in place.moduli) < 1e-9


def test_refusals():
    with pytest.raises(SchemeError, match="2 or more"):
        analyse_boundary(stencil_meshes(resolve("loop")), 1, 2, 2, 1)
    with pytest.raises(SchemeError, match="no boundary vertices"):
        analyse_boundary(stencil_meshes(resolve("four-point")), 1, 2, 2, 3)
    assert analyse(resolve("loop"), ()).boundary == ()
