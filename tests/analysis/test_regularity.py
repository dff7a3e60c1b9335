"""Smoothness and polynomial degrees on regular meshes, against closed forms and tabulated exponents."""

from itertools import product
from math import comb, log2, sqrt

import numpy as np
import pytest

from meshfit.analysis.regular_lattice import RegularMask, regular_mask, sum_rule_order
from meshfit.analysis.regularity import continuity, holder_bound, regularity_of
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.subdivision.registry import resolve
from tests.analysis.cases import analysed, by_scheme
from tests.laws.test_subdivision_polynomials import DEGREE
from tests.laws.variants import VARIANTS
from tests.loops import over

# Sobolev exponent and order of the sum rules, found by others than this code.
EXPONENTS = {
    "midpoint": (1.5, 2),
    "loop": (3.5, 4),
    "loop:weights=warren": (3.5, 4),
    "interp-loop:alpha=0": (3.5, 4),
    "interp-loop:alpha=0.25": (3.166, 4),
    "interp-loop:alpha=0.5": (2.885, 4),
    "interp-loop:alpha=0.75": (2.647, 4),
    "interp-loop:alpha=0.9": (2.520, 4),
    "interp-loop": (2.4408, 4),
    "interp-loop:valence3=zorin": (2.4408, 4),
    "butterfly": (2.4408, 4),
    "butterfly:tension=0": (1.5, 2),
    "modified-butterfly": (2.4408, 4),
}
# Kobbelt 2000 shows √3 to be C2 and Labsik and Greiner 2000 theirs to be C1; Loop's is a box spline of C2.
CONTINUITY = {"midpoint": 0, "loop": 2, "butterfly": 1, "interp-loop": 1, "sqrt3": 2, "interp-sqrt3": 1}
STENCILS = {"midpoint": (1, 2), "loop": (4, 7), "interp-loop": (1, 10), "butterfly": (1, 8), "sqrt3": (3, 7)}
RADII = {"midpoint": 1, "loop": 2, "interp-loop": 3, "butterfly": 3, "modified-butterfly": 3}


def line(weights, dilation=2) -> RegularMask:
    """A mask on a line."""
    return RegularMask(np.arange(len(weights), dtype=float)[:, None], np.array(weights, dtype=float), dilation, 1)


def bspline(degree: int, dilation: int = 2) -> list[float]:
    """Of (1 + z + … + z^(m-1))^(degree + 1) / m^degree."""
    weights = np.ones(1)
    for _ in range(degree + 1):
        weights = np.convolve(weights, np.ones(dilation))
    return list(weights / dilation**degree)


def squared(weights, dilation=2) -> RegularMask:
    """The tensor product of a mask with itself."""
    pairs = list(product(range(len(weights)), repeat=2))
    return RegularMask(np.array(pairs, dtype=float), np.array([weights[i] * weights[j] for i, j in pairs]), dilation, 1)


def exponents(mask: RegularMask) -> tuple[int, float, float, int]:
    order = sum_rule_order(mask)
    found = regularity_of(mask)
    assert (found.stable, found.accuracy) == (True, order)
    bound = holder_bound(mask, order)
    return order, found.s2, bound, continuity(mask, order, found, bound)


@over("degree", range(6))
@over("dilation", [2, 3])
@pytest.mark.parametrize("make", [line, squared])
def test_bsplines(degree, dilation, make):
    order, s2, bound, smooth = exponents(make(bspline(degree, dilation), dilation))
    assert order == degree + 1
    assert s2 == pytest.approx(degree + 1 / 2, abs=1e-6)
    assert bound == pytest.approx(degree, abs=1e-4)
    assert smooth == degree - 1


def box_spline(*directions: tuple[int, int]) -> RegularMask:
    """Of the product of (1 + z^d) / 2 over some directions d, times 4."""
    weights = {(0, 0): 4.0}
    for i, j in directions:
        finer: dict[tuple[int, int], float] = {}
        for (k, m), weight in weights.items():
            for place in ((k, m), (k + i, m + j)):
                finer[place] = finer.get(place, 0.0) + weight / 2
        weights = finer
    return RegularMask(np.array(list(weights), dtype=float), np.array(list(weights.values())), 2, 1)


@over("times", [1, 2])
def test_box_splines_of_three_directions(times):
    """Each direction k times is a function of C^(2k - 2) and of exponent 2k - 1/2."""
    order, s2, bound, smooth = exponents(box_spline(*[(1, 0), (0, 1), (1, 1)] * times))
    assert order == 2 * times
    assert s2 == pytest.approx(2 * times - 1 / 2, abs=1e-6)
    assert bound == pytest.approx(2 * times - 1, abs=1e-4)
    assert smooth == 2 * times - 2


@pytest.mark.parametrize(
    ("axes", "diagonals", "accuracy"),
    [(1, 1, 3), (2, 1, 4), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((2, 2, 6), (1, 2, 4)))],
)
def test_box_splines_whose_shifts_are_unstable(axes, diagonals, accuracy):
    """Of four directions: removing all but one direction takes `accuracy` of them at least.

    They are C^(accuracy - 2) and have the exponent accuracy - 1/2 (de Boor, Höllig and Riemenschneider 1993, Box
    splines), though the sum rules of their masks may be of a lower order, since Σ (-1)^(i + j) of their shifts is zero.
    """
    mask = box_spline(*[(1, 0), (0, 1)] * axes, *[(1, 1), (1, -1)] * diagonals)
    found = regularity_of(mask)
    assert (found.stable, found.accuracy) == (False, accuracy)
    assert found.s2 == pytest.approx(accuracy - 1 / 2, abs=1e-6)
    assert sum_rule_order(mask) <= accuracy
    assert continuity(mask, sum_rule_order(mask), found, float(accuracy)) == accuracy - 2


