"""Loss terms against their definitions in plain loops, on closed, open and non-manifold meshes."""

from math import acos, dist, hypot, tan

import numpy as np
import pytest
import torch

from meshfit.loss.chamfer import Matches, chamfer
from meshfit.loss.consistency import consistency
from meshfit.loss.edge import edge
from meshfit.loss.laplacian import laplacian_cotangent, laplacian_uniform
from meshfit.loss.normal import normal
from meshfit.loss.operators import FaceGeometry, MeshOperators
from meshfit.mesh.mesh import Mesh
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, patch, wheel


def book(pages):
    """Triangles around one common edge."""
    turns = np.random.default_rng(pages).uniform(0, 2 * np.pi, pages)
    outer = np.stack([np.cos(turns), np.sin(turns), np.linspace(0.2, 0.8, pages)], axis=1)
    verts = np.concatenate([[[0, 0, 0], [0, 0, 1]], outer])
    return Mesh(verts, np.array([(0, 1, 2 + page) for page in range(pages)]))


def carelessly_wound(mesh, seed=0):
    turned = np.random.default_rng(seed).random(mesh.num_faces) < 0.4
    return Mesh(mesh.verts, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def crumpled(mesh, seed=0):
    moves = np.random.default_rng(seed).normal(scale=0.2, size=mesh.verts.shape)
    return Mesh(mesh.verts + moves, mesh.faces)


def with_loose_verts(mesh):
    return Mesh(np.concatenate([mesh.verts, [[5.0, 6.0, 7.0], [1.0, 0.0, 0.0]]]), mesh.faces)


MESHES = {
    "closed, mixed valence": mixed_closed(seed=5),
    "open, mixed valence": mixed_open(seed=6),
    "crumpled wheel": crumpled(wheel(7, 2)),
    "crumpled patch, carelessly wound": carelessly_wound(crumpled(patch(5, 4))),
    "closed, carelessly wound": carelessly_wound(mixed_closed(seed=8), seed=1),
    "three faces at an edge": book(3),
    "five faces at an edge, carelessly wound": carelessly_wound(book(5)),
    "one triangle": Mesh(np.array([[0, 0, 1], [2, 0, 1], [0, 1, 3]]), np.array([[0, 1, 2]])),
    "verts of no face": with_loose_verts(crumpled(patch(4, 4), seed=2)),
}


def subtract(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def inner(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def cosine(a, b):
    return inner(a, b) / (hypot(*a) * hypot(*b))


def edges_of(faces):
    """From each edge to the verts opposite to it, one for each face there."""
    opposite = {}
    for face in faces:
        for k in range(3):
            ends = tuple(sorted((face[k], face[(k + 1) % 3])))
            opposite.setdefault(ends, []).append(face[(k + 2) % 3])
    return opposite


def naive_edge(verts, faces):
    edges = edges_of(faces)
    return sum(dist(verts[a], verts[b]) ** 2 for a, b in edges) / len(edges)


def mean_step(verts, weights):
    """Mean distance from each vertex to the weighted mean of its neighbours; 0 where it has none."""
    total = 0.0
    for v, place in enumerate(verts):
        own = {b if a == v else a: weight for (a, b), weight in weights.items() if v in (a, b)}
        if own:
            norm = sum(own.values())
            mean = [sum(weight * verts[w][axis] for w, weight in own.items()) / norm for axis in range(3)]
            total += dist(mean, place)
    return total / len(verts)


def naive_uniform(verts, faces):
    return mean_step(verts, dict.fromkeys(edges_of(faces), 1.0))


def naive_cotangent(verts, faces):
    weights = {}
    for (a, b), apexes in edges_of(faces).items():
        angles = [acos(cosine(subtract(verts[a], verts[c]), subtract(verts[b], verts[c]))) for c in apexes]
        weights[a, b] = sum(1 / tan(angle) for angle in angles)
    return mean_step(verts, weights)


def naive_consistency(verts, faces):
    """Normals of both faces are taken along their common edge, so that their winding does not matter."""
    bends = []
    for (a, b), apexes in edges_of(faces).items():
        along = subtract(verts[b], verts[a])
        normals = [cross(along, subtract(verts[c], verts[a])) for c in apexes]
        bends += [1 + cosine(normals[i], normals[j]) for i in range(len(normals)) for j in range(i)]
    return sum(bends) / len(bends) if bends else 0.0


TERMS = {
    "edge": (lambda verts, surface: edge(surface.edges @ verts, surface), naive_edge),
    "laplacian, uniform": (lambda verts, surface: laplacian_uniform(surface.edges @ verts, surface), naive_uniform),
    "laplacian, cotangent": (laplacian_cotangent, naive_cotangent),
    "consistency": (
        lambda verts, surface: consistency(FaceGeometry.of(surface.faces, verts), surface),
        naive_consistency,
    ),
}


def values(term, meshes):
    verts = torch.tensor(np.concatenate([mesh.verts for mesh in meshes]))
    return term(verts, MeshOperators.of(meshes, torch.float64, torch.device("cpu"))).tolist()


@over("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize(("term", "naive"), TERMS.values(), ids=TERMS)
def test_a_mesh_term_equals_its_definition(mesh, term, naive):
    (found,) = values(term, [mesh])
    assert found == pytest.approx(naive(mesh.verts.tolist(), mesh.faces.tolist()), rel=1e-10, abs=1e-14)


@pytest.mark.parametrize(("term", "naive"), TERMS.values(), ids=TERMS)
def test_a_term_of_meshes_side_by_side_equals_the_definition_for_each(term, naive):
    expected = [naive(mesh.verts.tolist(), mesh.faces.tolist()) for mesh in MESHES.values()]
    assert values(term, list(MESHES.values())) == pytest.approx(expected, rel=1e-10, abs=1e-14)


def nearest(points, others):
    return [min(range(len(others)), key=lambda j: dist(point, others[j])) for point in points]


def naive_chamfer(p, q):
    forward = [dist(point, q[j]) ** 2 for point, j in zip(p, nearest(p, q), strict=True)]
    backward = [dist(point, p[i]) ** 2 for point, i in zip(q, nearest(q, p), strict=True)]
    return sum(forward) / len(p) + sum(backward) / len(q)


def naive_normal(p, q, p_normals, q_normals):
    forward = [1 - abs(cosine(n, q_normals[j])) for n, j in zip(p_normals, nearest(p, q), strict=True)]
    backward = [1 - abs(cosine(n, p_normals[i])) for n, i in zip(q_normals, nearest(q, p), strict=True)]
    return sum(forward) / len(p) + sum(backward) / len(q)


@pytest.mark.parametrize(("p_count", "q_count"), [(40, 40), (25, 60), (60, 25), (1, 7), (1, 1)])
def test_a_term_of_points_equals_its_definition(p_count, q_count):
    generator = np.random.default_rng(p_count)
    p, q, p_normals, q_normals = (generator.normal(size=(n, 3)) for n in (p_count, q_count) * 2)
    p_normals, q_normals = (n / np.linalg.norm(n, axis=1, keepdims=True) for n in (p_normals, q_normals))
    p_list, q_list = p.tolist(), q.tolist()
    matches = Matches(torch.tensor(nearest(p_list, q_list)), torch.tensor(nearest(q_list, p_list)))
    assert float(chamfer(torch.tensor(p), torch.tensor(q), matches)) == pytest.approx(naive_chamfer(p_list, q_list))
    found = float(normal(torch.tensor(p_normals), torch.tensor(q_normals), matches))
    assert found == pytest.approx(naive_normal(p_list, q_list, p_normals.tolist(), q_normals.tolist()))


def test_terms_of_points_side_by_side_equal_their_definitions_for_each():
    generator = np.random.default_rng(0)
    p, q, p_normals, q_normals = (generator.normal(size=(3, n, 3)) for n in (20, 30) * 2)
    there = [[30 * k + j for j in nearest(p[k].tolist(), q[k].tolist())] for k in range(3)]
    back = [[20 * k + i for i in nearest(q[k].tolist(), p[k].tolist())] for k in range(3)]
    matches = Matches(torch.tensor(there).view(-1), torch.tensor(back).view(-1), batch_size=3)
    rows = [torch.tensor(part).view(-1, 3) for part in (p, q, p_normals, q_normals)]
    members = [[part[k].tolist() for part in (p, q, p_normals, q_normals)] for k in range(3)]
    found = chamfer(rows[0], rows[1], matches)
    assert found.tolist() == pytest.approx([naive_chamfer(p, q) for p, q, _, _ in members])
    found = normal(rows[2], rows[3], matches)
    assert found.tolist() == pytest.approx([naive_normal(*member) for member in members])
