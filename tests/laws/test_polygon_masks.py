"""Exact weights of schemes on polygons: on regular quads as fractions, at extraordinary vertices from the formulas."""

from fractions import Fraction
from math import cos, pi

import numpy as np
import pytest

from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from tests.laws.polygon_variants import dense, refined
from tests.loops import over
from tests.quads import prism, quad_patch, quad_torus, quad_wheel

COLUMNS, ROWS = 9, 8
SPLINE, POINTS = (1, 4, 6, 4, 1), (-1, 0, 9, 16, 9, 0, -1)
TERNARY_SPLINE = (1, 4, 10, 16, 19, 16, 10, 4, 1)
TERNARY_POINTS = (-4, -5, 0, 30, 60, 81, 60, 30, 0, -5, -4)


def curve_rows(mask, arity):
    """Of a curve rule, the weights by offset of the points that go in at each fraction of an edge, from its mask."""
    centre, total = len(mask) // 2, Fraction(sum(mask), arity)
    rows = []
    for place in range(arity):
        at = {k: centre + place - arity * k for k in range(-3, 4)}
        row = {k: Fraction(mask[i]) / total for k, i in at.items() if 0 <= i < len(mask)}
        rows.append({k: weight for k, weight in row.items() if weight})
    return rows


def tensor(first, second):
    """Weights on the lattice from those in its two directions."""
    return {(i, j): a * b for i, a in first.items() for j, b in second.items()}


def lattice_row(weights):
    return {(i % COLUMNS) + COLUMNS * (j % ROWS): w for (i, j), w in weights.items()}


def fractions_of(row):
    found = np.flatnonzero(np.abs(row) > 1e-15)
    return {int(column): Fraction(float(row[column])).limit_denominator(20000) for column in found}


def rows_of(spec, levels=1):
    return [fractions_of(row) for row in dense(quad_torus(COLUMNS, ROWS), spec, levels)]


@pytest.mark.parametrize(
    ("spec", "mask", "arity"),
    [
        ("catmull-clark", SPLINE, 2),
        ("kobbelt", POINTS, 2),
        ("ternary", TERNARY_SPLINE, 3),
        ("interp-ternary", TERNARY_POINTS, 3),
    ],
)
def test_on_regular_quads_these_are_tensor_products_of_curve_rules(spec, mask, arity):
    curve, found = curve_rows(mask, arity), rows_of(spec)
    expected = [lattice_row(tensor(a, b)) for a in curve for b in curve]
    assert all(sum(row.values()) == 1 for row in expected)
    assert all(found.count(row) == 1 for row in expected)
    assert len(found) == arity**2 * COLUMNS * ROWS


def test_regular_doo_sabin_is_the_biquadratic_spline():
    corners = [[{0: Fraction(3, 4), 1: Fraction(1, 4)}, {0: Fraction(1, 4), 1: Fraction(3, 4)}][k] for k in (0, 1)]
    found = rows_of("doo-sabin")
    assert all(found.count(lattice_row(tensor(a, b))) == 1 for a in corners for b in corners)
    assert len(found) == 4 * COLUMNS * ROWS


def quarter_turns(weights):
    """With those at all places that turns and mirrors about the middle of the unit square lead to."""
    found = {}
    for (i, j), weight in weights.items():
        for x, y in ((i, j), (1 - i, j), (i, 1 - j), (1 - i, 1 - j)):
            found |= {(x, y): weight, (y, x): weight}
    return found


@pytest.mark.parametrize(
    ("spec", "weights"),
    [
        ("sqrt2", {(0, 0): Fraction(1, 4)}),
        ("interp-sqrt2", {(0, 0): Fraction(10, 32), (-1, 0): Fraction(-1, 32)}),
        ("interp-sqrt2:alpha=0.5", {(0, 0): Fraction(9, 32), (-1, 0): Fraction(-1, 64)}),
        (
            "interp-catmull-clark",
            {(0, 0): Fraction(79, 256), (-1, 0): Fraction(-7, 256), (-1, -1): Fraction(-1, 256)},
        ),
    ],
)
def test_regular_face_rules_of_the_others(spec, weights):
    expected = quarter_turns(weights)
    assert sum(expected.values()) == 1
    assert rows_of(spec).count(lattice_row(expected)) == 1