def test_four_point_scheme_and_its_binary_relatives():
    """Deslauriers and Dubuc 1989: 2 is the Hölder exponent of four points, which is not reached."""
    order, s2, bound, smooth = exponents(line(np.array([-1, 0, 9, 16, 9, 0, -1]) / 16))
    assert (order, smooth) == (4, 1)
    assert s2 == pytest.approx(2.4408, abs=1e-4)
    assert bound == pytest.approx(2, abs=1e-6)
    six = np.zeros(11)
    six[[0, 2, 4, 5, 6, 8, 10]] = np.array([3, -25, 150, 256, 150, -25, 3]) / 256
    order, s2, _, smooth = exponents(line(six))
    assert (order, smooth) == (6, 2)
    assert s2 == pytest.approx(3.1751, abs=1e-4)


def test_daubechies_functions_whose_hoelder_exponents_are_known():
    """Daubechies and Lagarias 1992: 2 - log2(1 + √3) for four coefficients, 1.0878 for six, which makes it C1."""
    four = np.array([1 + sqrt(3), 3 + sqrt(3), 3 - sqrt(3), 1 - sqrt(3)]) / 4
    order, s2, bound, smooth = exponents(line(four))
    assert (order, smooth) == (2, 0)
    assert s2 == pytest.approx(1, abs=1e-6)
    assert bound == pytest.approx(2 - log2(1 + sqrt(3)), abs=1e-6)
    r, t = sqrt(10), sqrt(5 + 2 * sqrt(10))
    six = np.array([1 + r + t, 5 + r + 3 * t, 10 - 2 * r + 2 * t, 10 - 2 * r - 2 * t, 5 + r - 3 * t, 1 + r - t]) / 16
    order, s2, bound, smooth = exponents(line(six))
    assert order == 3
    assert s2 == pytest.approx(1.4150, abs=1e-4)
    assert bound == pytest.approx(1.0878, abs=1e-4)
    assert smooth == 1  # which the Sobolev exponent, less a half, would not show


@by_scheme(EXPONENTS)
def test_exponents_of_the_schemes(spec):
    found = analysed(spec, ())
    exponent, order = EXPONENTS[spec]
    assert found.s2 == pytest.approx(exponent, abs=6e-4)
    assert found.generated == order - 1


@pytest.mark.slow
def test_butterfly_and_its_interpolatory_rival_have_the_four_point_schemes_exponent():
    found = [analysed(spec, ()).s2 for spec in ("butterfly", "interp-loop")]
    four = line(np.array([-1, 0, 9, 16, 9, 0, -1]) / 16)
    np.testing.assert_allclose(found, regularity_of(four).s2, rtol=0, atol=1e-8)


@by_scheme(CONTINUITY)
def test_continuity_on_regular_meshes(spec):
    found = analysed(spec, ())
    assert found.continuity == CONTINUITY[spec]
    assert found.continuity < found.holder_bound + 1e-6


@by_scheme(DEGREE)
def test_polynomials_reproduced(spec):
    found = analysed(spec, ())
    assert found.reproduced == DEGREE[spec]
    assert found.generated >= found.reproduced


@over("spec", VARIANTS)
def test_masks_of_the_lattice(spec):
    """All weights sum to the number of fine verts to a coarse one, and so do those of each of them to one."""
    mask = regular_mask(stencil_meshes(resolve(spec)))
    assert (mask.dilation, mask.steps) == ((3, 2) if "sqrt3" in spec else (2, 1))
    assert mask.weights.sum() == pytest.approx(mask.dilation**2, abs=1e-12)
    assert np.array_equal(mask.offsets, mask.whole_offsets)
    cosets = {}
    for offset, weight in zip(mask.whole_offsets, mask.weights, strict=True):
        key = tuple(offset % mask.dilation)
        cosets[key] = cosets.get(key, 0) + weight
    np.testing.assert_allclose(list(cosets.values()), 1, rtol=0, atol=1e-12)
    assert len(cosets) == mask.dilation**2


def test_loops_mask_is_that_of_its_box_spline():
    """(1 + x)²(1 + y)²(1 + x/y)² / 16, written out."""
    mask = regular_mask(stencil_meshes(resolve("loop")))
    wanted = {}
    for i, j, k in product(range(3), repeat=3):
        place = (i + k - 2, j - k)
        wanted[place] = wanted.get(place, 0) + comb(2, i) * comb(2, j) * comb(2, k) / 16
    assert {tuple(offset): weight for offset, weight in zip(mask.whole_offsets, mask.weights, strict=True)} == wanted


@by_scheme(STENCILS)
def test_stencils(spec):
    assert analysed(spec, ()).support.stencils == STENCILS[spec]


@by_scheme(RADII)
def test_support_is_where_the_basis_function_is_not_zero(spec):
    """Its hull, by refining one vertex's data four times: no farther than the radius, and nearly that far."""
    bench = stencil_meshes(resolve(spec))
    radius = analysed(spec, ()).support.radius
    assert radius == RADII[spec]
    patch = bench.patch(7)
    finer = patch.refine(4)
    values = finer.carry((patch.places == 0).all(axis=1) * 1.0)
    reached = bench.distance(finer.carry(patch.places))[np.abs(values) > 1e-14].max()
    assert radius - radius / 15 <= reached <= radius
