"""Remeshing: a sound surface of the same topology and place, with the target edge lengths."""

import math
from functools import cache

import numpy as np
import pytest
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from meshfit.errors import MeshError
from meshfit.measuring.quality import degenerate_faces, flipped_faces, mesh_quality
from meshfit.mesh.geometry import bounding_box_diagonal, corner_angles, face_areas
from meshfit.mesh.manifold import euler_number, num_components, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.solids import icosahedron, tetrahedron
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from meshfit.remeshing.collapse import collapse
from meshfit.remeshing.connectivity import Edges
from meshfit.remeshing.flip import flip
from meshfit.remeshing.relax import relax
from meshfit.remeshing.remesh import remesh
from meshfit.remeshing.sizing import limit_gradation, num_verts_for
from meshfit.remeshing.split import split
from meshfit.remeshing.state import RemeshState
from meshfit.subdivision.refine import subdivide
from tests.shapes import patch, torus


@cache
def sphere(levels):
    mesh = subdivide(icosahedron(), "midpoint", levels)
    return Mesh(mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


@cache
def target(name, faces):
    return decimate(load_target(name), faces)


def hemisphere():
    """One boundary loop, in a zigzag."""
    ball = sphere(3)
    inside = (ball.verts[ball.faces][:, :, 2] > 0.1).all(axis=1)
    used, faces = np.unique(ball.faces[inside], return_inverse=True)
    return Mesh(ball.verts[used], faces.reshape(-1, 3))


def band():
    """A cylinder without lids: two boundary loops, Euler number 0."""
    ring, steps = 24, 9
    turn = 2 * np.pi * np.arange(ring) / ring
    rows = [np.stack([np.cos(turn), np.sin(turn), np.full(ring, 0.25 * step)], axis=1) for step in range(steps)]
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(ring), np.arange(steps - 1)))
    a, b, up = j * ring + i, j * ring + (i + 1) % ring, ring
    faces = np.concatenate([np.stack([a, b, b + up], axis=1), np.stack([a, b + up, a + up], axis=1)])
    return Mesh(np.concatenate(rows), faces)


def tube():
    """A capsule 20 times as long as it is wide."""
    ball = sphere(3)
    x, y, z = ball.verts.T
    widen = 0.05 * np.sqrt(1 - z.clip(-1, 1) ** 8) / np.hypot(x, y).clip(1e-9)
    return Mesh(np.stack([x * widen, y * widen, z], axis=1), ball.faces)


def two_balls():
    ball = sphere(2)
    return Mesh(np.concatenate([ball.verts, ball.verts + 3]), np.concatenate([ball.faces, ball.faces + ball.num_verts]))


def noisy():
    ball = sphere(3)
    return Mesh(ball.verts * (1 + 0.02 * np.random.default_rng(0).standard_normal((ball.num_verts, 1))), ball.faces)


def tensors(mesh, dtype=torch.float64):
    return torch.tensor(mesh.verts, dtype=dtype), torch.tensor(mesh.faces)


def mean_length(mesh):
    """The length of edges of as many verts as there are."""
    return math.sqrt(face_areas(mesh).sum() / (math.sqrt(3) / 2 * mesh.num_verts))


def graded(mesh, length, ratio):
    x = mesh.verts[:, 0]
    return length * ratio ** ((x - x.min()) / np.ptp(x) - 0.5)


def remeshed(mesh, lengths, dtype=torch.float64, **options):
    verts, faces = tensors(mesh, dtype)
    lengths = torch.as_tensor(lengths, dtype=dtype).expand(len(verts)).clone()
    return remesh(verts, faces, lengths, **options)


def as_mesh(verts, faces):
    return Mesh(verts.double().numpy(), faces.numpy())


def num_loops(topology):
    on_boundary = np.flatnonzero(topology.boundary_verts)
    after = topology.boundary_neighbours[on_boundary, 1]
    graph = coo_array((np.ones(len(after)), (on_boundary, after)), shape=(topology.num_verts,) * 2)
    return connected_components(graph, directed=False)[0] - topology.num_verts + len(on_boundary)


def facts(mesh):
    topology = Topology.of(mesh)
    return euler_number(topology), num_components(topology), num_loops(topology)


