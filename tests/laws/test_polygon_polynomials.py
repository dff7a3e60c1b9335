"""Polynomials reproduced by polygon schemes on regular quads, and their results on flat meshes."""

import numpy as np
import pytest

from meshfit.mesh.geometry import area_vectors
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.refine import subdivide
from tests.laws.polygon_variants import ANYWHERE, by_variant, refined
from tests.loops import over
from tests.quads import quad_patch, quad_wheel

# The highest degree that a level of the scheme reproduces, wherever the boundary is out of reach.
DEGREES = {
    "catmull-clark": 1,
    "interp-catmull-clark": 3,
    "interp-catmull-clark:alpha=0.5": 1,
    "doo-sabin": 1,
    "kobbelt": 3,
    "sqrt2": 1,
    "interp-sqrt2": 3,
    "interp-sqrt2:alpha=0.5": 1,
    "ternary": 1,
    "interp-ternary": 3,
}


def reproduced(spec, degree):
    """The largest error of a level on all monomials of a degree, at verts whose rows do not reach the boundary."""
    mesh = quad_patch(13, 12)
    refinement = refined(mesh, spec)
    x, y, _ = mesh.verts.T - 6
    fine_x, fine_y = refinement(x), refinement(y)
    reach = refinement.matrix.toarray() @ np.diag(PolygonTopology.of(mesh).boundary_verts * 1.0)
    inside = ~reach.any(axis=1) & (np.abs(fine_x) < 3.5) & (np.abs(fine_y) < 3)
    assert inside.sum() > 30
    errors = [
        np.abs(refinement(x**i * y ** (degree - i)) - fine_x**i * fine_y ** (degree - i))[inside].max()
        for i in range(degree + 1)
    ]
    return max(errors)


@pytest.mark.parametrize("spec", DEGREES)
def test_polynomials(spec):
    for degree in range(DEGREES[spec] + 1):
        assert reproduced(spec, degree) < 1e-11
    assert reproduced(spec, DEGREES[spec] + 1) > 1e-3


@by_variant
def test_the_lattice_stays_one(spec):
    """Inside, new verts of a level are where linear interpolation puts them; edges and faces shrink equally."""
    mesh = quad_patch(13, 12)
    fine = refined(mesh, spec, 2)(mesh.verts)
    inside = (np.abs(fine[:, 0] - 6) < 2.2) & (np.abs(fine[:, 1] - 6) < 2.2)
    name = spec.partition(":")[0]
    spacing = {"sqrt2": 2, "interp-sqrt2": 2, "ternary": 9, "interp-ternary": 9}.get(name, 4)
    shift = 1 / 8 if name == "doo-sabin" else 0  # the dual split puts verts between the lines
    scaled = (fine[inside, :2] - shift) * spacing
    assert inside.sum() > 50
    np.testing.assert_allclose(scaled, scaled.round(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("spec", ANYWHERE)
@over("n", [3, 4, 5, 7])
def test_flat_counter_clockwise_disks_stay_so(spec, n):
    for levels in (1, 2, 3):
        fine = subdivide(quad_wheel(n, 3), spec, levels)
        areas = area_vectors(fine.triangulated())
        assert (areas[:, 2] > 0).all()
        np.testing.assert_allclose(areas[:, :2], 0, atol=1e-14)


@by_variant
def test_straight_sides_stay_straight(spec):
    """Linear-exactness up to the boundary: away from corners, lattice lines end there as equally spaced as inside."""
    mesh = quad_patch(17, 16)
    fine = refined(mesh, spec, 2)(mesh.verts)
    middle = np.abs(fine[:, 0] - 8) < 3
    side = middle & (np.abs(fine[:, 1]) < 1e-12)
    spacing = np.diff(np.sort(fine[side, 0]))
    assert len(spacing) > 8
    np.testing.assert_allclose(spacing, spacing[0], rtol=0, atol=1e-12)
    lines = np.unique(fine[middle, 0].round(9))
    np.testing.assert_allclose(np.diff(lines), np.diff(lines)[0], rtol=0, atol=1e-8)
