"""Measures of results whose vertices are those of a source: vertex errors, stretch, new defects, partners."""

import csv
import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshfit.errors import MeasureError
from meshfit.measuring.correspondence import Correspondence, has_partner, unmatched
from meshfit.measuring.measure import measure
from meshfit.measuring.metrics import CORRESPONDING, MEASURED
from meshfit.measuring.new_defects import crossing_pairs, new_defects
from meshfit.measuring.stretch import LARGEST, singular_values, stretch
from meshfit.measuring.vertex_error import Truth, as_truth, vertex_error
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.sphere import icosphere
from tests.loops import over
from tests.shapes import patch, torus

TURN = Rotation.from_rotvec([0.3, -1.1, 0.6]).as_matrix()
BALL = icosphere(2)


def similar(mesh, scale):
    return mesh.with_verts(scale * mesh.verts @ TURN.T + [3.0, -20.0, 0.7])


def test_a_similarity_has_no_stretch_no_new_defect_and_no_vertex_error():
    for mesh in (load_target("cow"), torus(), patch()):
        for scale in (1e-3, 0.4, 1.0, 7.0, 1e5):
            moved = similar(mesh, scale)
            found = stretch(mesh, moved, scaled=True)
            assert (found.p50, found.p99) == pytest.approx((1, 1), abs=1e-9)
            assert found.scale == pytest.approx(scale)
            values, usable = singular_values(mesh, moved)
            assert usable.all()
            assert values == pytest.approx(np.full((mesh.num_faces, 2), scale), rel=1e-6)
        assert set(vars(new_defects(mesh, similar(mesh, 7.0))).values()) == {0}
    # The cow crosses itself, and still has no crossing that is new.
    assert len(crossing_pairs(load_target("cow")))
    found = measure(similar(BALL, 9), similar(BALL, 9), source=BALL, truth=similar(BALL, 9), samples=100, points=100)
    assert found.vertex_error.rms == found.vertex_error.max == found.unmatched.source == 0
    assert found.stretch.p99 == pytest.approx(1, abs=1e-9)


def test_doubling_along_an_axis_has_the_singular_values_2_and_1():
    flat = patch()
    wide = flat.with_verts(flat.verts * [2, 1, 1] @ TURN.T)
    values, _ = singular_values(flat, wide)
    assert values == pytest.approx(np.tile([2.0, 1.0], (flat.num_faces, 1)), abs=1e-12)
    assert stretch(flat, wide, scaled=False).p50 == pytest.approx(2)
    assert stretch(wide, flat, scaled=False).p99 == pytest.approx(2)
    # A mean scale of √2 is within what counts as the same size; without it, each way is √2.
    assert stretch(flat, wide).scale == 1
    assert stretch(flat, wide, scaled=True).p50 == pytest.approx(math.sqrt(2))
    assert stretch(flat, flat.with_verts(3 * wide.verts)).p50 == pytest.approx(math.sqrt(2))


def test_singular_values_are_those_of_the_maps_of_faces():
    generator = np.random.default_rng(0)
    moved = BALL.with_verts(BALL.verts + 0.2 * generator.normal(size=BALL.verts.shape))
    values, _ = singular_values(BALL, moved)
    for face in range(0, BALL.num_faces, 17):
        own, other = (mesh.verts[BALL.faces[face, 1:]] - mesh.verts[BALL.faces[face, 0]] for mesh in (BALL, moved))
        basis = np.linalg.svd(own)[2][:2]
        expected = np.linalg.svd(other.T @ np.linalg.inv(basis @ own.T), compute_uv=False)
        assert values[face] == pytest.approx(expected, rel=1e-9)


def test_percentiles_are_over_area_and_lost_faces_have_the_largest_stretch():
    small = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 9], [0, 9, 0]], [[0, 1, 2], [0, 3, 4]])
    longer = small.verts.copy()
    longer[3] *= 1.5
    found = stretch(small, small.with_verts(longer), scaled=False)
    assert (found.p50, found.p99) == pytest.approx((1.5, 1.5))
    longer[[1, 3]] = [[3, 0, 0], [0, 0, 9]]
    found = stretch(small, small.with_verts(longer), scaled=False)
    assert (found.p50, found.p99) == pytest.approx((1, 3))
    longer[3] = [0, 5, 0]
    assert stretch(small, small.with_verts(longer), scaled=False).p50 == LARGEST
    assert new_defects(small, small.with_verts(longer)).degenerate_faces == 1
    with pytest.raises(MeasureError, match="no area"):
        stretch(Mesh(np.zeros((3, 3)), [[0, 1, 2]]), Mesh(np.eye(3), [[0, 1, 2]]))


