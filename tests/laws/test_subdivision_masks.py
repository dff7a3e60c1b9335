"""Exact weights in the regular case, on a torus grid, and along straight boundaries; read back as fractions."""

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from tests.laws.variants import dense, refined
from tests.shapes import patch, torus

COLUMNS, ROWS = 9, 8

# Roles around the edge from the origin to (1, 0) of the lattice, whose neighbours are ±(1, 0), ±(0, 1) and ±(1, -1).
EDGE = {
    "end": [(0, 0), (1, 0)],
    "opposite": [(0, 1), (1, -1)],
    "wing": [(-1, 1), (1, 1), (0, -1), (2, -1)],
    "beyond": [(-1, 0), (2, 0)],
}
# Roles around the face (0, 0), (1, 0), (0, 1).
FACE = {
    "corner": [(0, 0), (1, 0), (0, 1)],
    "across": [(1, 1), (-1, 1), (1, -1)],
    "wing": [(2, 0), (0, 2), (2, -1), (-1, 2), (0, -1), (-1, 0)],
}


def fractions_of(row: np.ndarray) -> dict[int, Fraction]:
    """The entries of a row that are not zero."""
    return {
        int(column): Fraction(float(row[column])).limit_denominator(20000)
        for column in np.flatnonzero(np.abs(row) > 1e-15)
    }


def placed(roles: dict[str, list[tuple[int, int]]], weights: dict[str, Fraction]) -> dict[int, Fraction]:
    """The row on the torus grid that gives each role its weight."""
    row = {}
    for role, weight in weights.items():
        row |= {(i % COLUMNS) + COLUMNS * (j % ROWS): weight for i, j in roles[role] if weight}
    return row


def only_row(matrix: np.ndarray, wanted: dict[int, Fraction]) -> dict[int, Fraction]:
    """Of the inserted verts, the row whose largest weights are where those wanted are."""
    heaviest = {column for column, weight in wanted.items() if weight == max(wanted.values())}
    rows = [fractions_of(row) for row in matrix]
    found = [row for row in rows if {c for c, w in row.items() if w == max(row.values())} == heaviest]
    assert len(found) == 1
    return found[0]


def edge_weights(end, opposite=0, wing=0, beyond=0, over=1):
    names = ("end", "opposite", "wing", "beyond")
    return {name: Fraction(w) / over for name, w in zip(names, (end, opposite, wing, beyond), strict=True)}


def blend(alpha: Fraction) -> dict[str, Fraction]:
    return edge_weights(12 + 5 * alpha, 4 - 2 * alpha, -alpha, -alpha, over=32)


def butterfly(w: Fraction) -> dict[str, Fraction]:
    return edge_weights(Fraction(1, 2), 2 * w, -w)


def ten_point(w: Fraction) -> dict[str, Fraction]:
    return edge_weights(Fraction(1, 2) - w, Fraction(1, 8) + 2 * w, Fraction(-1, 16) - w, w)


EDGE_RULES = {
    "midpoint": edge_weights(1, over=2),
    "loop": edge_weights(3, 1, over=8),
    "loop:weights=warren": edge_weights(3, 1, over=8),
    "interp-loop": edge_weights(17, 2, -1, -1, over=32),
    "interp-loop:weights=warren": ten_point(Fraction(-1, 32)),
    "interp-loop:valence3=zorin": ten_point(Fraction(-1, 32)),
    **{f"interp-loop:alpha={a}": blend(Fraction(a)) for a in ("0", "0.25", "0.5", "0.75", "0.9")},
    "butterfly": edge_weights(8, 2, -1, over=16),
    "butterfly:tension=0.03125": butterfly(Fraction(1, 32)),
    "butterfly:tension=0.125": butterfly(Fraction(1, 8)),
    "butterfly:tension=0": edge_weights(1, over=2),
    "modified-butterfly": edge_weights(8, 2, -1, over=16),
}
FACE_RULES = {
    "sqrt3": {"corner": Fraction(1, 3)},
    "lin-luo-sqrt3": {"corner": Fraction(11, 27), "across": Fraction(-1, 27), "wing": Fraction(-1, 54)},
    "lin-luo-sqrt3:alpha=0.5": {"corner": Fraction(10, 27), "across": Fraction(-1, 54), "wing": Fraction(-1, 108)},
    "interp-sqrt3": {"corner": Fraction(32, 81), "across": Fraction(-1, 81), "wing": Fraction(-2, 81)},
}
# Centre, and each of the six neighbours.
VERT_RULES = {
    "loop": (Fraction(10, 16), Fraction(1, 16)),
    "loop:weights=warren": (Fraction(10, 16), Fraction(1, 16)),
    "interp-loop:alpha=0.5": (Fraction(26, 32), Fraction(1, 32)),
    "interp-loop:alpha=0.25": (Fraction(23, 32), Fraction(3, 64)),
    "interp-loop": (Fraction(1), Fraction(0)),
    "sqrt3": (Fraction(2, 3), Fraction(1, 18)),
    "lin-luo-sqrt3": (Fraction(1), Fraction(0)),
    "lin-luo-sqrt3:alpha=0.5": (Fraction(5, 6), Fraction(1, 36)),
    "interp-sqrt3": (Fraction(1), Fraction(0)),
}