def assert_sound(mesh, before):
    topology = Topology.of(mesh)
    require_manifold(topology, "the test")
    assert facts(mesh) == facts(before)
    assert (topology.valence > 0).all()
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == mesh.num_faces
    assert not degenerate_faces(mesh).any()
    assert not flipped_faces(mesh, topology).any()


def volume(mesh):
    return np.linalg.det(mesh.verts[mesh.faces]).sum() / 6


CASES = {
    "as it is": (lambda: sphere(3), 1.0, 1),
    "finer": (lambda: sphere(2), 0.4, 1),
    "coarser": (lambda: sphere(3), 1.9, 1),
    "graded": (lambda: sphere(3), 1.0, 5),
    "noisy": (noisy, 1.0, 1),
    "torus": (lambda: torus(48, 16), 1.2, 1),
    "tube": (tube, 0.5, 1),
    "two balls": (two_balls, 0.8, 2),
    "hemisphere": (hemisphere, 0.7, 1),
    "hemisphere, coarser": (hemisphere, 1.5, 2),
    "band": (band, 0.8, 2),
    "patch": (lambda: patch(12, 10), 0.6, 3),
    "mousehead": (lambda: target("mousehead", 1500), 1.0, 4),
    "airplane": (lambda: target("airplane", 1500), 0.8, 1),
    "bone": (lambda: target("bone", 1500), 1.3, 4),
}


QUICK = ("finer", "coarser", "graded", "torus", "hemisphere", "band", "patch")


@pytest.mark.parametrize(
    "case", [case if case in QUICK else pytest.param(case, marks=pytest.mark.slow) for case in CASES]
)
def test_sound_and_of_the_lengths_wanted(case):
    make, scale, ratio = CASES[case]
    mesh = make()
    lengths = graded(mesh, scale * mean_length(mesh), ratio)
    verts, faces, carried = remeshed(mesh, lengths)
    result = as_mesh(verts, faces)
    assert_sound(result, mesh)
    angles = np.degrees(corner_angles(result).min(axis=1))
    assert angles.min() > 10
    assert np.quantile(angles, 0.01) > 20
    assert angles.mean() > 45
    expected = num_verts_for(*tensors(mesh), torch.tensor(lengths))
    assert len(verts) == pytest.approx(expected, rel=0.08)
    edges = Topology.of(result).edges
    share = np.linalg.norm(np.diff(result.verts[edges], axis=1)[:, 0], axis=1) / carried.numpy()[edges].mean(axis=1)
    assert share.mean() == pytest.approx(1.015, abs=0.05)
    assert np.quantile(share, 0.05) > 0.7
    assert np.quantile(share, 0.95) < 1.35


@pytest.mark.parametrize("name", [pytest.param("bunny", marks=pytest.mark.slow), "mousehead"])
def test_stays_where_it_is(name):
    mesh = target(name, 6000)
    diagonal = bounding_box_diagonal(mesh.verts)
    verts, faces, _ = remeshed(mesh, diagonal / 50)
    result = as_mesh(verts, faces)
    assert volume(result) == pytest.approx(volume(mesh), rel=0.005)
    for one, other in ((mesh, result), (result, mesh)):
        distances = point_distances(other, one.verts)
        assert distances.mean() < 0.002 * diagonal
        assert distances.max() < 0.015 * diagonal
    assert mesh_quality(result).self_intersecting_faces == 0


def test_leaves_alone_what_is_as_wanted():
    ball = sphere(2)
    verts, faces, _ = remeshed(ball, mean_length(ball))
    assert torch.equal(faces, torch.tensor(ball.faces))
    assert np.abs(verts.numpy() - ball.verts).max() < 0.02


def test_flat_patch_keeps_its_outline():
    mesh = patch(12, 10)
    verts, faces, _ = remeshed(mesh, 0.7)
    assert verts[:, 2].abs().max() == 0
    assert face_areas(as_mesh(verts, faces)).sum() == pytest.approx(face_areas(mesh).sum())


def test_the_same_each_time():
    mesh = target("mousehead", 1500)
    lengths = graded(mesh, mean_length(mesh), 4)
    one, other = remeshed(mesh, lengths), remeshed(mesh, lengths)
    assert [part.numpy().tobytes() for part in one] == [part.numpy().tobytes() for part in other]


