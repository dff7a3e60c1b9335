"""The spectra of an analysis, against tabulated values, closed forms and the tests' own local matrices."""

from math import cos, pi

import numpy as np
import pytest

from meshfit.analysis.analyse import analyse
from meshfit.analysis.extraordinary_vertex import wheels
from meshfit.analysis.local_matrix import PAD, invariant_matrix, local_matrix
from meshfit.analysis.spectrum import spectrum_of
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.errors import SchemeError
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.scheme import TriangleScheme
from tests.analysis.cases import analysed, by_scheme
from tests.laws import local_matrix as own
from tests.laws.test_subdivision_spectra import TABLES, VALENCES, mode_block, moduli
from tests.laws.variants import VARIANTS
from tests.loops import over

SQRT3 = resolve("sqrt3")


def unified_sqrt3(alpha: float) -> TriangleScheme:
    """Lin and Luo 2007, as derived from its abstract."""
    return TriangleScheme(SQRT3.split, SQRT3.inserted, SQRT3.boundary, SQRT3.vert, alpha=alpha)


def places_of(scheme, valences):
    found = analysed(scheme, tuple(valences)) if isinstance(scheme, str) else analyse(scheme, valences)
    return {place.valence: place for place in found.extraordinary}


@pytest.mark.slow
@pytest.mark.parametrize("spec", TABLES)
def test_leading_eigenvalues_are_those_of_the_tables(spec):
    places = places_of(spec, tuple(TABLES[spec]))
    for n, (leading, rest) in TABLES[spec].items():
        found = places[n].spectrum
        np.testing.assert_allclose((found.leading.modulus, found.rest.modulus), (leading, rest), rtol=0, atol=6e-4)
        assert (found.leading.mode, found.multiplicity) == (1, 2)
        assert places[n].fault == ""
        assert places[n].regular_map


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "failing"),
    [
        ("loop", ()),
        ("loop:weights=warren", ()),
        ("interp-loop", (3,)),
        ("interp-loop:alpha=0.9", (3,)),
        ("interp-loop:alpha=0.75", ()),
        ("interp-loop:weights=warren", (3,)),
        ("interp-loop:valence3=zorin", ()),
        ("butterfly", (3, 8, 9, 10, 11, 12)),
        ("modified-butterfly", ()),
        ("sqrt3", ()),
        ("interp-sqrt3", ()),
        ("midpoint", tuple(VALENCES)),
    ],
)
def test_valences_at_which_c1_fails(spec, failing):
    assert analyse(resolve(spec)).failing == failing


FAILING = {
    "interp-loop": {3: (0.25, 0.2664, 0)},
    "interp-loop:alpha=0.9": {3: (0.25, 0.254, 0)},
    "butterfly": {
        3: (0.25, 0.25, 0),
        8: (0.4624, 0.4690, 2),
        9: (0.4444, 0.4973, 2),
        12: (0.4030, 0.5, 2),
    },
}


@by_scheme(FAILING)
def test_what_overtakes_where_c1_fails(spec):
    places = places_of(spec, tuple(FAILING[spec]))
    for n, (leading, rest, mode) in FAILING[spec].items():
        found = places[n].spectrum
        np.testing.assert_allclose((found.leading.modulus, found.rest.modulus), (leading, rest), rtol=0, atol=6e-4)
        assert found.rest.mode == mode
        assert f"of mode {mode}" in found.fault


@pytest.mark.slow
def test_unified_sqrt3():
    """Two steps of α = 1: only valence 3 fails, from a threshold below α = 1 on."""
    table = {3: (0.111, 0.133), 4: (0.240, 0.133), 5: (0.301, 0.134), 6: (0.333, 0.160), 7: (0.352, 0.192)}
    table |= {8: (0.363, 0.240), 12: (0.383, 0.333)}
    found = analyse(unified_sqrt3(1.0))
    for place in found.extraordinary:
        if place.valence in table:
            spectrum = place.spectrum
            moduli_found = spectrum.leading.modulus, spectrum.rest.modulus
            np.testing.assert_allclose(moduli_found, table[place.valence], rtol=0, atol=6e-4)
    assert (found.failing, found.reproduced) == ((3,), 2)
    assert 0.5 < found.alphas[3] < 1
    half = analyse(unified_sqrt3(0.5))
    assert (half.failing, half.alphas) == ((), {})
    assert half.extraordinary[0].spectrum.rest.modulus == pytest.approx(0.078, abs=6e-4)


def test_alpha_up_to_which_valence_3_is_smooth():
    """At it the complex pair of mode 0 is as large as 1/4; just below it all is well, and just above it is not."""
    found = analyse(resolve("interp-loop"), (3, 4))
    assert set(found.alphas) == {3}
    assert found.alphas[3] == pytest.approx(0.86364, abs=1e-5)
    for beside, smooth in ((-1e-3, True), (1e-3, False)):
        alpha = found.alphas[3] + beside
        assert (places_of(f"interp-loop:alpha={alpha}", (3,))[3].fault == "") == smooth
    assert analyse(resolve("butterfly"), (3,)).alphas == {}


