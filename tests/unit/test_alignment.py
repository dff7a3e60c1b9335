"""Alignment: each method undoes the transformation it is made for."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from meshfit.errors import MeshError
from meshfit.fitting.registration.alignment import align
from meshfit.fitting.registration.pose_search import rotation_grid
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mismatch import boxes_are_disjoint, describe_mismatch
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.solids import icosahedron, octahedron
from meshfit.subdivision.refine import subdivide
from tests.loops import over


def pear():
    """Without symmetry: three axes of different lengths, and thicker at one end of each."""
    verts = subdivide(icosahedron(), "loop", 3).verts
    verts = verts / np.linalg.norm(verts, axis=1, keepdims=True)
    return Mesh(
        verts * np.array([3.0, 1.8, 1.0]) * (1 + 0.3 * verts[:, [1, 2, 0]]), subdivide(icosahedron(), "loop", 3).faces
    )


def moved(mesh, angle, scale=1.0, shift=(0.0, 0.0, 0.0)):
    turn = Rotation.from_rotvec(angle * np.array([0.36, 0.48, 0.8]))
    return Mesh(turn.apply(np.array(mesh.verts)) * scale + np.array(shift), mesh.faces)


def test_none_leaves_it_where_it_is():
    source = pear()
    assert align(source, moved(source, 1.0), "none").mesh is source


def test_center_takes_back_a_shift_and_nothing_else():
    source = pear()
    found = align(moved(source, 0.0, shift=(3, -4, 5)), source, "center").mesh
    np.testing.assert_allclose(found.verts, source.verts, atol=1e-9)


@over("stretch", [(1.0, 1.0, 1.0), (2.0, 0.5, 3.0)])
def test_box_stretches_the_source_into_the_box_of_the_target(stretch):
    source = pear()
    target = Mesh(source.verts * np.array(stretch) + [7, 8, -9], source.faces)
    np.testing.assert_allclose(align(source, target, "box").mesh.verts, target.verts, atol=1e-9)
    flat = Mesh(source.verts * [1, 1, 0], source.faces)
    assert np.ptp(align(flat, target, "box").mesh.verts, axis=0)[2] == 0


@over(("angle", "scale"), [(1.5, 0.01), (3.0, 30.0)])
def test_pca_takes_back_turn_scale_and_shift(angle, scale):
    source = pear()
    found = align(moved(source, angle, scale, (7, 8, -9)), source, "pca")
    np.testing.assert_allclose(found.mesh.verts, source.verts, atol=1e-6)
    assert found.turn == pytest.approx(np.degrees(angle), abs=1e-3)
    assert found.scale == pytest.approx(1 / scale)
    assert not found.doubt


def test_icp_ends_nearer_to_a_bent_shape_than_the_axes_do():
    source = pear()
    bent = Mesh(source.verts + np.array([0, 0.01, 0.02]) * source.verts[:, :1] ** 2, source.faces)
    nearest = cKDTree(bent.verts)
    by_axes, by_points = (
        nearest.query(align(moved(source, 1.0, 2.0), bent, how).mesh.verts)[0].mean() for how in ("pca", "icp")
    )
    assert by_points < by_axes


def part(mesh, direction, share):
    """The faces farthest in a direction, as a scan from there shows them."""
    heights = mesh.verts[mesh.faces].mean(axis=1) @ np.array(direction)
    faces = mesh.faces[heights >= np.quantile(heights, 1 - share)]
    used, numbers = np.unique(faces, return_inverse=True)
    return Mesh(mesh.verts[used], numbers.reshape(-1, 3))


def farthest_off(found, truth):
    """The largest distance of a vertex from where it belongs, relative to the diagonal of the box."""
    apart = np.linalg.norm(found.verts - truth.verts, axis=1).max()
    return apart / np.linalg.norm(np.ptp(truth.verts, axis=0))


def test_a_turned_and_scaled_source_finds_its_place_on_half_of_its_surface():
    whole = pear()
    found = align(moved(whole, 2.0, 1.3, (2, -3, 1)), part(whole, (0.5, 1.0, 0.3), 0.5), "icp")
    assert farthest_off(found.mesh, whole) < 0.01
    assert found.scale == pytest.approx(1 / 1.3, rel=0.02)
    assert not found.doubt


@pytest.mark.slow
def test_principal_axes_are_those_of_the_shared_parts():
    whole = pear()
    found = align(moved(whole, 2.0, 1.3, (2, -3, 1)), part(whole, (0.5, 1.0, 0.3), 0.5), "pca")
    assert farthest_off(found.mesh, whole) < 0.06


@pytest.mark.slow
def test_half_of_a_turned_source_finds_its_place_on_the_whole_points():
    whole = pear()
    half = part(whole, (0.0, 1.0, 0.2), 0.5)
    found = align(moved(half, 2.5, 1.0, (2, -3, 1)), PointCloud(subdivide(whole, "midpoint", 1).verts), "icp")
    assert farthest_off(found.mesh, half) < 0.01


@pytest.mark.slow
def test_a_source_that_lies_on_a_partial_scan_already_is_not_turned_away():
    whole = pear()
    near = moved(whole, 0.03, 1.0, (0.02, 0.03, -0.01))
    given = farthest_off(near, whole)
    scan = part(whole, (0.5, 1.0, 0.3), 0.5)
    assert farthest_off(align(near, scan, "pca").mesh, whole) <= given
    by_points = align(near, scan, "icp")
    assert farthest_off(by_points.mesh, whole) < 0.2 * given
    assert by_points.turn == pytest.approx(np.degrees(0.03), abs=0.5)
    scan = PointCloud(part(whole, (1.0, 0.0, 0.0), 0.4).verts)
    assert farthest_off(align(near, scan, "icp").mesh, whole) < 0.5 * given


@pytest.mark.slow
def test_alignment_gives_the_same_bytes_each_time():
    whole, scan = pear(), PointCloud(part(pear(), (1.0, 0.0, 0.0), 0.4).verts)
    first, second = (align(moved(whole, 1.0), scan, "icp").mesh.verts.tobytes() for _ in range(2))
    assert first == second


def test_rotations_of_the_grid_leave_no_large_gap():
    grid = rotation_grid(300)
    np.testing.assert_allclose(np.linalg.det(grid), 1)
    queries = Rotation.random(500, random_state=0).as_matrix()
    traces = np.einsum("qij,gij->qg", queries, grid)
    nearest = np.degrees(np.arccos(np.clip((traces.max(axis=1) - 1) / 2, -1, 1)))
    assert nearest.max() < 35


def bilateral(bend):
    """A slab with two planes of symmetry, and a bend of the middle that a half turn about z keeps."""
    verts = subdivide(icosahedron(), "loop", 3).verts
    verts = verts / np.linalg.norm(verts, axis=1, keepdims=True) * np.array([3.0, 1.8, 1.0])
    return Mesh(verts + bend * np.outer(np.cos(verts[:, 0]), [0, 0, 1.0]), subdivide(icosahedron(), "loop", 3).faces)


def test_of_poses_that_symmetry_makes_equal_the_least_turn_is_taken_and_the_other_named():
    found = align(moved(bilateral(0.3), 0.2, 1.2), bilateral(0.4), "icp")
    assert found.turn < 30
    assert found.other_turn == pytest.approx(180, abs=5)
    assert f"another pose, turned from this one by {found.other_turn:.0f}°" in found.doubt


def test_boxes_with_nothing_in_common_are_apart():
    source = pear()
    assert not boxes_are_disjoint(source, moved(source, 0.0, shift=(5.9, 0, 0)))
    assert boxes_are_disjoint(source, moved(source, 0.0, shift=(9, 0, 0)))


def test_a_surface_without_extent_is_refused():
    point = Mesh(np.ones((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(MeshError, match="source: a surface without extent"):
        align(point, pear(), "pca")


def test_meshes_that_do_not_lie_on_each_other_are_told_apart_by_their_boxes():
    ball = subdivide(octahedron(), "loop", 1)
    flat = Mesh(ball.verts * [1.0, 1.0, 0.0], ball.faces)

    def at(x, scale=1.0, mesh=ball):
        return Mesh(mesh.verts * scale + [x, 0.0, 0.0], mesh.faces)

    width = float(np.ptp(ball.verts[:, 0]))
    for other in (ball, flat, at(0.5 * width), at(0.94 * width), at(0.0, 9.9), at(0.0, 0.11), at(0.4 * width, 0.2)):
        assert describe_mismatch(ball, other) == describe_mismatch(other, ball) == ""
    assert describe_mismatch(flat, at(0.0, mesh=flat)) == ""
    assert describe_mismatch(ball, at(0.0, 25.0)) == describe_mismatch(at(0.0, 25.0), ball) == "differ in size 25-fold"
    assert describe_mismatch(ball, at(0.96 * width)) == "hardly overlap"
    assert (
        describe_mismatch(ball, at(1.1 * width))
        == describe_mismatch(flat, at(1.1 * width, mesh=flat))
        == "do not overlap"
    )
    above = Mesh(flat.verts + np.array([0.0, 0.0, 0.5]), flat.faces)
    assert describe_mismatch(flat, above) == "do not overlap"
