"""Chamfer, F-score and normal consistency: known answers, and a brute-force oracle."""

import numpy as np
import pytest

from meshfit.errors import MeasureError
from meshfit.measuring.points import point_scores
from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.solids import SOLIDS, cube, octahedron
from tests.loops import over


def triangles(verts, faces):
    return Mesh(np.array(verts, dtype=np.float64), np.array(faces, dtype=np.int64))


SQUARE = triangles([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
COUNT = 3000
SPACING = 0.06  # no point of a unit square is farther from 3000 of them: exp(-3000π 0.06²) is 1e-15


def lifted(height):
    return Mesh(SQUARE.verts + np.array([0, 0, height]), SQUARE.faces)


def reversed_faces(mesh):
    return Mesh(mesh.verts, mesh.faces[:, ::-1])


def brute_force(result, target, count, tau, seed):
    """All pairs, in loops' clothing: no tree, no shared helper but the sampler."""
    streams = np.random.default_rng(seed).spawn(2)
    clouds = [sample_surface(mesh, count, stream) for mesh, stream in zip((result, target), streams, strict=True)]
    normals = [face_normals(mesh)[cloud.faces] for mesh, cloud in zip((result, target), clouds, strict=True)]
    pairs = np.linalg.norm(clouds[0].points[:, None] - clouds[1].points[None], axis=2)
    cosines = normals[0] @ normals[1].T
    rows, columns = np.arange(count), np.arange(count)
    forward, backward = pairs.min(axis=1), pairs.min(axis=0)
    along, against = cosines[rows, pairs.argmin(axis=1)], cosines[pairs.argmin(axis=0), columns]
    precision, recall = (forward <= tau).mean(), (backward <= tau).mean()
    return {
        "l1": forward.mean() + backward.mean(),
        "l2_squared": (forward**2).mean() + (backward**2).mean(),
        "precision": precision,
        "recall": recall,
        "f1": 2 * precision * recall / (precision + recall),
        "signed": (along.mean() + against.mean()) / 2,
        "absolute": (abs(along).mean() + abs(against).mean()) / 2,
    }


@over("seed", range(3))
def test_every_score_agrees_with_brute_force(seed):
    generator = np.random.default_rng(seed)
    meshes = [
        Mesh(mesh.verts + generator.normal(size=mesh.verts.shape) * 0.2, mesh.faces) for mesh in (cube(), octahedron())
    ]
    found = point_scores(*meshes, 400, 0.15, seed)
    flat = {name: value for group in found for name, value in vars(group).items()}
    for name, value in brute_force(*meshes, 400, 0.15, seed).items():
        assert flat[name] == pytest.approx(value, rel=1e-12), name
    assert (flat["points"], flat["tau"]) == (400, 0.15)


def test_lifted_square_has_its_height_in_both_directions():
    height = 2.0
    chamfer, _, _ = point_scores(lifted(height), SQUARE, COUNT, 0.01, 0)
    assert 2 * height <= chamfer.l1 <= 2 * np.hypot(height, SPACING)
    assert 2 * height**2 <= chamfer.l2_squared <= 2 * (height**2 + SPACING**2)


@over(("tau", "score"), [(0.4999, 0.0), (np.hypot(0.5, SPACING), 1.0)])
def test_f_score_jumps_where_tau_passes_the_height(tau, score):
    found = point_scores(lifted(0.5), SQUARE, COUNT, tau, 0)[1]
    assert (found.precision, found.recall, found.f1) == (score, score, score)


def test_precision_is_the_results_and_recall_the_targets():
    """Half of a square matches all of itself and half of the whole, but for a strip of width tau."""
    left = triangles([[0, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [0, 1, 0]], SQUARE.faces)
    tau = SPACING
    found = point_scores(left, SQUARE, COUNT, tau, 0)[1]
    assert found.precision == 1.0
    assert 0.5 <= found.recall <= 0.5 + tau + 0.01
    assert found.f1 == pytest.approx(2 * found.recall / (1 + found.recall))
    swapped = point_scores(SQUARE, left, COUNT, tau, 0)[1]
    assert swapped.recall == 1.0
    assert swapped.precision == pytest.approx(found.recall, abs=0.03)


@over("mesh", [SQUARE, *(make() for make in SOLIDS.values())])
def test_a_mesh_inside_out_has_opposite_normals(mesh):
    """Exactly so on the flat square. Elsewhere other points are drawn, and the next side may be nearest."""
    same = point_scores(mesh, mesh, COUNT, 0.1, 0)[2]
    turned = point_scores(reversed_faces(mesh), mesh, COUNT, 0.1, 0)[2]
    assert turned.signed == pytest.approx(-same.signed, rel=0.02)
    assert turned.absolute == pytest.approx(same.absolute, rel=0.02)
    if mesh is SQUARE:
        assert (same.signed, same.absolute) == (pytest.approx(1), pytest.approx(1))
        assert (turned.signed, turned.absolute) == (pytest.approx(-1), pytest.approx(1))


def test_perpendicular_squares_have_no_normal_consistency():
    upright = Mesh(SQUARE.verts[:, [2, 0, 1]], SQUARE.faces)
    found = point_scores(upright, SQUARE, COUNT, 0.1, 0)[2]
    assert (found.signed, found.absolute) == (pytest.approx(0), pytest.approx(0))


def test_chamfer_scales_with_the_meshes():
    one = point_scores(octahedron(), cube(), COUNT, 0.1, 0)[0]
    tenfold = (Mesh(10 * solid.verts, solid.faces) for solid in (octahedron(), cube()))
    ten = point_scores(*tenfold, COUNT, 1.0, 0)[0]
    assert ten.l1 == pytest.approx(10 * one.l1)
    assert ten.l2_squared == pytest.approx(100 * one.l2_squared)


def test_identical_meshes_are_half_a_spacing_apart():
    """Mean nearest-neighbour distance of N random points on unit area is 1 / (2 √N) (Clark and Evans 1954)."""
    chamfer, f_score, _ = point_scores(SQUARE, SQUARE, COUNT, 0.1, 0)
    assert chamfer.l1 / 2 == pytest.approx(0.5 / np.sqrt(COUNT), rel=0.1)
    assert f_score.f1 == 1.0


def test_scores_repeat_to_the_bit():
    assert point_scores(octahedron(), cube(), COUNT, 0.1, 5) == point_scores(octahedron(), cube(), COUNT, 0.1, 5)
    assert point_scores(octahedron(), cube(), COUNT, 0.1, 5) != point_scores(octahedron(), cube(), COUNT, 0.1, 6)


def test_a_mesh_without_a_surface_is_refused():
    with pytest.raises(MeasureError, match="the target has 4 vertices and no faces"):
        point_scores(SQUARE, Mesh(SQUARE.verts, np.empty((0, 3), dtype=int)), COUNT, 0.1, 0)