def test_new_crossings_are_those_that_the_source_lacks():
    two = Mesh(
        np.concatenate([BALL.verts, BALL.verts + np.array([3, 0, 0])]), np.concatenate([BALL.faces, BALL.faces + 162])
    )
    apart = two
    moved = two.with_verts(two.verts - np.where(np.arange(324)[:, None] < 162, 0.0, [1.5, 0, 0]))
    found = new_defects(apart, moved)
    pairs = crossing_pairs(moved)
    assert found.crossing_pairs == len(pairs) > 10
    assert found.crossing_faces == len(np.unique(pairs))
    assert (new_defects(moved, moved).crossing_pairs, new_defects(moved, apart).crossing_faces) == (0, 0)
    order = np.random.default_rng(0).permutation(two.num_faces)
    assert new_defects(*(Mesh(mesh.verts, mesh.faces[order]) for mesh in (apart, moved))) == found
    folded = BALL.verts.copy()
    folded[7] = folded[BALL.faces[(BALL.faces == 7).any(axis=1)]].mean(axis=(0, 1)) + np.array([0.0, 0.4, 0.3])
    assert (
        new_defects(BALL, BALL.with_verts(folded)).flipped_faces
        == measure(BALL.with_verts(folded), BALL, samples=100, points=100).quality.flipped_faces
    )


def test_vertex_errors_are_distances_to_the_truth():
    truth = BALL.verts + np.array([0.3, 0, 0.4])
    found = vertex_error(BALL, as_truth(truth, BALL), 4.0)
    assert (found.rms, found.p50, found.p99, found.max) == pytest.approx((0.5,) * 4)
    assert (found.percent_of_diagonal, found.vertices) == (pytest.approx(12.5), 162)
    order = np.random.default_rng(1).permutation(162)
    shuffled = vertex_error(Mesh(BALL.verts[order], []), Truth.of_first(truth[order]), 4.0)
    assert shuffled.rms == pytest.approx(found.rms, rel=1e-14)
    far = truth.copy()
    far[5] += [30, 0, 0]
    assert vertex_error(BALL, as_truth(far, BALL), 1.0).max == pytest.approx(math.hypot(30.3, 0.4))
    for form in (BALL, BALL.verts.tolist(), PointCloud(BALL.verts)):
        assert vertex_error(BALL, as_truth(form, BALL), 1.0).max == 0
    some = Truth(np.array([3, 9]), BALL.verts[[9, 3]])
    assert vertex_error(BALL, some, 1.0).rms == pytest.approx(math.dist(BALL.verts[3], BALL.verts[9]))


@over(
    ("given", "text"),
    [
        ({"truth": BALL.verts[:-1]}, "truth: 161 vertices, but the result has 162"),
        ({"truth": BALL.verts[:, :2]}, r"truth: shape \(162, 2\)"),
        (
            {"truth": np.where(np.arange(162)[:, None] == 4, np.nan, BALL.verts)},
            "truth: expected finite .* at vertex 4",
        ),
        ({"source": icosahedron()}, "source has 12 vertices and 20 faces, the result 162 vertices and 320 faces"),
        ({"source": Mesh(BALL.verts, BALL.faces[::-1])}, "as many, with other corners"),
    ],
)
def test_what_does_not_go_with_the_result_is_refused(given, text):
    with pytest.raises(MeasureError, match=text):
        measure(BALL, BALL, samples=100, points=100, **given)


def test_only_what_was_measured_is_listed():
    plain = measure(BALL, cube(), samples=100, points=100)
    assert list(plain.flat()) == list(MEASURED)
    full = measure(BALL, cube(), samples=100, points=100, source=BALL, truth=BALL)
    groups = {"vertex_error", "stretch", "new_defects", "unmatched"}
    names = [name for name in CORRESPONDING if name.partition(".")[0] in groups]
    assert list(full.flat()) == [*MEASURED, *names]
    assert {name: full.flat()[name] for name in MEASURED} == plain.flat()
    assert full._repr_html_().index("vertex error") < full._repr_html_().index("Hausdorff")


def rows_of(found):
    header, *rows = csv.reader(found.to_csv().splitlines())
    return header, np.array(rows, dtype=np.float64)


