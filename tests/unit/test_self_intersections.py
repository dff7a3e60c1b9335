"""Self-intersections: known answers, MeshLab's answers, exact answers for all pairs, and invariances."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import torch

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import self_intersecting_faces
from meshfit.mesh.solids import cube, icosahedron, octahedron, tetrahedron
from meshfit.mesh.targets import load_target
from meshfit.remeshing import broad_phase as overlaps
from meshfit.remeshing.broad_phase import boxes_near, overlapping_boxes
from meshfit.remeshing.self_intersections import intersecting_faces, intersecting_pairs
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.shapes import torus

FLOOR = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


def tensors(mesh, dtype=torch.float64):
    return torch.tensor(mesh.verts, dtype=dtype), torch.tensor(mesh.faces)


def pairs(verts, faces, members=None):
    members = None if members is None else torch.tensor(members)
    verts, faces = torch.tensor(np.array(verts), dtype=torch.float64), torch.tensor(np.array(faces))
    return intersecting_pairs(verts, faces, members).tolist()


def with_floor(*points, faces=((3, 4, 5),)):
    """What crosses in the floor, face 0 with verts 0 to 2, and others."""
    return pairs([*FLOOR, *points], [[0, 1, 2], *faces])


def sphere(levels):
    mesh = subdivide(icosahedron(), "midpoint", levels)
    return Mesh(mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def shaken(levels, noise, seed=0):
    """A sphere whose verts are moved at random, by a share of the length of its edges."""
    mesh = sphere(levels)
    edge = np.linalg.norm(mesh.verts[mesh.faces[:, 0]] - mesh.verts[mesh.faces[:, 1]], axis=1).mean()
    moves = np.random.default_rng(seed).normal(size=mesh.verts.shape)
    return Mesh(mesh.verts + noise * edge * moves, mesh.faces)


def bumpy():
    """A torus of curved and of hollow parts, with edges of very different lengths."""
    mesh = torus(24, 12)
    scale = 1 + 0.15 * np.sin(5 * mesh.verts[:, :1]) * np.cos(3 * mesh.verts[:, 1:2])
    return Mesh(mesh.verts * scale * [3.0, 1.0, 0.4], mesh.faces)


def soup(seed, num_verts=18, num_faces=24):
    """Random triangles, some with common verts."""
    generator = np.random.default_rng(seed)
    rows = [generator.choice(num_verts, 3, replace=False) for _ in range(num_faces)]
    return generator.normal(size=(num_verts, 3)), np.array(rows)


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def pierces(start, end, face):
    """Whether a segment meets a face, in exact arithmetic."""
    normal = cross(minus(face[1], face[0]), minus(face[2], face[0]))
    above, below = dot(normal, minus(start, face[0])), dot(normal, minus(end, face[0]))
    if above * below > 0 or above == below == 0:
        return False
    share = above / (above - below)
    point = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
    return all(dot(normal, cross(minus(face[k - 2], face[k]), minus(point, face[k]))) >= 0 for k in range(3))


def exactly(verts, faces):
    """Crossing pairs in exact arithmetic, all compared with all."""
    points = [[Fraction(float(x)) for x in vert] for vert in verts]
    found = []
    for (i, ours), (j, theirs) in combinations(enumerate(np.asarray(faces).tolist()), 2):
        common = set(ours) & set(theirs)
        if len(common) == 2:
            continue
        sides = [
            (side, [points[v] for v in other])
            for face, other in ((ours, theirs), (theirs, ours))
            for side in combinations(face, 2)
            if not common & set(side)
        ]
        if len(common) == 3 or any(pierces(points[a], points[b], other) for (a, b), other in sides):
            found.append([i, j])
    return found


@over(
    ("points", "crossing"),
    [
        ([[1, 1, -1], [1, 1, 1], [9, 9, 0]], True),  # one edge goes through the floor
        ([[1, 1, 9], [-9, 1, -1], [11, 1, -1]], True),  # two of the floor's go through the face
        ([[1, 1, 0], [1, 1, 1], [2, 1, 1]], True),  # a corner touches
        ([[1, 1, 1e-8], [1, 1, 1], [2, 1, 1]], True),  # within the tolerance
        ([[1, 1, 1e-4], [1, 1, 1], [2, 1, 1]], False),
        ([[-1, 1, 0], [9, 1, 0], [1, 1, 3]], True),  # an edge lies across the floor
        ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], False),  # all of it lies in the floor
        ([[1, 1, 1], [2, 1, 1], [1, 2, 1]], False),
        ([[5, 5, -1], [5, 5, 1], [9, 9, 0]], False),  # through the plane, beside the floor
        ([[1, 1, -1], [1, 1, 1], [1, 1, 2]], True),  # a needle goes through the floor
        ([[5, 5, 5], [6, 6, 6], [7, 7, 7]], False),
        ([[1, 1, 0], [1, 1, 0], [1, 1, 0]], False),  # a point
    ],
)
def test_faces_without_a_common_vertex(points, crossing):
    assert with_floor(*points) == ([[0, 1]] if crossing else [])
    assert pairs([*points, *FLOOR], [[2, 0, 1], [5, 4, 3]]) == ([[0, 1]] if crossing else [])


@over(
    ("points", "crossing"),
    [
        ([[1, 1, -1], [1, 1, 1]], True),
        ([[1, 1, 0], [1, 1, 1]], True),
        ([[1, 1, 1], [1, 2, 1]], False),
        ([[-1, -1, -1], [-1, -1, 1]], False),
        ([[9, 9, -1], [9, 9, 1]], True),  # a side of the floor goes through the face
        ([[-4, 0, 0], [0, -4, 0]], False),
        ([[1, 2, 0], [2, 1, 0]], False),
    ],
)
def test_faces_with_one_common_vertex(points, crossing):
    assert with_floor(*points, faces=[(0, 3, 4)]) == ([[0, 1]] if crossing else [])
    assert with_floor(*points, faces=[(4, 3, 0)]) == ([[0, 1]] if crossing else [])


def test_neighbours_never_cross_however_they_are_folded():
    for apex in ([1, 1, 0], [0, 4, 0], [1, 1, 1e-9], [1, 1, 2]):
        assert with_floor(apex, faces=[(1, 0, 3)]) == []


def test_a_face_that_is_there_twice_crosses_itself_and_one_that_names_a_vertex_twice_does_nothing():
    assert with_floor(faces=[(1, 2, 0)]) == [[0, 1]]
    assert with_floor(faces=[(2, 1, 0)]) == [[0, 1]]
    assert with_floor([1, 1, -1], [1, 1, 1], faces=[(3, 4, 4), (0, 0, 1)]) == []


def test_linked_tetrahedra_cross_and_distant_ones_do_not():
    mesh = tetrahedron()
    for offset, expected in ((1.0, True), (5.0, False)):
        verts = np.concatenate([mesh.verts, mesh.verts + np.array([offset, 0, 0])])
        faces = np.concatenate([mesh.faces, mesh.faces + 4])
        found = pairs(verts, faces)
        assert found == exactly(verts, faces)
        assert bool(found) is expected
        assert all(i < 4 <= j for i, j in found)


def test_nothing_crosses_where_there_is_nothing():
    assert pairs(np.empty((0, 3)), np.empty((0, 3), dtype=int)) == []
    assert pairs(FLOOR, np.empty((0, 3), dtype=int)) == []
    assert intersecting_faces(torch.zeros(3, 3), torch.zeros(0, 3, dtype=torch.int64)).shape == (0,)
    assert pairs(FLOOR, [[0, 1, 2]]) == []


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_faces_that_are_not_finite_are_in_no_pair(bad):
    piercing = [[1, 1, -1], [1, 1, 1], [9, 9, 0]]
    assert with_floor(*piercing, [1, bad, 1], faces=[(3, 4, 5), (3, 4, 6)]) == [[0, 1]]


def test_a_vertex_far_away_is_survived():
    verts, faces = tensors(sphere(3))
    for far in (1e3, 1e9, 1e40):
        verts[0] = far
        intersecting_pairs(verts, faces)
    assert intersecting_pairs(verts * 0, faces).tolist() == []
    flat = verts.clone()
    flat[:, 2] = 0
    intersecting_pairs(flat, faces)


SAFE = {"icosahedron": icosahedron, "octahedron": octahedron, "cube": cube, "bumpy": bumpy, "sphere": lambda: sphere(1)}


@pytest.mark.parametrize("shape", SAFE)
@over("dtype", [torch.float32, torch.float64])
def test_children_in_the_planes_of_their_parents_do_not_cross(shape, dtype):
    for levels in (1, 2, 3):
        verts, faces = tensors(subdivide(SAFE[shape](), "midpoint", levels), torch.float64)
        turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(levels)).double())[0]
        for moved in (verts, verts @ turn, verts @ turn * 1e-3, verts @ turn + 5):
            assert intersecting_pairs(moved.to(dtype), faces).tolist() == []


def test_targets_without_crossings_have_children_without():
    for mesh in (load_target("mousehead"), load_target("bone")):
        assert not intersecting_faces(*tensors(mesh)).any()
    assert not intersecting_faces(*tensors(subdivide(load_target("bone"), "midpoint", 1), torch.float32)).any()


def reported(mesh):
    return torch.tensor(self_intersecting_faces(mesh)), intersecting_faces(*tensors(mesh))


def test_the_cow_is_as_meshlab_has_it():
    theirs, ours = reported(load_target("cow"))
    assert int(theirs.sum()) == 89
    assert torch.equal(theirs, ours)


@pytest.mark.parametrize("noise", [0.1, 0.25, 0.35, 0.5, 1.0])
@over("levels", [2, 3, 4])
def test_shaken_spheres_are_as_meshlab_has_them(levels, noise):
    theirs, ours = reported(shaken(levels, noise))
    assert not (theirs & ~ours).any()
    assert int(ours.sum()) <= 1.01 * int(theirs.sum())


@pytest.mark.parametrize("shift", [0.1, 0.55, 1.3])
def test_faces_of_very_different_sizes_are_as_meshlab_has_them(shift):
    small, large = sphere(4), icosahedron()
    verts = np.concatenate([0.1 * small.verts + [shift, 0.02, 0.01], large.verts, [[-50, -50, 0], [50, -50, 0.01]]])
    faces = np.concatenate([small.faces, large.faces + small.num_verts, [[0, len(verts) - 2, len(verts) - 1]]])
    theirs, ours = reported(Mesh(verts, faces))
    assert theirs.any() == (shift < 1)
    assert torch.equal(theirs, ours)


@over("seed", range(4))
def test_soups_are_as_exact_arithmetic_has_them(seed):
    verts, faces = soup(seed)
    verts[:, 0] *= [1, 1, 5, 0.2][seed % 4]
    expected = exactly(verts, faces)
    assert len(expected) > 10
    assert pairs(verts, faces) == expected


@pytest.mark.parametrize("noise", [0.2, pytest.param(2.0, marks=pytest.mark.slow)])
def test_small_shaken_spheres_are_as_exact_arithmetic_has_them(noise):
    mesh = shaken(1, noise)
    assert pairs(mesh.verts, mesh.faces) == exactly(mesh.verts, mesh.faces)


@pytest.mark.parametrize("turns", [1, 2, 3])
@over("sectors", [11, 16])
def test_fans_that_go_around_more_than_once_cross_themselves(sectors, turns):
    angles = 2 * np.pi * turns * np.arange(sectors) / sectors
    rim = np.stack([np.cos(angles), np.sin(angles), 0.2 * np.cos(angles / turns + 0.1)], axis=1)
    faces = [[0, 1 + k, 1 + (k + 1) % sectors] for k in range(sectors)]
    found = pairs([[0.0, 0, 0], *rim], faces)
    assert found == exactly([[0.0, 0, 0], *rim], faces)
    assert bool(found) == (turns > 1)


def test_fans_that_meet_at_a_vertex_only_are_tested_with_each_other():
    rim = [[np.cos(a), np.sin(a), 0.3] for a in np.arange(6)]
    tilted = [[x, 0.8 * y - 0.6 * z, 0.8 * z + 0.6 * y] for x, y, z in rim]
    faces = [[0, first + k, first + (k + 1) % 6] for first in (1, 7) for k in range(6)]
    found = pairs([[0.0, 0, 0], *rim, *tilted], faces)
    assert found == exactly([[0.0, 0, 0], *rim, *tilted], faces)
    assert found


def test_order_of_faces_verts_and_corners_do_not_matter():
    verts, faces = tensors(shaken(3, 0.4))
    expected = intersecting_faces(verts, faces)
    assert 50 < int(expected.sum()) < 500
    generator = torch.Generator().manual_seed(1)
    order = torch.randperm(len(faces), generator=generator)
    assert torch.equal(intersecting_faces(verts, faces[order]), expected[order])
    labels = torch.randperm(len(verts), generator=generator)
    assert torch.equal(intersecting_faces(verts[labels.argsort()], labels[faces]), expected)
    assert torch.equal(intersecting_faces(verts, faces.roll(1, 1)), expected)
    assert torch.equal(intersecting_faces(verts, faces.flip(1)), expected)
    turned = torch.where((torch.arange(len(faces)) % 3 == 0)[:, None], faces.flip(1), faces)
    assert torch.equal(intersecting_faces(verts, turned), expected)


@over(
    "move",
    [
        lambda verts: verts + 1e3,
        lambda verts: verts - torch.tensor([0.0, 7.0, 1e3]),
        lambda verts: verts * 1e-3,
        lambda verts: verts * 1e3,
        lambda verts: verts * 1e-12,
        lambda verts: verts[:, [2, 0, 1]],
        lambda verts: -verts,
        lambda verts: verts.float(),
        lambda verts: verts.float() * 1e-3,
        lambda verts: (verts + 4).float(),
    ],
)
def test_place_scale_axes_and_precision_do_not_matter(move):
    verts, faces = tensors(shaken(3, 0.4))
    assert torch.equal(intersecting_faces(move(verts), faces), intersecting_faces(verts, faces))


def test_members_are_each_as_alone_wherever_they_are():
    meshes = [load_target("cow"), shaken(3, 0.4), sphere(2), shaken(2, 0.5)]
    alone = [intersecting_faces(*tensors(mesh)) for mesh in meshes]
    sizes = torch.tensor([mesh.num_faces for mesh in meshes])
    shifts = np.cumsum([0] + [mesh.num_verts for mesh in meshes])
    verts = torch.tensor(np.concatenate([mesh.verts for mesh in meshes]))
    faces = torch.tensor(np.concatenate([mesh.faces + shift for mesh, shift in zip(meshes, shifts, strict=False)]))
    members = torch.repeat_interleave(sizes)
    assert torch.equal(intersecting_faces(verts, faces, members), torch.cat(alone))
    assert torch.equal(intersecting_faces(verts, faces, 512 * members), torch.cat(alone))
    order = torch.randperm(len(faces), generator=torch.Generator().manual_seed(0))
    assert torch.equal(intersecting_faces(verts, faces[order], members[order]), torch.cat(alone)[order])
    assert int(intersecting_faces(verts, faces).sum()) > int(torch.cat(alone).sum())


def test_pairs_are_sorted_and_each_is_there_once():
    verts, faces = tensors(shaken(3, 1.0))
    found = intersecting_pairs(verts, faces)
    assert found.dtype == torch.int64
    assert (found[:, 0] < found[:, 1]).all()
    assert found.tolist() == sorted([i, j] for i, j in {tuple(pair) for pair in found.tolist()})
    assert torch.equal(found, intersecting_pairs(verts.requires_grad_(), faces))


@pytest.mark.parametrize("block", [1, 500, 1 << 20])
@pytest.mark.parametrize("spread", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_overlapping_boxes_are_all_found(monkeypatch, block, spread, seed):
    """Against all pairs, for boxes of one size or of sizes that differ by orders of magnitude."""
    monkeypatch.setattr(overlaps, "_BLOCK", block)
    generator = torch.Generator().manual_seed(seed)
    low = torch.rand(300, 3, generator=generator, dtype=torch.float64)
    size = 0.05 * torch.exp(spread * torch.randn(300, 1, generator=generator, dtype=torch.float64))
    high = low + size * torch.rand(300, 3, generator=generator, dtype=torch.float64)
    members = torch.randint(0, 2, (300,), generator=generator)
    meet = ((low[:, None] <= high) & (low <= high[:, None])).all(2) & (members[:, None] == members)
    expected = {tuple(pair) for pair in meet.triu(1).nonzero().tolist()}
    found = [
        pair for i, j in overlapping_boxes(low, high, members) for pair in zip(i.tolist(), j.tolist(), strict=True)
    ]
    assert {tuple(sorted(pair)) for pair in found} == expected
    assert len(found) == len(expected)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5])
@over("seed", [0, 1])
def test_looking_only_among_some_faces_finds_all_pairs_with_one_of_them(share, seed):
    generator = torch.Generator().manual_seed(seed)
    verts, faces = tensors(subdivide(load_target("bone"), "midpoint", 0))
    verts = verts + 0.1 * verts.std() * torch.randn(verts.shape, generator=generator, dtype=verts.dtype)
    members = (torch.arange(len(faces)) % 2) * (seed > 0)
    among = torch.rand(len(faces), generator=generator) < share
    everywhere = intersecting_pairs(verts, faces, members)
    assert len(everywhere) > 100
    expected = everywhere[among[everywhere].any(1)]
    assert torch.equal(intersecting_pairs(verts, faces, members, among), expected)


@pytest.mark.parametrize("size", [0.0, 0.03, 0.4])
def test_boxes_near_some_are_all_that_meet_them_and_few_that_are_far(size):
    generator = torch.Generator().manual_seed(2)
    low = torch.rand(800, 3, generator=generator, dtype=torch.float64)
    high = low + size * torch.rand(800, 3, generator=generator, dtype=torch.float64)
    some = torch.rand(800, generator=generator) < 0.02
    apart = torch.maximum(low[:, None] - high[some], low[some] - high[:, None]).amax(2)
    found = boxes_near(low, high, some)
    assert bool(found[(apart <= 0).any(1)].all())
    assert not bool(found[(apart > (1 + size) * 1.01 / 32).all(1)].any())
    assert not bool(boxes_near(low, high, torch.zeros_like(some)).any())
