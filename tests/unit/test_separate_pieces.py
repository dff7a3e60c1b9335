"""Separate pieces: floaters of a scan are found, named and left out; parts that belong together are one piece."""

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.separate_pieces import describe_floaters, kept_pieces, separate_pieces
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.loops import over

BALL = subdivide(octahedron(), "loop", 3)
BALL = Mesh(BALL.verts / np.linalg.norm(BALL.verts, axis=1, keepdims=True), BALL.faces)


def together(*parts):
    """Balls, given by radius and distance of the centre along x, as one mesh."""
    verts = [BALL.verts * radius + [x, 0.0, 0.0] for radius, x in parts]
    faces = [BALL.faces + number * BALL.num_verts for number in range(len(parts))]
    return Mesh(np.concatenate(verts), np.concatenate(faces))


@over("scale", [1.0, 1e-4, 200.0])
def test_floaters_are_named_and_left_out_in_any_unit(scale):
    scan = together((0.05, 4.0), (1.0, 0.0), (0.03, -6.0), (0.5, 2.2))
    scan = scan.with_verts(scan.verts * scale + 10 * scale)
    for target in (scan, PointCloud(scan.verts)):
        floaters = describe_floaters(target)
        assert floaters.startswith("2 small pieces far off the others (")
        for keep, balls in ((None, 4), (0.001, 3), (0.2, 2), ("largest", 1)):
            kept = kept_pieces(target, keep)
            assert kept.num_verts == balls * BALL.num_verts, keep
            assert (kept is target) == (keep is None)
        assert not describe_floaters(kept_pieces(target, 0.2))


def test_what_is_kept_of_a_mesh_has_its_faces():
    kept = kept_pieces(together((0.1, 4.0), (1.0, 0.0)), "largest")
    np.testing.assert_array_equal(kept.verts, BALL.verts)
    np.testing.assert_array_equal(kept.faces, BALL.faces)


@pytest.mark.parametrize(
    ("parts", "count"),
    [
        pytest.param([(1.0, 0.0), (0.5, 1.2)], 1, id="parts that cross"),
        pytest.param([(1.0, 0.0), (0.5, 1.505)], 1, id="parts that touch"),
        pytest.param([(1.0, 0.0), (0.9, 0.0)], 2, id="nested shells"),
        pytest.param([(1.0, 0.0), (0.5, 1.7)], 2, id="parts apart"),
    ],
)
def test_parts_near_each_other_are_one_piece(parts, count):
    assert len(separate_pieces(together(*parts)).sizes) == count
    assert not describe_floaters(together(*parts))


def test_a_soup_of_single_faces_is_one_piece():
    soup = Mesh(BALL.verts[BALL.faces].reshape(-1, 3), np.arange(3 * BALL.num_faces).reshape(-1, 3))
    assert len(separate_pieces(soup).sizes) == 1
    assert kept_pieces(soup, "largest") is soup


def test_a_cloud_of_uneven_density_is_one_piece():
    points = BALL.verts[np.random.default_rng(0).permutation(BALL.num_verts)[:60]]
    assert len(separate_pieces(PointCloud(points)).sizes) == 1
    assert kept_pieces(PointCloud(points[:4]), "largest").num_verts == 4