def test_the_rows_of_a_correspondence_give_the_nearest_points():
    target, result = torus(), torus().with_verts(torus().verts * 1.1 + 0.05)
    found = Correspondence.of(result, target)
    header, rows = rows_of(found)
    assert header == ["source_vertex", "target_face", "target_u", "target_v", "target_w", "distance"]
    points = np.einsum("nk,nkd->nd", rows[:, 2:5], target.verts[target.faces[rows[:, 1].astype(int)]])
    assert (rows[:, 0] == np.arange(result.num_verts)).all()
    assert rows[:, 2:5].min() >= 0
    assert rows[:, 2:5].sum(axis=1) == pytest.approx(np.ones(len(rows)))
    assert np.linalg.norm(points - result.verts, axis=1) == pytest.approx(rows[:, 5], abs=1e-12)
    # Its own vertices are corners of its faces.
    own = rows_of(Correspondence.of(target, target))[1]
    assert np.sort(own[:, 2:5]) == pytest.approx(np.tile([0.0, 0.0, 1.0], (target.num_verts, 1)), abs=1e-12)
    header, rows = rows_of(Correspondence.of(result, PointCloud(target.verts)))
    assert header == ["source_vertex", "target_vertex", "distance"]
    apart = np.linalg.norm(result.verts[:, None] - target.verts, axis=2)
    assert (rows[:, 1] == apart.argmin(axis=1)).all()
    assert rows[:, 2] == pytest.approx(apart.min(axis=1))


def test_correspondences_have_the_numbers_of_the_file_or_positions():
    frame = Frame((5.0, 0.0, -2.0), 10.0)
    target, result = BALL, BALL.with_verts(BALL.verts * 1.05)
    found = Correspondence.of(result, target).restored(frame)
    file = frame.restore(target)
    assert found.distances.max() == pytest.approx(0.5, rel=0.1)
    numbered = found.numbered_as(file.verts, file.faces.reshape(-1), file.num_faces)
    assert (numbered.indices == found.indices).all()
    # Faces that were turned have their corners the other way around.
    turned = found.numbered_as(file.verts, file.faces[:, ::-1].reshape(-1), file.num_faces)
    places = file.verts[file.faces[turned.indices][:, ::-1]]
    assert np.einsum("nk,nkd->nd", turned.barycentric, places) == pytest.approx(found.points)
    others = found.numbered_as(file.verts, file.faces[::-1].reshape(-1), file.num_faces)
    header, rows = rows_of(others)
    assert header == ["source_vertex", "target_x", "target_y", "target_z", "distance"]
    assert rows[:, 1:4] == pytest.approx(found.points)
    cloud = Correspondence.of(result, PointCloud(target.verts)).restored(frame)
    none = np.empty(0, dtype=np.int64)
    assert cloud.numbered_as(file.verts, none, 0).indices is not None
    assert cloud.numbered_as(file.verts[1:], none, 0).indices is None


def test_faces_without_area_have_barycentric_coordinates_too():
    target = Mesh([[0, 0, 0], [4, 0, 0], [1, 0, 0], [2, 5, 0]], [[0, 1, 2]])
    found = Correspondence.of(Mesh([[3.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.5, 0.0, 2.0]], []), target)
    points = np.einsum("nk,nkd->nd", found.barycentric, target.verts[target.faces[found.indices]])
    assert points == pytest.approx(np.array([[3.0, 0, 0], [0, 0, 0], [0.5, 0, 0]]))


def test_what_a_target_lacks_has_no_partner():
    ball = icosphere(4)
    middles = ball.verts[ball.faces].mean(axis=1)
    kept = ball.faces[middles[:, 2] < 0.3]
    used, inverse = np.unique(kept, return_inverse=True)
    part = Mesh(ball.verts[used], inverse.reshape(-1, 3))
    share = face_areas(ball)[middles[:, 2] > 0.3].sum() / face_areas(ball).sum()
    assert unmatched(ball, ball, ball).source == 0
    assert unmatched(part, part, part).source == 0
    assert unmatched(ball, ball, part).source == pytest.approx(share, abs=0.03)
    assert unmatched(ball, similar(ball, 40), similar(part, 40)).source == unmatched(ball, ball, part).source
    assert unmatched(ball, ball, PointCloud(part.verts)).source == pytest.approx(share, abs=0.08)
    assert unmatched(ball, ball, PointCloud(ball.verts)).source == 0
    # The other side of a thin sheet is no partner.
    back = Mesh(patch().verts, patch().faces[:, ::-1])
    near = back.with_verts(back.verts + np.array([0, 0, 0.001 * bounding_box_diagonal(back.verts)]))
    assert not has_partner(near, patch()).any()
    assert re.fullmatch(r"Unmatched\(source=[\d.]+\)", str(unmatched(near, near, patch())))
