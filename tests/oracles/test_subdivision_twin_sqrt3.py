"""Plain per-face twins of the √3 schemes, both steps, with the boundary trisected at the second."""

from math import cos, pi

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.subdivision.refine import subdivide
from tests.laws.naive import Walk, same_face_sets, weighted
from tests.loops import over
from tests.shapes import OPEN, mixed_closed, mixed_open, opened, patch, real

MESHES = {
    "mixed closed": mixed_closed,
    **{f"mixed open {seed}": (lambda seed=seed: mixed_open(seed)) for seed in (3, 5, 8)},
    "cow": lambda: real("cow", 500),
    "open mousehead": lambda: opened(real("mousehead", 400), 7),
    "patch": lambda: patch(7, 6),
    "two triangles": OPEN["two triangles"],
    "tetrahedron": SOLIDS["tetrahedron"],
}


def labsik_greiner_point(walk: Walk, centre: int, first: int) -> np.ndarray:
    """From the ring of an inner vertex; its first two verts are the other corners of the face."""
    ring = [walk.points[v] for v in walk.ring(centre, first)]
    n = len(ring)
    if n == 3:
        own, weights = 8 / 9, [4 / 27, 4 / 27, -5 / 27]
    elif n == 4:
        own, weights = 7 / 9, [2 / 9, 2 / 9, -1 / 9, -1 / 9]
    else:
        a = 2 * cos(pi / n) / 3
        turns = [2 * pi * i / n - pi / n for i in range(n)]
        own = 1 - a * a
        weights = [(a * a + 2 * a * cos(t) + 2 * a * a * cos(2 * t)) / n for t in turns]
    return own * walk.points[centre] + weighted(weights, ring)


def beyond_neighbour(walk: Walk, x: int, y: int) -> list[np.ndarray]:
    """Across the edge from x to y: the neighbouring face's apex, then what lies beyond its other two edges."""
    if (y, x) in walk.apex:
        d = walk.apex[y, x]
        return [walk.points[d], walk.beyond(x, d), walk.beyond(d, y)]
    # Continue the lattice over the rim: apex o has the images x + y - o, then 2x - o and 2y - o.
    px, py, po = walk.points[x], walk.points[y], walk.points[walk.apex[x, y]]
    return [px + py - po, 2 * px - po, 2 * py - po]


def interpolatory_face(walk: Walk, face: tuple[int, ...], step: int) -> np.ndarray:
    a, b, c = face
    corners = [(v, first) for v, first in ((a, b), (b, c), (c, a)) if walk.is_extraordinary(v)]
    if corners:
        return sum(labsik_greiner_point(walk, v, first) for v, first in corners) / len(corners)
    point = 32 / 81 * (walk.points[a] + walk.points[b] + walk.points[c])
    for x, y in ((a, b), (b, c), (c, a)):
        point = point + weighted([-1 / 81, -2 / 81, -2 / 81], beyond_neighbour(walk, x, y))
    return point


def kobbelt_face(walk: Walk, face: tuple[int, ...], step: int) -> np.ndarray:
    return sum(walk.points[v] for v in face) / 3


def kobbelt_vertex(walk: Walk, v: int, step: int) -> np.ndarray:
    if walk.is_inner(v):
        n = walk.valence(v)
        share = (4 - 2 * cos(2 * pi / n)) / 9
        return (1 - share) * walk.points[v] + share / n * sum(walk.points[u] for u in walk.neighbours[v])
    if step % 2 == 0:
        return walk.points[v]
    return (4 * walk.points[walk.back[v]] + 19 * walk.points[v] + 4 * walk.points[walk.rim[v]]) / 27


def unified(alpha: float):
    """Lin and Luo: what Kobbelt's rule takes from a vertex, α times it given back, and to new verts the mean of that.

    On a rim (1, 16, 10) / 27 gets two thirds of the nearer and one third of the farther displacement.
    """

    def displacement(walk: Walk, v: int, step: int) -> np.ndarray:
        return walk.points[v] - kobbelt_vertex(walk, v, step)

    def face_rule(walk: Walk, face: tuple[int, ...], step: int) -> np.ndarray:
        return kobbelt_face(walk, face, step) + alpha * sum(displacement(walk, v, step) for v in face) / 3

    def vertex_rule(walk: Walk, v: int, step: int) -> np.ndarray:
        return kobbelt_vertex(walk, v, step) + alpha * displacement(walk, v, step)

    return face_rule, vertex_rule, np.array([3 - 8 * alpha, 48 + 12 * alpha, 30, -4 * alpha]) / 81


def refined_once(mesh: Mesh, step: int, face_rule, vertex_rule, thirds) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """One √3 step: a vertex in every face, or, where a rim edge is trisected, two on that edge instead."""
    walk = Walk(mesh)
    points = [vertex_rule(walk, v, step) for v in range(mesh.num_verts)]
    beside, faces = {}, []
    for face in walk.faces:
        sides = [(face[k], face[(k + 1) % 3]) for k in range(3)]
        rim = [side for side in sides if side[::-1] not in walk.apex]
        if rim and step % 2:
            (side,) = rim
            apex = walk.apex[side]
            near, far = len(points), len(points) + 1
            along = walk.along(*side)
            points += [weighted(thirds, along), weighted(thirds[::-1], along)]
            beside |= {(side[1], apex): far, (apex, side[0]): near}
            faces.append((near, far, apex))
        else:
            beside |= dict.fromkeys(sides, len(points))
            points.append(face_rule(walk, face, step))
            faces += [(*side, beside[side]) for side in rim]
    for a, b in walk.edges():
        if (b, a) in walk.apex:
            left, right = beside[a, b], beside[b, a]
            faces += [(a, right, left), (b, left, right)]
    return np.array(points), faces


RULES = {
    "sqrt3": (kobbelt_face, kobbelt_vertex, [1 / 27, 16 / 27, 10 / 27, 0]),
    "lin-luo-sqrt3": unified(1),
    "lin-luo-sqrt3:alpha=0.3": unified(0.3),
    "interp-sqrt3": (
        interpolatory_face,
        lambda walk, v, step: walk.points[v],
        [-5 / 81, 60 / 81, 30 / 81, -4 / 81],
    ),
}


@pytest.mark.parametrize(
    "spec",
    [
        spec if spec in ("sqrt3", "lin-luo-sqrt3:alpha=0.3") else pytest.param(spec, marks=pytest.mark.slow)
        for spec in RULES
    ],
)
@over("make", MESHES.values())
def test_twins(spec, make):
    mesh = make()
    twin = mesh
    for step in range(3):
        verts, faces = refined_once(twin, step, *RULES[spec])
        twin = Mesh(verts, np.array(faces))
        ours = subdivide(mesh, spec, step + 1)
        distance, name = cKDTree(ours.verts).query(twin.verts)
        assert distance.max() < 1e-13 * max(1.0, float(np.abs(mesh.verts).max()))
        assert len(np.unique(name)) == twin.num_verts == ours.num_verts
        assert same_face_sets(name[twin.faces], ours.faces)
