"""Deliberately broken schemes: the analysis must find what is wrong with each."""

from fractions import Fraction

import numpy as np
import pytest

from meshfit.analysis.analyse import analyse, verdict, warnings_of
from meshfit.analysis.extraordinary_vertex import characteristic_net, corner_turns, wheels
from meshfit.analysis.local_matrix import PAD, invariant_matrix
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.errors import SchemeError
from meshfit.subdivision.masks import CurveMask
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.scheme import EdgeMask, Split, SpokeMask, TriangleScheme, VertMask
from tests.analysis.cases import by_scheme
from tests.loops import over

BUTTERFLY = resolve("butterfly")
HALF = Fraction(1, 2)
LINEAR = CurveMask({0: Fraction(1)}, ({0: HALF, 1: HALF},))


def with_ring_eigenvalues(*by_mode: float, turned: float = 0.0) -> TriangleScheme:
    """The butterfly, but the one-ring of an extraordinary vertex has one eigenvalue for each Fourier mode from 0.

    Modes beyond those given have 0. The first ring turns by the angle `turned` at each step.
    """

    def weights(n: int) -> tuple[float, ...]:
        ring = np.zeros(n)
        for mode, value in enumerate(by_mode[: n // 2 + 1]):
            double = 1 if mode == 0 or 2 * mode == n else 2
            ring += double * value * np.cos(2 * np.pi * mode * np.arange(n) / n + (mode == 1) * turned) / n
        return (1 - float(ring.sum()), *ring.tolist())

    return TriangleScheme(BUTTERFLY.split, BUTTERFLY.inserted, BUTTERFLY.boundary, spokes=SpokeMask(weights))


def test_the_construction_gives_what_it_says():
    for place in analyse(with_ring_eigenvalues(0.25, 0.5, 0.3), (5, 7, 8)).extraordinary:
        assert place.spectrum.leading.value == pytest.approx(0.5, abs=1e-12)
        assert place.spectrum.rest.modulus == pytest.approx(0.3, abs=1e-9)
        assert place.spectrum.rest.mode == 2
        assert place.fault == ""


def test_leading_eigenvalue_of_another_mode():
    found = analyse(with_ring_eigenvalues(0.25, 0.3, 0.6), (5, 6, 7, 8))
    assert found.failing == (5, 7, 8)
    assert {place.spectrum.rest.mode for place in found.extraordinary if place.valence != 6} == {2}
    assert verdict(found) == "C1 on regular meshes (s2 = 2.441); C1 fails at valences 5 and 7 to 8"
    message = list(warnings_of(found))
    assert message[0] == "C1 fails at valence 5: |λ| = 0.6000 of mode 2 exceeds 0.3000 of mode 1"


def test_leading_eigenvalue_of_mode_0():
    found = analyse(with_ring_eigenvalues(0.7, 0.5), (4, 5))
    assert found.failing == (4, 5)
    assert all("0.7000 of mode 0 exceeds 0.5000 of mode 1" in place.fault for place in found.extraordinary)


@over("value", [-0.5, 1.2])
@over("n", [4, 5])
def test_leading_eigenvalue_that_is_not_between_0_and_1(value, n):
    (place,) = analyse(with_ring_eigenvalues(0.25, value), (n,)).extraordinary
    assert place.fault == f"the largest eigenvalue of mode 1 is {value:.4f}, not between 0 and 1"


def test_rings_that_turn_have_a_complex_leading_eigenvalue():
    (place,) = analyse(with_ring_eigenvalues(0.25, 0.5, turned=0.5), (7,)).extraordinary
    assert "±" in place.fault
    assert place.spectrum.leading.modulus == pytest.approx(0.5)


@over("valence, folds", [(5, False), (9, True)])
def test_characteristic_map_that_folds(valence, folds):
    """λ1 = 0.13 leads, but so little of the regular rules' 1/8 that the second ring is turned over.

    Its verts beside the spokes lie in direction (1/2 - 1/(16 λ)) (a + b) - (c + d) / 16, where a, b are the neighbours
    in the first ring and c, d those beyond, which is inwards where there are many.
    """
    found = analyse(with_ring_eigenvalues(0.05, 0.13), (valence,))
    (place,) = found.extraordinary
    assert place.spectrum.fault == ""
    assert place.regular_map != folds
    assert found.failing == ((valence,) if folds else ())
    if folds:
        assert list(warnings_of(found)) == [f"C1 fails at valence {valence}: the characteristic map folds"]


@by_scheme(["loop", "interp-loop", "modified-butterfly", "sqrt3", "interp-sqrt3"])
@over("n", [4, 7])
def test_all_of_the_map_around_the_centre_is_looked_at(spec, n):
    """Every corner of a refined face in the first ring is finite; the net is an eigenvector, which turns once."""
    scheme = resolve(spec)
    steps, dilation = (2, 3) if "sqrt3" in spec else (1, 2)
    found = analyse(scheme, (n,))
    wheel_of = wheels(stencil_meshes(scheme), n)
    matrix = invariant_matrix(wheel_of, steps, found.extraordinary[0].rings + 1)
    wheel = wheel_of(matrix.rings + PAD)
    net = characteristic_net(matrix, wheel)
    np.testing.assert_allclose(net[wheel.turns[0]], np.exp(2j * np.pi * np.arange(n) / n), rtol=0, atol=1e-12)
    finer = wheel.refine(2 * steps)
    reached = {0}
    halfedges = finer.topology
    for _ in range(dilation**2):
        near = np.isin(halfedges.tail, list(reached))
        reached = set(halfedges.head[near].tolist()) | reached
    turns = corner_turns(halfedges, finer.carry(net))
    inside = np.isin(halfedges.tail, list(reached)) & np.isin(halfedges.head, list(reached))
    inside &= inside[halfedges.following(np.arange(len(inside)))]
    assert inside.sum() >= 3 * n * dilation**4
    assert (turns[inside] > 0).all()


def test_a_scheme_that_does_not_converge():
    """Old verts get -1 of themselves: rows sum to one, but the limit is nowhere continuous."""
    wild = TriangleScheme(Split.QUADRISECT, EdgeMask(HALF), LINEAR, vert=VertMask(lambda n: 2.0))
    found = analyse(wild, (5,))
    assert found.continuity == -1
    assert found.failing == (5,)
    assert verdict(found).startswith("continuity is not shown on regular meshes")


def test_linear_interpolation_is_c0_and_not_c1():
    found = analyse(resolve("midpoint"), (5,))
    assert verdict(found) == "C0 on regular meshes (s2 = 1.500), not C1"
    assert list(warnings_of(found)) == []


@pytest.mark.slow
def test_eigenvalues_that_decide_need_not_be_near_one():
    """What a vertex mask takes from the ring moves an eigenvalue of mode 0, below 0 too, and none of mode 1."""
    for ring in (0.01, 0.3, 0.99):
        loop = resolve("loop")
        scheme = TriangleScheme(loop.split, loop.inserted, loop.boundary, vert=VertMask(lambda n, ring=ring: ring))
        (place,) = analyse(scheme, (5,)).extraordinary
        radial = max(abs(5 / 8 - ring), 0)
        assert place.spectrum.leading.value == pytest.approx(3 / 8 + np.cos(2 * np.pi / 5) / 4)
        if radial > 0.3:
            assert place.spectrum.rest.modulus == pytest.approx(radial)
            assert place.spectrum.rest.mode == 0


def test_stencils_too_wide_for_any_ring_are_refused(monkeypatch):
    monkeypatch.setattr("meshfit.analysis.local_matrix.MOST_RINGS", 1)
    with pytest.raises(SchemeError, match="1 rings around a vertex depend on further"):
        analyse(BUTTERFLY, (5,))
