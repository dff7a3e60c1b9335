"""Analyses of schemes on curves, against closed forms."""

import pytest

from meshfit.analysis.analyse import analyse, verdict
from meshfit.analysis.regular_lattice import regular_mask
from meshfit.analysis.stencil_meshes import stencil_meshes
from meshfit.subdivision.registry import resolve
from tests.analysis.cases import analysed
from tests.loops import over

# Exponent in L2, degrees reproduced and generated, and continuity. Of four points with another tension than 1/16 only
# linear functions are left, whose sum rules are of order 2 (Dyn, Gregory and Levin 1987).
SCHEMES = {
    "cubic-bspline": (3.5, 1, 3, 2),
    "interp-bspline:alpha=0": (3.5, 1, 3, 2),
    "four-point": (2.4408, 3, 3, 1),
    "interp-bspline": (2.4408, 3, 3, 1),
    "ternary-bspline": (3.5, 1, 3, 2),
    "four-point:tension=0": (1.5, 1, 1, 0),
}


@over("spec", SCHEMES)
def test_what_is_known_of_curves(spec):
    found = analysed(spec)
    s2, reproduced, generated, continuity = SCHEMES[spec]
    assert found.s2 == pytest.approx(s2, abs=1e-4)
    assert (found.reproduced, found.generated, found.continuity) == (reproduced, generated, continuity)
    assert (found.domain, found.extraordinary, found.alphas) == ("curves", (), {})
    assert found.row_sums == pytest.approx((1, 1), abs=1e-15)


@pytest.mark.slow
@over("alpha", [0.0, 0.25, 0.5, 0.75, 0.9])
def test_blends_are_as_smooth_as_those_on_surfaces(alpha):
    """Along a line of the lattice interp-loop is this scheme; both are C2 below alpha = 1."""
    curve, surface = (
        analyse(resolve(f"{name}:alpha={alpha}"), valences=()) for name in ("interp-bspline", "interp-loop")
    )
    assert curve.s2 == pytest.approx(surface.s2, abs=1e-6)
    assert curve.continuity == surface.continuity == 2


@pytest.mark.parametrize("tension", [0.01, 0.1, *(pytest.param(t, marks=pytest.mark.slow) for t in (0.05, 0.15))])
def test_four_points_are_c1_for_tensions_below_0_1545(tension):
    """Dyn, Gregory and Levin 1987; the Sobolev exponent alone does not show it near the end."""
    found = analyse(resolve(f"four-point:tension={tension}"))
    assert found.continuity == 1
    assert verdict(found) == f"C1 (s2 = {found.s2:.3f})"


def test_masks_of_lines():
    mask = regular_mask(stencil_meshes(resolve("cubic-bspline")))
    assert (mask.dilation, mask.steps) == (2, 1)
    by_offset = dict(zip(mask.whole_offsets[:, 0].tolist(), mask.weights.tolist(), strict=True))
    assert by_offset == {-2: 1 / 8, -1: 1 / 2, 0: 3 / 4, 1: 1 / 2, 2: 1 / 8}
    ternary = regular_mask(stencil_meshes(resolve("ternary-four-point")))
    assert (ternary.dilation, ternary.steps, len(ternary.weights)) == (3, 1, 9)


@over("spec, radius", [("cubic-bspline", 2), ("four-point", 3), ("ternary-four-point", 2.5)])
def test_support(spec, radius):
    assert analysed(spec).support.radius == radius