def test_single_precision():
    mesh = target("mousehead", 1500)
    verts, faces, lengths = remeshed(mesh, mean_length(mesh), torch.float32)
    assert (verts.dtype, faces.dtype, lengths.dtype) == (torch.float32, torch.int64, torch.float32)
    result = as_mesh(verts, faces)
    assert_sound(result, mesh)
    assert np.degrees(corner_angles(result)).min() > 20
    assert len(verts) == pytest.approx(mesh.num_verts, rel=0.08)


def test_lengths_stay_in_place():
    mesh = sphere(3)
    length = mean_length(mesh)
    verts, _, lengths = remeshed(mesh, length * (1 + 0.3 * mesh.verts[:, 0]))
    assert np.abs(lengths.numpy() / length - (1 + 0.3 * verts.numpy()[:, 0])).max() < 0.05


def test_coarse_to_the_end():
    verts, faces, _ = remeshed(sphere(2), 5.0)
    assert len(verts) < 12
    assert_sound(as_mesh(verts, faces), sphere(2))


def test_a_rim_thinner_than_the_mesh_is_fine():
    ball = sphere(4)
    mesh = Mesh(ball.verts * np.array([3, 1, 0.15]), ball.faces)
    verts, faces, _ = remeshed(mesh, 0.12)
    result = as_mesh(verts, faces)
    assert_sound(result, mesh)
    assert np.degrees(corner_angles(result)).min() > 10


def test_unused_verts_are_left_out():
    ball = sphere(1)
    verts, faces = tensors(Mesh(np.concatenate([[[9, 9, 9]], ball.verts]), ball.faces + 1))
    result, _, _ = remesh(verts, faces, torch.full((len(verts),), mean_length(ball), dtype=torch.float64))
    assert result.abs().max() < 2


def test_no_rounds():
    verts, faces, _ = remeshed(sphere(1), 0.1, rounds=0)
    assert torch.equal(verts, tensors(sphere(1))[0])
    assert torch.equal(faces, tensors(sphere(1))[1])


@pytest.mark.parametrize(
    ("verts", "faces", "length", "fault"),
    [
        ([[0, 0, 0]] * 3, np.empty((0, 3)), 1.0, "none"),
        (np.eye(3), [[0, 1, 2]], 0.0, "lengths"),
        (np.eye(3), [[0, 1, 2]], np.nan, "lengths"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], 1.0, "positions"),
        (np.eye(5, 3), [[0, 1, 2], [1, 0, 3], [0, 1, 4]], 1.0, "more than 2"),
    ],
)
def test_refusals(verts, faces, length, fault):
    with pytest.raises(MeshError, match=fault):
        remeshed(Mesh(verts, faces), length)


def moving(mesh, length=1.0):
    verts, faces = tensors(mesh)
    return RemeshState(verts, faces, torch.full((len(verts),), length, dtype=torch.float64))


def test_edges_agree_with_the_topology():
    for mesh in (sphere(1), hemisphere(), band()):
        topology, edges = Topology.of(mesh), Edges.of(torch.tensor(mesh.faces), mesh.num_verts)
        ends = torch.stack([edges.tail, edges.head], 1).sort(1).values
        np.testing.assert_array_equal(ends, topology.edges)
        np.testing.assert_array_equal(edges.of_side.view(-1), topology.edge_of)
        np.testing.assert_array_equal(edges.valence, topology.valence)
        np.testing.assert_array_equal(edges.on_boundary, topology.boundary_verts)
        np.testing.assert_array_equal(~edges.inner, topology.boundary_edges)
        np.testing.assert_array_equal(edges.left_apex, topology.apex[edges.left])
        inner = edges.inner
        np.testing.assert_array_equal(edges.right[inner], topology.twin[edges.left[inner]])
        np.testing.assert_array_equal(edges.right_apex[inner], topology.apex[edges.right[inner]])


@pytest.mark.parametrize("width", [0.5, 1.2, 3.0])
def test_splits_keep_the_surface(width):
    corners = [[0, 0, 0], [width, 0, 0], [0.4, 1.1, 0], [width, 1.6, 0]]
    after = split(moving(Mesh(corners, [[0, 1, 2], [2, 1, 3]])), 1.0)
    mesh = as_mesh(after.verts, after.faces)
    assert_sound(mesh, Mesh(corners, [[0, 1, 2], [2, 1, 3]]))
    assert face_areas(mesh).sum() == pytest.approx(face_areas(Mesh(corners, [[0, 1, 2], [2, 1, 3]])).sum())