@pytest.mark.parametrize("spec", EDGE_RULES)
def test_regular_edge_rule(spec):
    expected = placed(EDGE, EDGE_RULES[spec])
    assert sum(expected.values()) == 1
    assert only_row(dense(torus(COLUMNS, ROWS), spec)[COLUMNS * ROWS :], expected) == expected


@pytest.mark.parametrize("spec", FACE_RULES)
def test_regular_face_rule(spec):
    expected = placed(FACE, FACE_RULES[spec])
    assert sum(expected.values()) == 1
    assert only_row(dense(torus(COLUMNS, ROWS), spec)[COLUMNS * ROWS :], expected) == expected


@pytest.mark.parametrize("spec", EDGE_RULES | FACE_RULES)
def test_every_inserted_vert_of_a_torus_has_the_same_weights(spec):
    rows = dense(torus(COLUMNS, ROWS), spec)[COLUMNS * ROWS :]
    counts = {tuple(sorted(Counter(fractions_of(row).values()).items())) for row in rows}
    assert len(counts) == 1


@pytest.mark.parametrize("spec", VERT_RULES)
def test_regular_vertex_rule(spec):
    mesh = torus(COLUMNS, ROWS)
    centre, neighbour = VERT_RULES[spec]
    ring = [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)]
    expected = {0: centre} | {(i % COLUMNS) + COLUMNS * (j % ROWS): neighbour for i, j in ring if neighbour}
    assert fractions_of(dense(mesh, spec)[0]) == expected


# Along a boundary, up to the common denominator, which is their sum: the vertex rule at offsets -1, 0, 1,
# and the rule of each inserted vertex at offsets -1, 0, 1, 2 from the edge's first end.
CURVES = {
    "midpoint": ((0, 1, 0), [(0, 1, 1, 0)]),
    "loop": ((1, 6, 1), [(0, 1, 1, 0)]),
    "interp-loop": ((0, 1, 0), [(-1, 9, 9, -1)]),
    "interp-loop:alpha=0.5": ((1, 14, 1), [(-1, 17, 17, -1)]),
    "butterfly": ((0, 1, 0), [(-1, 9, 9, -1)]),
    "butterfly:tension=0.03125": ((0, 1, 0), [(-1, 17, 17, -1)]),
    "modified-butterfly": ((0, 1, 0), [(-1, 9, 9, -1)]),
    "sqrt3": ((4, 19, 4), [(1, 16, 10, 0), (0, 10, 16, 1)]),
    "lin-luo-sqrt3": ((0, 1, 0), [(-5, 60, 30, -4), (-4, 30, 60, -5)]),
    "lin-luo-sqrt3:alpha=0.5": ((4, 46, 4), [(-2, 108, 60, -4), (-4, 60, 108, -2)]),
    "interp-sqrt3": ((0, 1, 0), [(-5, 60, 30, -4), (-4, 30, 60, -5)]),
}


def along(first: int, weights: tuple[int, ...]) -> dict[int, Fraction]:
    return {first + k: Fraction(weight, sum(weights)) for k, weight in enumerate(weights) if weight}


@pytest.mark.parametrize("spec", CURVES)
def test_boundary_rule(spec):
    """Along the side j = 0 of a flat patch; the √3 schemes leave the boundary alone at their first step."""
    mesh = patch(9, 6)
    first, *second = refined(mesh, spec, 2 if "sqrt3" in spec else 1).operators
    if second:
        assert np.array_equal(first.toarray()[:9], np.eye(9, mesh.num_verts))
    rows = [fractions_of(row) for row in (second or [first])[0].toarray()]
    vert_rule, inserted = CURVES[spec]
    for i in range(1, 8):
        assert rows[i] == along(i - 1, vert_rule)
    for i in range(1, 7):
        for weights in inserted:
            assert rows.count(along(i - 1, weights)) == 1


def test_boundary_rule_is_kept_by_a_closed_loop_of_any_numbering():
    """A hole in a torus: its rim is a curve whose direction no numbering gives away."""
    mesh = torus(COLUMNS, ROWS)
    holed = Mesh(mesh.verts, mesh.faces[1:])
    rim = [int(v) for v in mesh.faces[0]]
    rows = [fractions_of(row) for row in dense(holed, "interp-loop")[mesh.num_verts :]]
    for k in range(3):
        a, b, c = np.roll(rim, k).tolist()
        assert {a: Fraction(9, 16), b: Fraction(9, 16), c: Fraction(-2, 16)} in rows