def test_regular_edge_rule_of_interpolatory_catmull_clark_is_the_four_point_rule_across_and_nothing_aside():
    """Its weights in lines along the edge and across it sum to those of the curve rules: it is no tensor product."""
    per_128 = {(0, 0): 70, (-1, 0): -6, (0, 1): 1, (-1, 1): -1}
    expected = {}
    for (i, j), weight in per_128.items():
        expected |= {(x, y): Fraction(weight, 128) for x in (i, 1 - i) for y in (j, -j)}
    assert sum(expected.values()) == 1
    assert rows_of("interp-catmull-clark").count(lattice_row(expected)) == 1
    for axis, sums in ((0, {-1: -1, 0: 9, 1: 9, 2: -1}), (1, {-1: 0, 0: 16, 1: 0})):
        for line, total in sums.items():
            assert sum(w for place, w in expected.items() if place[axis] == line) == Fraction(total, 16)


def test_two_steps_of_sqrt2_split_as_catmull_clark_does():
    mesh = quad_torus(COLUMNS, ROWS)
    one, two = refined(mesh, "catmull-clark", 1).finest, refined(mesh, "sqrt2", 2).finest
    assert (one.num_verts, one.num_edges, one.num_faces) == (two.num_verts, two.num_edges, two.num_faces)
    assert (two.valence == 4).all()


@pytest.mark.parametrize("spec", ["sqrt2", "interp-sqrt2"])
def test_sqrt2_leaves_the_boundary_alone_and_then_halves_it(spec):
    mesh = quad_patch(6, 5)
    coarse = PolygonTopology.of(mesh)
    first, second = refined(mesh, spec, 2).operators
    border = np.flatnonzero(coarse.boundary_verts)
    assert np.array_equal(first.toarray()[border], np.eye(mesh.num_verts)[border])
    once, twice = refined(mesh, spec, 1).finest, refined(mesh, spec, 2).finest
    assert once.boundary_edges.sum() == coarse.boundary_edges.sum()
    assert twice.boundary_edges.sum() == 2 * coarse.boundary_edges.sum()
    assert (twice.sizes == 4).all()
    assert second.shape[0] == twice.num_verts


@over("n", [2, 3, 4, 5, 6, 7, 12])
def test_catmull_clark_at_an_extraordinary_vertex(n):
    """From Catmull and Clark's own words: face points, edge midpoints, and n - 3 times the vertex, over n."""
    mesh = quad_wheel(n, 2)
    topology = PolygonTopology.of(mesh)
    faces = [row for row in np.split(topology.corners, topology.starts[1:]) if 0 in row]
    eye = np.eye(mesh.num_verts)
    neighbours = topology.head[topology.tail == 0]
    expected = sum(eye[face].mean(axis=0) for face in faces) / n
    expected = expected + 2 * sum((eye[0] + eye[v]) / 2 for v in neighbours) / n + (n - 3) * eye[0]
    np.testing.assert_allclose(dense(mesh, "catmull-clark")[0], expected / n, rtol=0, atol=1e-15)


@over("n", [3, 5, 6, 9])
def test_doo_sabin_in_a_face_of_any_size(n):
    rows = dense(prism(n), "doo-sabin")
    for k in range(n):
        expected = np.zeros(2 * n)
        expected[n + np.arange(n)] = [(3 + 2 * cos(2 * pi * (i - k) / n)) / (4 * n) for i in range(n)]
        expected[n + k] = (n + 5) / (4 * n)
        assert (np.abs(rows - expected).max(axis=1) < 1e-15).sum() == 1