def test_splits_no_more_than_allowed():
    before = moving(sphere(1), 0.1)
    assert len(split(before, 4 / 3, 7).verts) == len(before.verts) + 7


def test_collapses_no_more_than_allowed():
    before = moving(sphere(2), 1.0)
    assert len(collapse(before, 0.8, 4 / 3, 5).verts) == len(before.verts) - 5


def test_tetrahedron_is_not_collapsed():
    assert len(collapse(moving(tetrahedron(), 100.0), 0.8, 4 / 3).verts) == 4


def test_collapse_would_close_the_hole():
    """A torus three faces around: edges around the hole have a common neighbour that no face joins."""
    mesh = torus(3, 12)
    verts, faces, _ = remeshed(mesh, 50.0)
    result = as_mesh(verts, faces)
    require_manifold(Topology.of(result), "the test")
    assert facts(result) == facts(mesh)


def test_flip_turns_the_longer_diagonal():
    corners = [[0, 0, 0], [2, 0, 0], [1, 0.5, 0], [1, -0.5, 0], [3, 2, 0], [3, -2, 0], [-1, 2, 0], [-1, -2, 0]]
    faces = [[0, 1, 2], [1, 0, 3], [2, 1, 4], [1, 3, 5], [0, 2, 6], [3, 0, 7]]
    edges = Edges.of(flip(moving(Mesh(corners, faces))).faces, len(corners))
    assert not edges.have(torch.tensor([0]), torch.tensor([1])).item()
    assert edges.have(torch.tensor([2]), torch.tensor([3])).item()


def test_flip_leaves_a_ridge():
    corners = [[0, 0, 0], [2, 0, 0], [1, 0.5, 0.5], [1, -0.5, 0.5]]
    before = moving(Mesh(corners, [[0, 1, 2], [1, 0, 3]]))
    assert torch.equal(flip(before).faces, before.faces)


def test_relaxing_keeps_the_boundary_and_the_plane():
    mesh = patch(8, 8)
    verts = mesh.verts.copy()
    inside = ~Topology.of(mesh).boundary_verts
    verts[inside, :2] += np.random.default_rng(1).uniform(-0.3, 0.3, (inside.sum(), 2))
    before = moving(Mesh(verts, mesh.faces))
    after = relax(before).verts.numpy()
    np.testing.assert_array_equal(after[~inside], verts[~inside])
    assert not after[:, 2].any()
    assert np.abs(after - mesh.verts).sum() < 0.7 * np.abs(verts - mesh.verts).sum()


def test_relaxing_carries_a_linear_field():
    mesh = patch(8, 8)
    verts, faces = tensors(mesh)
    verts[:, :2] += 0.2 * torch.sin(3 * verts[:, [1, 0]])
    after = relax(RemeshState(verts, faces, 1 + 0.1 * verts[:, 0] + 0.05 * verts[:, 1]))
    wanted = 1 + 0.1 * after.verts[:, 0] + 0.05 * after.verts[:, 1]
    torch.testing.assert_close(after.lengths, wanted.clamp(after.lengths.min(), after.lengths.max()))


def test_limited_is_the_distance_to_what_is_small():
    mesh = patch(9, 8)
    verts, faces = tensors(mesh)
    lengths = torch.full((len(verts),), 3.0, dtype=torch.float64)
    lengths[0] = 0.5
    found = limit_gradation(lengths, verts, faces, 0.25)
    walk = mesh.verts[:, 0] + mesh.verts[:, 1]  # there are no diagonals that way
    np.testing.assert_allclose(found, np.minimum(0.5 + 0.25 * walk, 3.0))


def test_limited_leaves_what_is_gentle():
    verts, faces = tensors(sphere(2))
    lengths = 1 + 0.1 * verts[:, 0]
    assert torch.equal(limit_gradation(lengths, verts, faces, 0.2), lengths)
    assert torch.equal(limit_gradation(lengths, verts, faces, 0.0), torch.full_like(lengths, float(lengths.min())))
