"""The parts of a report: which trials it shows, and how it makes meshes, curves and distances small."""

import base64
import gzip
import json
import struct

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.camera import camera_of
from meshfit.report.figures.visibility import close_up, in_sight
from meshfit.report.html.charts import (
    BINS,
    MOST_CURVES,
    MOST_POINTS,
    curves_of,
    histogram,
    thinned,
    vert_areas,
    whiskers,
)
from meshfit.report.html.page import packed_json
from meshfit.report.html.target_section import keyed, trials_on, walls_of
from meshfit.report.html.viewer import Scene, View, quantised
from meshfit.report.tables.table import build_tables, merge_tables
from meshfit.statistics import PairedDifference
from meshfit.subdivision.refine import subdivide
from tests.runs import result_of

GENERATOR = np.random.default_rng(0)


def results_of(*names, **fit):
    return [result_of(*name, **fit) | {"folder": f"runs/{'/'.join(map(str, name))}"} for name in names]


def sheets_of(results):
    return merge_tables(build_tables(results))


def test_a_row_is_shown_by_the_trial_of_its_median():
    results = results_of(*(("bunny", "loop", seed) for seed in range(5)))
    for result, value in zip(results, (0.5, 0.1, 0.3, 0.2, 0.4), strict=True):
        result["hausdorff"] = result["hausdorff"] | {"symmetric": value}
    ((exhibit,),) = [wall.exhibits for wall in walls_of(sheets_of(results), keyed(results), 10)]
    assert (exhibit.label, exhibit.seed, exhibit.seeds, exhibit.figure) == ("loop", 2, 5, "0.3000")
    assert exhibit.result is results[2]


@pytest.mark.parametrize("most", [1, 3, 4, 6, 9])
def test_walls_share_the_room_and_name_what_is_left_out(most):
    results = results_of(*((t, s, 0) for t in ("bunny", "cow") for s in ("loop", "interp-loop", "modified-butterfly")))
    walls = walls_of(sheets_of(results), keyed(results), most)
    assert [len(wall.exhibits) + len(wall.left_out) for wall in walls] == [3, 3]
    assert all(wall.exhibits for wall in walls)
    assert sum(len(wall.exhibits) for wall in walls) <= max(most, len(walls))
    assert len({wall.key for wall in walls}) == 2


def test_variations_have_rows_of_their_own_and_a_trial_given_twice_is_taken_once():
    results = results_of(("bunny", "loop", 0), ("bunny", "loop", 1), steps=100)
    results += results_of(("bunny", "loop", 0), steps=200)
    (sheet,) = sheets_of(results)
    by_row = trials_on(sheet, "bunny", keyed([*results, *results]))
    assert {place: list(by_seed) for place, by_seed in by_row.items()} == {0: [0, 1], 1: [0]}
    assert by_row[1][0] is results[2]


@pytest.mark.parametrize(("count", "most"), [(1, 5), (5, 5), (6, 5), (1000, 7), (2, 2)])
def test_thinned_places_keep_both_ends_and_are_even(count, most):
    kept = thinned(count, most)
    assert kept[0] == 0
    assert kept[-1] == count - 1
    assert len(kept) == min(count, most)
    assert np.ptp(np.diff(kept)) <= 1 if len(kept) > 1 else True


def trace(folder, text):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "trace.csv").write_text(text)
    return {"folder": str(folder), "seed": 0, "seconds": {"fit": 2.0}}


def test_curves_leave_out_what_never_moves_and_have_no_nan(tmp_path):
    lines = "".join(f"{step},{1 / (step + 1)},7.0,{'nan' if step == 3 else step}\n" for step in range(1000))
    curves = curves_of({0: {0: trace(tmp_path, f"step,chamfer,lr,loss\n{lines}")}})
    assert (curves.terms, curves.nearness, curves.trials) == (("chamfer", "loss"), "chamfer", 1)
    (curve,) = curves.curves
    assert len(curve.steps) == MOST_POINTS
    assert curve.steps[-1] == 999
    assert json.loads(json.dumps(curve.data(), allow_nan=False))["seconds"] == 2.0


