"""Exact weights along curves, inside and at ends, and their agreement with the boundaries of surfaces."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshfit.mesh.curves import Chains, Curves, join_segments
from meshfit.mesh.topology import Topology
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.masks import CUBIC_BSPLINE, TERNARY_BSPLINE, four_point
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.curve_shapes import SHAPES, arity, dense, rows_along
from tests.loops import over
from tests.shapes import OPEN

# Up to the common denominator, which is their sum: the old vertex at offsets -1, 0, 1, and each new one at -1, 0, 1, 2.
RULES = {
    "cubic-bspline": ((1, 6, 1), [(0, 1, 1, 0)]),
    "four-point": ((0, 1, 0), [(-1, 9, 9, -1)]),
    "four-point:tension=0": ((0, 1, 0), [(0, 1, 1, 0)]),
    "four-point:tension=0.03125": ((0, 1, 0), [(-1, 17, 17, -1)]),
    "four-point:tension=0.125": ((0, 1, 0), [(-1, 5, 5, -1)]),
    "interp-bspline": ((0, 1, 0), [(-1, 9, 9, -1)]),
    "interp-bspline:alpha=0": ((1, 6, 1), [(0, 1, 1, 0)]),
    "interp-bspline:alpha=0.5": ((1, 14, 1), [(-1, 17, 17, -1)]),
    "interp-bspline:alpha=0.25": ((3, 26, 3), [(-1, 33, 33, -1)]),
    "ternary-bspline": ((4, 19, 4), [(1, 16, 10, 0), (0, 10, 16, 1)]),
    "ternary-four-point": ((0, 1, 0), [(-5, 60, 30, -4), (-4, 30, 60, -5)]),
}
# Of the first segment of an open curve, at offsets 0, 1, 2 from its end.
END_RULES = {
    "cubic-bspline": [(1, 1, 0)],
    "four-point": [(7, 10, -1)],
    "interp-bspline:alpha=0.5": [(15, 18, -1)],
    "ternary-bspline": [(18, 9, 0), (10, 16, 1)],
    "ternary-four-point": [(50, 35, -4), (22, 64, -5)],
}
SIZE = 9


def fractions_of(row: np.ndarray) -> list[Fraction]:
    return [Fraction(float(value)).limit_denominator(20000) for value in row]


def exact(first: int, weights: tuple[int, ...], size: int = SIZE) -> list[Fraction]:
    row = [Fraction(0)] * size
    for k, weight in enumerate(weights):
        row[(first + k) % size] += Fraction(weight, sum(weights))
    return row


@pytest.mark.parametrize("spec", RULES)
def test_rules_inside(spec):
    old, new = RULES[spec]
    rows = [fractions_of(row) for row in rows_along(spec, SIZE)]
    expected = []
    for i in range(SIZE):
        expected += [exact(i - 1, old), *(exact(i - 1, weights) for weights in new)]
    assert rows == expected


@pytest.mark.parametrize("spec", END_RULES)
def test_rules_at_both_ends(spec):
    rows = [fractions_of(row) for row in rows_along(spec, SIZE, closed=False)]
    step = arity(spec)
    assert rows[0] == exact(0, (1,))
    assert rows[1:step] == [exact(0, weights) for weights in END_RULES[spec]]
    assert [row[::-1] for row in rows[::-1]] == rows


@pytest.mark.parametrize("spec", RULES)
def test_rules_on_the_shortest_curves(spec):
    """On a segment nothing bends; around two verts, each is before and after the other."""
    step = arity(spec)
    weights = np.linspace(1, 0, step + 1)
    np.testing.assert_allclose(
        rows_along(spec, 2, closed=False), np.stack([weights, 1 - weights], 1), rtol=0, atol=1e-15
    )
    old, new = RULES[spec]
    expected = [exact(i - 1, one, 2) for i in range(2) for one in (old, *new)]
    assert [fractions_of(row) for row in rows_along(spec, 2)] == expected


@over("shape", SHAPES)
@pytest.mark.parametrize(
    ("blend", "end"),
    [
        ("interp-bspline", "four-point"),
        ("interp-bspline:alpha=1", "four-point:tension=0.0625"),
        ("interp-bspline:alpha=0", "cubic-bspline"),
    ],
)
def test_the_blend_is_exactly_the_two_schemes_at_its_ends(shape, blend, end):
    curves = SHAPES[shape]()
    assert np.array_equal(dense(curves, blend, 4), dense(curves, end, 4))


@over("alpha", [0.1, 0.3, 0.5, 0.77])
def test_new_verts_of_the_blend_are_those_of_four_point_with_tension_of_a_sixteenth(alpha):
    for closed in (False, True):
        blend = rows_along(f"interp-bspline:alpha={alpha}", closed=closed)
        plain = rows_along(f"four-point:tension={alpha / 16}", closed=closed)
        np.testing.assert_allclose(blend[1::2], plain[1::2], rtol=0, atol=1e-15)


@over("shape", SHAPES)
def test_a_ternary_spline_pushed_back_is_the_ternary_four_point(shape):
    """New verts take two thirds of the nearer end's displacement, and one third of the other's."""
    curves = SHAPES[shape]()
    blend = CurveScheme(TERNARY_BSPLINE, alpha=1.0)
    found = refine(Chains.of(curves), blend, 3).matrix.toarray()
    np.testing.assert_allclose(found, dense(curves, "ternary-four-point", 3), rtol=0, atol=1e-14)


def test_an_alpha_for_each_vertex():
    """Where it is 1 the vertex stays, where it is 0 it moves as a B-spline's; new verts take the mean displacement."""
    curves = SHAPES["many"]()
    alphas = np.random.default_rng(5).random(curves.num_verts)
    alphas[:4], alphas[4:8] = 0, 1
    fine = subdivide(curves, "interp-bspline", alpha=alphas)
    smooth = subdivide(curves, "cubic-bspline").verts
    displacement = curves.verts - smooth[: curves.num_verts]
    expected = smooth[: curves.num_verts] + alphas[:, None] * displacement
    np.testing.assert_allclose(fine.verts[: curves.num_verts], expected, rtol=0, atol=1e-15)
    chains = Chains.of(curves)
    pushed = (alphas[:, None] * displacement)[np.stack([chains.tail, chains.head])].mean(axis=0)
    np.testing.assert_allclose(fine.verts[curves.num_verts :], smooth[curves.num_verts :] + pushed, rtol=0, atol=1e-15)
    same = np.full(curves.num_verts, 0.3)
    found, wanted = (subdivide(curves, "interp-bspline", 3, alpha=one).verts for one in (same, 0.3))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-15)