@pytest.mark.slow
@over("n", VALENCES)
def test_closed_forms(n):
    assert places_of("loop", VALENCES)[n].spectrum.leading.value == pytest.approx(
        3 / 8 + cos(2 * pi / n) / 4, abs=1e-12
    )
    for spec in ("sqrt3", "interp-sqrt3"):
        leading = places_of(spec, VALENCES)[n].spectrum.leading.value
        assert leading == pytest.approx((2 + 2 * cos(2 * pi / n)) / 9, abs=1e-10)
    matrix = invariant_matrix(wheels(stencil_meshes(resolve("interp-loop")), n), 1, 2)
    g = 5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2
    radial = np.polymul([1, -1], np.array([256, 128 * g - 192, 24, -1]) / 256)
    np.testing.assert_allclose(np.poly(matrix.block(0)), radial, rtol=0, atol=1e-12)


@by_scheme(VARIANTS)
@over("n", [3, 5, 6, 8])
def test_blocks_are_those_of_the_tests_own_local_matrix(spec, n):
    """Their rings are found by walking straight and turning, these by walking both meshes side by side."""
    rings = 2 if "sqrt3" not in spec or spec == "sqrt3" else 3
    scheme = resolve(spec)
    steps = 2 if "sqrt3" in spec else 1
    matrix = local_matrix(stencil_meshes(scheme).wheel(n, rings + PAD), steps, rings)
    theirs = own.local_matrix(n, scheme, rings)
    for mode in range(n):
        block = mode_block(theirs, n, mode, rings)
        np.testing.assert_allclose(matrix.block(mode), block, rtol=0, atol=1e-13)


def test_too_few_rings_are_told_from_enough():
    wheel_of = wheels(stencil_meshes(resolve("butterfly")), 5)
    assert local_matrix(wheel_of(1 + PAD), 1, 1) is None
    assert invariant_matrix(wheel_of, 1, 1).rings == 2


@by_scheme(["interp-loop", "butterfly", "interp-sqrt3"])
def test_more_rings_add_no_larger_eigenvalue(spec):
    bench, steps = stencil_meshes(resolve(spec)), 2 if "sqrt3" in spec else 1
    for n in (3, 5, 9):
        few = spectrum_of(invariant_matrix(wheels(bench, n), steps, 3))
        many = spectrum_of(invariant_matrix(wheels(bench, n), steps, 5))
        assert many.leading.value == pytest.approx(few.leading.value, abs=1e-9)
        assert many.rest.modulus == pytest.approx(few.rest.modulus, abs=1e-5)


def test_all_eigenvalues_are_those_of_the_whole_matrix():
    for n in (3, 4, 7):
        whole = own.local_matrix(n, "loop", 3)
        matrix = local_matrix(stencil_meshes(resolve("loop")).wheel(n, 3 + PAD), 1, 3)
        found = np.concatenate([np.linalg.eigvals(matrix.block(mode)) for mode in range(n)])
        np.testing.assert_allclose(np.sort(np.abs(found))[::-1], moduli(whole), rtol=0, atol=1e-7)


@pytest.mark.slow
def test_curvature():
    """Loop's: regular meshes are C2, so bounded and not flat; from valence 7 on λ of mode 2 is larger than λ1²."""
    loop = places_of("loop", VALENCES)
    assert [loop[n].spectrum.curvature for n in VALENCES] == ["unbounded", *["bounded"] * 3, *["unbounded"] * 6]
    modified = places_of("modified-butterfly", VALENCES)
    assert {place.spectrum.curvature for place in modified.values()} == {"bounded"}
    assert places_of("butterfly", (5,))[5].spectrum.curvature == "flat"


@pytest.mark.parametrize(
    "alpha", ["1e-200", *(pytest.param(alpha, marks=pytest.mark.slow) for alpha in ("1e-300", "1e-9"))]
)
def test_weights_that_are_next_to_nothing_change_nothing(alpha):
    found, loop = (analysed(spec, (3, 5, 8)) for spec in (f"interp-loop:alpha={alpha}", "loop"))
    assert (found.failing, found.continuity) == ((), 2)
    for place, other in zip(found.extraordinary, loop.extraordinary, strict=True):
        assert place.spectrum.leading.value == pytest.approx(other.spectrum.leading.value, abs=1e-8)


def test_refusals():
    for valence in (-1, 0, 1, 2):
        with pytest.raises(SchemeError, match="3 or more"):
            analyse(resolve("loop"), (valence,))
    with pytest.raises(SchemeError, match="one alpha"):
        analyse(resolve("interp-loop").with_alpha(np.linspace(0, 1, 9)))
