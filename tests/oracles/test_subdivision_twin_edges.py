"""Plain per-edge twins of the 1-to-4 schemes, written from the published formulas, on meshes of mixed valence."""

from math import cos, pi

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.subdivision.refine import subdivide
from tests.laws.naive import Walk, same_face_sets, weighted
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, opened, patch, real, wheel

MESHES = {
    "mixed closed": mixed_closed,
    **{f"mixed open {seed}": (lambda seed=seed: mixed_open(seed)) for seed in (3, 5, 8)},
    "cow": lambda: real("cow", 500),
    "open mousehead": lambda: opened(real("mousehead", 400), 7),
    "patch": lambda: patch(5, 4),
    "wheel": lambda: wheel(3, 2),
    "tetrahedron": SOLIDS["tetrahedron"],
}


def zorin_weights(n: int) -> list[float]:
    if n == 3:
        return [5 / 12, -1 / 12, -1 / 12]
    if n == 4:
        return [3 / 8, 0, -1 / 8, 0]
    return [(0.25 + cos(2 * pi * j / n) + 0.5 * cos(4 * pi * j / n)) / n for j in range(n)]


def zorin_point(walk: Walk, centre: int, other: int) -> np.ndarray:
    ring = walk.ring(centre, other)
    spokes = weighted(zorin_weights(len(ring)), [walk.points[v] for v in ring])
    return 0.75 * walk.points[centre] + spokes


def four_point(walk: Walk, a: int, b: int, w: float) -> np.ndarray:
    return weighted([-w, 0.5 + w, 0.5 + w, -w], walk.along(a, b))


def eight_point(walk: Walk, a: int, b: int, w: float) -> np.ndarray:
    """Half the ends, 2w the opposite verts, -w the wings, which may be mirrored."""
    c, d = walk.apex[a, b], walk.apex[b, a]
    wings = walk.beyond(b, c) + walk.beyond(c, a) + walk.beyond(a, d) + walk.beyond(d, b)
    return (walk.points[a] + walk.points[b]) / 2 + 2 * w * (walk.points[c] + walk.points[d]) - w * wings


def butterfly_edge(walk: Walk, a: int, b: int, w: float) -> np.ndarray:
    return eight_point(walk, a, b, w) if (b, a) in walk.apex else four_point(walk, a, b, w)


def modified_edge(walk: Walk, a: int, b: int) -> np.ndarray:
    """The mean of the stencils of those ends that are inner and not of valence 6; the eight-point rule without any."""
    found = [zorin_point(walk, v, u) for v, u in ((a, b), (b, a)) if walk.is_extraordinary(v)]
    if (b, a) in walk.apex and found:
        return sum(found) / len(found)
    return butterfly_edge(walk, a, b, 1 / 16)


def loop_vertex(walk: Walk, v: int, weights: str) -> np.ndarray:
    if not walk.is_inner(v):
        return (walk.points[walk.back[v]] + 6 * walk.points[v] + walk.points[walk.rim[v]]) / 8
    n = walk.valence(v)
    if weights == "warren":
        beta = 3 / 16 if n == 3 else 3 / (8 * n)
    else:
        beta = (5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2) / n
    return (1 - n * beta) * walk.points[v] + beta * sum(walk.points[u] for u in walk.neighbours[v])


def loop_edge(walk: Walk, a: int, b: int) -> np.ndarray:
    if (b, a) not in walk.apex:
        return (walk.points[a] + walk.points[b]) / 2
    c, d = walk.apex[a, b], walk.apex[b, a]
    return 3 / 8 * (walk.points[a] + walk.points[b]) + (walk.points[c] + walk.points[d]) / 8


def blended_edge(walk: Walk, a: int, b: int, alpha: float, weights: str, valence3: str) -> np.ndarray:
    at_three = any(walk.is_inner(v) and walk.valence(v) == 3 for v in (a, b))
    if valence3 == "zorin" and at_three and (b, a) in walk.apex:
        return (1 - alpha) * loop_edge(walk, a, b) + alpha * modified_edge(walk, a, b)
    delta = [walk.points[v] - loop_vertex(walk, v, weights) for v in (a, b)]
    return loop_edge(walk, a, b) + alpha / 2 * sum(delta)


def blended_vertex(walk: Walk, v: int, alpha: float, weights: str) -> np.ndarray:
    return walk.points[v] - (1 - alpha) * (walk.points[v] - loop_vertex(walk, v, weights))


def quadrisected(mesh: Mesh, edge_rule, vertex_rule=None) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    walk = Walk(mesh)
    points = [vertex_rule(walk, v) if vertex_rule else walk.points[v] for v in range(mesh.num_verts)]
    middle = {}
    for a, b in walk.edges():
        middle[a, b] = middle[b, a] = len(points)
        points.append(edge_rule(walk, a, b))
    faces = []
    for a, b, c in walk.faces:
        ab, bc, ca = middle[a, b], middle[b, c], middle[c, a]
        faces += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.array(points), faces


def assert_twins(mesh: Mesh, spec: str, verts: np.ndarray, faces) -> None:
    ours = subdivide(mesh, spec)
    distance, name = cKDTree(ours.verts).query(verts)
    assert distance.max() < 1e-13 * max(1.0, float(np.abs(mesh.verts).max()))
    assert len(np.unique(name)) == len(verts) == ours.num_verts
    assert same_face_sets([name[list(face)] for face in faces], ours.faces)


every_mesh = over("make", MESHES.values())


@every_mesh
def test_modified_butterfly(make):
    mesh = make()
    assert_twins(mesh, "modified-butterfly", *quadrisected(mesh, modified_edge))


@every_mesh
@over("tension", [0, 1 / 16, 0.1])
def test_butterfly(make, tension):
    mesh = make()
    found = quadrisected(mesh, lambda walk, a, b: butterfly_edge(walk, a, b, tension))
    assert_twins(mesh, f"butterfly:tension={tension}", *found)


@every_mesh
@over("alpha", [0, 0.4, 1])
@pytest.mark.parametrize("weights", ["loop", "warren"])
@pytest.mark.parametrize("valence3", ["displacement", "zorin"])
def test_interpolatory_loop(make, alpha, weights, valence3):
    mesh = make()
    found = quadrisected(
        mesh,
        lambda walk, a, b: blended_edge(walk, a, b, alpha, weights, valence3),
        lambda walk, v: blended_vertex(walk, v, alpha, weights),
    )
    assert_twins(mesh, f"interp-loop:alpha={alpha},weights={weights},valence3={valence3}", *found)