def test_many_curves_are_thinned_and_damaged_ones_are_told(tmp_path):
    good = trace(tmp_path / "good", "step,distance\n0,1\n1,0.5\n")
    many = {row: dict.fromkeys(range(50), good) for row in range(3)}
    curves = curves_of(many)
    assert (len(curves.curves), curves.trials) == (MOST_CURVES, 150)
    curves = curves_of({0: {0: trace(tmp_path / "bad", "nothing\n"), 1: {"folder": str(tmp_path), "seed": 1}, 2: good}})
    assert len(curves.curves) == 1
    assert len(curves.problems) == 2


def test_a_mesh_for_the_viewer_is_what_it_was_to_its_steps():
    mesh = subdivide(icosahedron(), "loop", 2)
    mesh = Mesh(mesh.verts * [3.0, 1.0, 0.1] + [5.0, -2.0, 0.0], mesh.faces)
    distances = GENERATOR.uniform(0, 0.4, mesh.num_verts)
    found = quantised(mesh, distances, 0.2)
    steps = np.frombuffer(found.arrays["verts"], "<u2").reshape(-1, 3)
    assert np.abs(steps / 65_535 * found.extent + found.low - mesh.verts).max() <= found.extent / 131_070 * 1.001
    assert (np.frombuffer(found.arrays["faces"], "<u2").reshape(-1, 3) == mesh.faces).all()
    values = np.frombuffer(found.arrays["values"], "u1") / 255 * 0.2
    assert np.abs(values - np.minimum(distances, 0.2)).max() <= 0.2 / 510 * 1.001


def test_a_scene_tells_where_its_arrays_are():
    mesh = quantised(icosahedron(), None, 1.0)
    scene = Scene((View("a", "", mesh), View("b", "", mesh)), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0), 1.0)
    content = scene.content()
    (length,) = struct.unpack_from("<I", content)
    head = json.loads(content[4 : 4 + length])
    for found in head["meshes"]:
        for name, array in mesh.arrays.items():
            begin, size = found["arrays"][name]
            assert (4 + length + begin) % 4 == 0
            assert content[4 + length + begin : 4 + length + begin + size] == array


def test_packed_data_are_the_same_for_the_same_content_and_can_be_unpacked():
    content = {"a": [1, 2.5, None], "b": "</script>"}
    text = packed_json(content)
    assert text == packed_json(content)
    assert "<" not in text
    assert json.loads(gzip.decompress(base64.b64decode(text))) == content


def test_a_histogram_holds_all_of_the_area():
    mesh = subdivide(icosahedron(), "loop", 2)
    corners = mesh.verts[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert vert_areas(mesh).sum() == pytest.approx(area)
    found = histogram(0, mesh, GENERATOR.uniform(0, 1, mesh.num_verts), 0.7)
    assert len(found.shares) == BINS
    assert sum(found.shares) + found.beyond == pytest.approx(100, abs=0.1)
    assert 10 < found.beyond < 50


def test_whiskers_keep_the_order_of_what_they_stand_for():
    paired = [
        PairedDifference(0.2, (0.1, 0.3), 5),
        PairedDifference(-0.1, (-0.4, 0.05), 5),
        PairedDifference(1, None, 1),
    ]
    first, second, none = whiskers(paired)
    assert none is None
    assert first.zero == second.zero
    assert 0 < second.low < second.mean < second.zero < second.high < first.low < first.mean < first.high < 100


@pytest.mark.parametrize("vert", range(12))
def test_a_close_up_has_its_vert_in_sight(vert):
    mesh = icosahedron()
    camera = camera_of(mesh)
    found = close_up(mesh, vert, camera)
    assert in_sight(mesh, vert, found.camera)
    assert found.hidden == (not in_sight(mesh, vert, camera))
    assert found.camera.project(mesh.verts[[vert]])[0] == pytest.approx([0, 0, 0], abs=1e-9)