def test_boundary_rules_are_declared_as_those_of_curves():
    """One declaration each: the very same objects, not equal ones."""
    for surface, curve in (("loop", "cubic-bspline"), ("sqrt3", "ternary-bspline")):
        assert resolve(surface).boundary is resolve(curve).mask
    assert resolve("interp-sqrt3").boundary is resolve("ternary-four-point").mask
    assert resolve("interp-loop").boundary is resolve("interp-bspline").mask is CUBIC_BSPLINE
    assert resolve("butterfly").boundary == resolve("four-point").mask == four_point(Fraction(1, 16))


BOUNDARIES = {
    "loop": "cubic-bspline",
    "loop:weights=warren": "cubic-bspline",
    "interp-loop": "interp-bspline",
    "interp-loop:alpha=0.5": "interp-bspline:alpha=0.5",
    "interp-loop:alpha=0": "interp-bspline:alpha=0",
    "interp-loop:valence3=zorin": "interp-bspline",
    "butterfly": "four-point",
    "butterfly:tension=0.03": "four-point:tension=0.03",
    "modified-butterfly": "four-point",
    "midpoint": "four-point:tension=0",
    "sqrt3": "ternary-bspline",
    "interp-sqrt3": "ternary-four-point",
    "lin-luo-sqrt3": "ternary-four-point",
}


def test_every_scheme_on_triangles_has_its_boundary_compared():
    assert {spec.partition(":")[0] for spec in BOUNDARIES} == set(TRIANGLE_SCHEMES)


def rim(topology: Topology) -> np.ndarray:
    """(B, 2) the half-edges that no twin accompanies, as pairs of verts."""
    out = topology.boundary_edges[topology.edge_of]
    return np.stack([topology.tail[out], topology.head[out]], axis=1)


@over("shape", OPEN)
@pytest.mark.parametrize("surface", BOUNDARIES)
def test_the_boundary_of_a_surface_is_refined_as_the_curve_that_it_is(surface, shape):
    """Its verts and segments alike, at two levels of the curve; √3 schemes refine it at every second step."""
    mesh = OPEN[shape]()
    topology = Topology.of(mesh)
    refinement = refine(topology, resolve(surface), 4 if "sqrt3" in surface else 2)
    fine = Topology(refinement.matrix.shape[0], refinement.faces)
    chains = join_segments(mesh.num_verts, rim(topology), "rim")
    assert chains.closed.all()
    loops = Curves(mesh.verts, chains.corners, chains.sizes, chains.closed)
    curve = subdivide(loops, BOUNDARIES[surface], 2)
    border = np.unique(rim(fine))
    distance, place = cKDTree(refinement(mesh.verts)[border]).query(curve.verts[curve.corners])
    assert distance.max() < 1e-14
    on_mesh = np.empty(curve.num_verts, dtype=int)
    on_mesh[curve.corners] = border[place]
    found = Chains.of(curve)
    segments = {(on_mesh[a], on_mesh[b]) for a, b in zip(found.tail, found.head, strict=True)}
    assert segments == {(a, b) for a, b in rim(fine).tolist()}
