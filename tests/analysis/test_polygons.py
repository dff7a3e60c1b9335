"""Analyses of schemes on polygons, against closed forms and tabulated eigenvalues."""

from math import cos, pi, sqrt

import numpy as np
import pytest

from meshfit.analysis.analyse import VALENCES, analyse, verdict
from meshfit.analysis.local_matrix import map_wheel
from meshfit.analysis.regular_lattice import regular_mask
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.subdivision.registry import SCHEMES, resolve
from tests.analysis.cases import analysed, by_scheme
from tests.loops import over

NAMES = [name for name, entry in SCHEMES.items() if entry.domain == "polygons"]
# Exponent, degrees reproduced and generated, and continuity: of tensor products of splines and of the four-point
# scheme, and of the box spline of four directions, each taken twice, which √2 has in regular meshes.
REGULAR = {
    "catmull-clark": (3.5, 1, 3, 2),
    "doo-sabin": (2.5, 1, 2, 1),
    "kobbelt": (2.4408, 3, 3, 1),
    "ternary": (3.5, 1, 3, 2),
    "interp-ternary": (2.2106, 3, 3, 1),
    "sqrt2": (5.5, 1, 5, 4),
    "interp-catmull-clark:alpha=0": (3.5, 1, 3, 2),
    "interp-sqrt2:alpha=0": (5.5, 1, 5, 4),
}
LEADING = {
    "kobbelt": {3: (0.426, 0.25), 5: (0.538, 0.362), 6: (0.560, 0.426), 8: (0.582, 0.5), 12: (0.599, 0.560)},
    "sqrt2": {3: (0.408, 0.25), 4: (0.5, 0.25), 5: (0.551, 0.338), 8: (0.614, 0.5)},
    "interp-sqrt2": {3: (0.416, 0.364), 4: (0.5, 0.364), 5: (0.545, 0.364), 8: (0.597, 0.5)},
}


@by_scheme(REGULAR)
def test_regular_meshes(spec):
    found = analyse(resolve(spec), ())
    s2, reproduced, generated, continuity = REGULAR[spec]
    assert found.s2 == pytest.approx(s2, abs=6e-4)
    assert (found.reproduced, found.generated, found.continuity) == (reproduced, generated, continuity)
    assert found.stable == ("sqrt2" not in spec)
    assert found.domain == "polygons"


def test_catmull_clark_in_closed_form():
    places = analysed("catmull-clark").extraordinary
    assert tuple(place.valence for place in places) == VALENCES
    for place in places:
        n, c = place.valence, cos(2 * pi / place.valence)
        expected = (5 + c + cos(pi / n) * sqrt(2 * (9 + c))) / 16
        assert place.spectrum.leading.value == pytest.approx(expected, abs=1e-12)
        assert (place.fault, place.regular_map, place.spectrum.multiplicity) == ("", True, 2)


@pytest.mark.slow
def test_doo_sabin_in_closed_form():
    """Made for the eigenvalues 1, 1/2, 1/2, 1/4 at faces of any number of corners."""
    found = analyse(resolve("doo-sabin"))
    assert (found.irregular, found.support.radius, found.support.stencils) == ("face", 1.5, (4, 4))
    for place in found.extraordinary:
        assert place.spectrum.leading.value == pytest.approx(1 / 2, abs=1e-9)
        assert place.spectrum.rest.modulus == pytest.approx(1 / 4, abs=1e-6)
        assert (place.fault, place.spectrum.curvature) == ("", "bounded")
    assert verdict(found) == "C1 on regular meshes (s2 = 2.500); C1 at faces of 3 to 12 corners"


@by_scheme(LEADING)
def test_leading_eigenvalues_are_those_of_the_tables(spec):
    for place in analyse(resolve(spec), tuple(LEADING[spec])).extraordinary:
        found = place.spectrum.leading.modulus, place.spectrum.rest.modulus
        np.testing.assert_allclose(found, LEADING[spec][place.valence], rtol=0, atol=6e-4)
        assert (place.fault, place.regular_map) == ("", True)


def test_masks_are_tensor_products():
    for spec, line in (("catmull-clark", [1, 4, 6, 4, 1]), ("doo-sabin", [1, 3, 3, 1])):
        mask = regular_mask(stencil_meshes(resolve(spec)))
        middle = (len(line) - 1) / 2
        found = {tuple(offset): weight for offset, weight in zip(mask.offsets, mask.weights, strict=True)}
        scale = sum(line) / 2
        wanted = {(i - middle, j - middle): a * b / scale**2 for i, a in enumerate(line) for j, b in enumerate(line)}
        assert found.keys() == wanted.keys()
        np.testing.assert_allclose([found[key] for key in wanted], list(wanted.values()), rtol=0, atol=1e-15)


@over("name", NAMES)
def test_dilations(name):
    mask = regular_mask(stencil_meshes(resolve(name)))
    expected = {"sqrt2": (2, 2), "interp-sqrt2": (2, 2), "ternary": (3, 1), "interp-ternary": (3, 1)}
    assert (mask.dilation, mask.steps) == expected.get(name, (2, 1))
    assert mask.weights.sum() == pytest.approx(mask.dilation**2, abs=1e-12)


@pytest.mark.slow
@over("name", ["ternary", "interp-ternary"])
def test_valences_without_a_rule_are_told(name):
    found = analyse(resolve(name))
    assert [place.valence for place in found.extraordinary] == [4]
    assert found.unsupported == (3, *range(5, 13))
    assert verdict(found).endswith("); no rule at valences 3 and 5 to 12")


@over("spec, steps", [("catmull-clark", 1), ("doo-sabin", 1), ("sqrt2", 2), ("kobbelt", 1)])
@over("n", [3, 4, 7])
def test_rings_are_matched_where_they_lie(spec, steps, n):
    """Linear interpolation shrinks a wheel towards its centre, so that the directions of the first row stay."""
    wheel = stencil_meshes(resolve(spec)).wheel(n, 6)
    fine = wheel.refine(steps).topology
    matched = map_wheel(wheel, fine, wheel.locate(steps), 2)[wheel.within(2)]
    assert len(set(matched.tolist())) == len(matched)
    there, here = wheel.locate(steps)[matched], wheel.places[wheel.within(2)]
    first = np.isin(wheel.within(2), wheel.turns[0])
    np.testing.assert_allclose(np.angle(there[first] / here[first]), 0, atol=1e-12)


def test_every_valence_of_a_wheel_is_what_it_says():
    for spec, hub in (("catmull-clark", True), ("doo-sabin", False)):
        wheel = stencil_meshes(resolve(spec)).wheel(5, 3)
        topology = wheel.topology
        inner = ~topology.boundary_verts
        assert wheel.hub == hub
        if hub:
            assert topology.valence[0] == 5
            assert set(topology.valence[inner][1:].tolist()) == {4}
            assert set(topology.sizes.tolist()) == {4}
        else:
            assert set(topology.valence[inner].tolist()) == {4}
            assert sorted(set(topology.sizes.tolist())) == [4, 5]
        assert not np.any(topology.faces_per_edge > 2)


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.25, 0.5, 1.0])
def test_blends_are_smooth_at_all_valences(alpha):
    for name in ("interp-catmull-clark", "interp-sqrt2"):
        found = analyse(resolve(f"{name}:alpha={alpha}"), (3, 5, 8))
        assert (found.failing, found.alphas) == ((), {})
        assert found.continuity >= 1