def kobbelt_edge(n, mesh, topology, spoke):
    """The vertex in an edge of an extraordinary vertex, with Kobbelt's point in place of the one that is missing."""
    eye = np.eye(mesh.num_verts)
    out = [spoke]
    while len(out) < n:
        out.append(int(topology.next_around_tail(np.array(out[-1:]))[0]))
    near = [eye[topology.head[h]] for h in out]
    far = [eye[topology.head[topology.following(np.array([h]))[0]]] for h in out]
    behind = 4 / n * sum(near) - sum(near[i % n] for i in (-1, 0, 1))
    behind = behind + (sum(far[i % n] for i in (-2, -1, 0, 1)) - 4 / n * sum(far)) / 9
    straight = topology.following(topology.twin[topology.following(np.array([spoke]))])[0]
    return (9 * (eye[0] + near[0]) - behind - eye[topology.head[straight]]) / 16


@over("n", [2, 3, 4, 5, 6, 8])
def test_kobbelts_edges_at_an_extraordinary_vertex(n):
    mesh = quad_wheel(n, 3)
    topology, rows = PolygonTopology.of(mesh), dense(mesh, "kobbelt")
    for spoke in np.flatnonzero(topology.tail == 0):
        expected = kobbelt_edge(n, mesh, topology, int(spoke))
        assert (np.abs(rows - expected).max(axis=1) < 1e-14).sum() == 1


def both_orders(n: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertex of a face, so many steps along a spoke, from new verts in edges in one direction and in the other."""
    mesh = quad_wheel(n, 6)
    topology, edges = PolygonTopology.of(mesh), dense(mesh, "kobbelt")[mesh.num_verts :]
    corner = int(topology.starts[6 * steps])
    found = []
    for side in (corner, corner + 1):
        line = np.array([side, corner + (side - corner + 2) % 4])
        across = topology.twin[line]
        ends = topology.following(topology.following(across))
        inner, outer = edges[topology.edge_of[line]], edges[topology.edge_of[ends]]
        found.append((9 * inner.sum(axis=0) - outer.sum(axis=0)) / 16)
    return found[0], found[1]


@over("n", [2, 3, 5, 6, 7])
def test_kobbelts_face_vertex_is_the_same_in_both_orders_next_to_an_extraordinary_vertex(n):
    one, other = both_orders(n, 0)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-15)
    one, other = both_orders(n, 1)
    assert n == 2 or 1e-4 < np.abs(one - other).max() < 1 / 128


@pytest.mark.parametrize(
    ("spec", "vert", "inserted"),
    [
        ("catmull-clark", (1, 6, 1), [(0, 1, 1, 0)]),
        ("interp-catmull-clark", (0, 1, 0), [(-1, 9, 9, -1)]),
        ("interp-catmull-clark:alpha=0.5", (1, 14, 1), [(-1, 17, 17, -1)]),
        ("kobbelt", (0, 1, 0), [(-1, 9, 9, -1)]),
        ("ternary", (4, 19, 4), [(1, 16, 10, 0), (0, 10, 16, 1)]),
        ("interp-ternary", (0, 1, 0), [(-5, 60, 30, -4), (-4, 30, 60, -5)]),
        ("doo-sabin", None, [(0, 3, 1, 0), (0, 1, 3, 0)]),
    ],
)
def test_boundary_rules(spec, vert, inserted):
    found = [fractions_of(row) for row in dense(quad_patch(9, 6), spec)]

    def along(first, weights):
        return {first + k: Fraction(w, sum(weights)) for k, w in enumerate(weights) if w}

    if vert is not None:
        assert found[4] == along(3, vert)
    assert all(found.count(along(3, weights)) == 1 for weights in inserted)


def test_kinds_in_the_table():
    for name, entry in POLYGON_SCHEMES.items():
        matrix = dense(quad_patch(5, 4), name)[:20]
        assert np.array_equal(matrix, np.eye(20)) == (entry.kind == "interpolatory")
        assert entry.domain == "polygons"
