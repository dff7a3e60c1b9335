"""The parts of a report: which trials it shows, and how it makes meshes, curves and distances small."""

import base64
import gzip
import json
import math
import re
import struct
from importlib import resources
from xml.etree import ElementTree

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.camera import camera_of, close_up, is_visible
from meshfit.report.figures.representative_trial import TrialIndex, representative
from meshfit.report.html.charts import (
    BINS,
    MOST_CURVES,
    MOST_POINTS,
    area_shares,
    changing_terms,
    draw_curves,
    read_curves,
    thinned,
    vertex_areas,
)
from meshfit.report.html.tables import whiskers
from meshfit.report.html.target_section import (
    MOST_SECTIONS,
    TargetSection,
    _spread,
    read_sections,
    shares_of,
    trials_by_row,
)
from meshfit.report.html.viewer import compress, pack_scene, quantise
from meshfit.report.tables.table import build_tables, merge_tables
from meshfit.statistics import PairedDifference
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.runs import result_of

GENERATOR = np.random.default_rng(0)


def results_of(*names, **fit):
    return [result_of(*name, **fit) | {"folder": f"runs/{'/'.join(map(str, name))}"} for name in names]


def sheets_of(results):
    return merge_tables(build_tables(results))


def rows_of(sheet, results, target="bunny"):
    return trials_by_row(sheet, target, TrialIndex(results))


def test_a_row_is_represented_by_the_trial_of_its_median():
    results = results_of(*(("bunny", "loop", seed) for seed in range(5)))
    for result, value in zip(results, (0.5, 0.1, 0.3, 0.2, 0.4), strict=True):
        result["hausdorff"] = result["hausdorff"] | {"symmetric": value}
    (sheet,) = sheets_of(results)
    by_seed = rows_of(sheet, results)[0]
    trial = representative(by_seed, sheet.samples[sheet.metrics[0], "bunny", sheet.rows[0]])
    assert (trial.scheme, trial.seed, trial.seeds, trial.value) == ("loop", 2, 5, 0.3)
    assert trial.result is results[2]
    assert representative(by_seed, {}).seed == 0


@pytest.mark.parametrize("most", [1, 3, 4, 6, 9])
def test_sections_share_the_room_and_each_has_some(most):
    shares = shares_of([3, 3], most)
    assert all(1 <= share <= 3 for share in shares)
    assert sum(shares) <= max(most, 2)


@pytest.mark.parametrize(("most", "shown"), [(1, 1), (9, 3)])
def test_a_section_names_what_it_leaves_out_and_what_it_cannot_read(most, shown):
    names = [(t, s, 0) for t in ("bunny", "cow") for s in ("loop", "interp-loop", "modified-butterfly")]
    results = [result | {"frame": {"centre": [0, 0, 0], "scale": 1}} for result in results_of(*names)]
    sections = read_sections(sheets_of(results), results, most, lambda *_: None)
    assert [(len(section.left_out), len(section.trials)) for section in sections] == [(3 - shown, 0)] * 2
    assert len({section.key for section in sections}) == 2
    problems = [problem for section in sections for problem in section.problems if "is not shown: runs/" in problem]
    assert len(problems) == 2 * shown


def test_variations_have_rows_of_their_own_and_a_trial_given_twice_is_taken_once():
    results = results_of(("bunny", "loop", 0), ("bunny", "loop", 1), steps=100)
    results += results_of(("bunny", "loop", 0), steps=200)
    (sheet,) = sheets_of(results)
    by_row = rows_of(sheet, [*results, *results])
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


def section_of(trials_by_row, rows=("loop",), values_by_row=None):
    values = values_by_row or {row: {} for row in trials_by_row}
    return TargetSection("t", "<bunny>", "distance", "", rows, trials_by_row, values, None, (), (), ())


def test_curves_leave_out_terms_that_never_change_and_values_that_are_not_finite(tmp_path):
    lines = "".join(f"{step},{1 / (step + 1)},7.0,{'nan' if step == 0 else step}\n" for step in range(1000))
    trials = {0: {0: trace(tmp_path, f"step,chamfer,lr,loss\n{lines}")}}
    curves, problems = read_curves(trials)
    assert (changing_terms(curves), problems) == (["chamfer", "loss"], [])
    (curve,) = curves
    assert len(curve.steps) == MOST_POINTS
    assert (curve.steps[-1], curve.times[-1]) == (999, 2.0)
    charts = draw_curves(section_of(trials), curves)
    assert [chart.title for chart in charts] == ["chamfer distance by time", "chamfer distance", "loss"]
    assert all("nan" not in chart.svg for chart in charts)


def test_no_line_crosses_steps_that_were_never_made(tmp_path):
    steps = [*range(40), *range(80, 100)]
    lines = "".join(f"{step},{1 / (step + 1)}\n" for step in steps)
    (curve,), _ = read_curves({0: {0: trace(tmp_path, f"step,distance\n{lines}")}})
    breaks = [place for place, value in enumerate(curve.values["distance"]) if math.isnan(value)]
    assert [curve.steps[place - 1 : place + 2] for place in breaks] == [(39.0, 80.0, 80.0)]
    # Without recorded times, the seconds of the fit are spread over the steps that were made.
    assert (curve.recorded, curve.times[-1]) == (False, 2.0)
    assert curve.times[39] == pytest.approx(2.0 * 39 / 59)
    even = "".join(f"{step},1\n" for step in [*range(0, 1999, 10), 1999])
    (curve,), _ = read_curves({0: {0: trace(tmp_path, f"step,distance\n{even}")}})
    assert not any(map(math.isnan, curve.values["distance"]))


def test_the_nearness_is_drawn_over_recorded_seconds(tmp_path):
    result = trace(tmp_path, "step,distance\n0,1\n1,0.5\n2,0.25\n")
    for text, times in (
        ("step,seconds\n0,0.5\n1,0.75\n2,1.75\n", (0.5, 0.75, 1.75)),
        ("step,seconds\n0,0.5\n1,0.75\n", (0.0, 1.0, 2.0)),  # of another trace
        ("step,seconds\n0,0.5\n1,nan\n2,1.75\n", (0.0, 1.0, 2.0)),
        ("nothing\n", (0.0, 1.0, 2.0)),
    ):
        (tmp_path / "times.csv").write_text(text)
        (curve,), problems = read_curves({0: {0: result}})
        assert (curve.times, curve.recorded, problems) == (times, times[0] > 0, [])
    charts = draw_curves(section_of({0: {0: result}}), [curve])
    assert "where not recorded" in charts[0].svg


def test_a_page_prints_all_its_pictures():
    folder = resources.files("meshfit.report.html")
    assert "lazy" not in (folder / "templates" / "targets.html").read_text()
    for script in ("charts.js", "turning.js"):
        assert "beforeprint" in (folder / "assets" / script).read_text()
    style = (folder / "assets" / "page.css").read_text()
    assert "#scenes" not in style.partition("@media print")[2]
    assert "@media (prefers-color-scheme: dark)" not in style  # a dark page prints on white


def test_many_curves_are_thinned_and_damaged_ones_are_reported(tmp_path):
    good = trace(tmp_path / "good", "step,distance\n0,1\n1,0.5\n")
    curves, _ = read_curves({row: dict.fromkeys(range(50), good) for row in range(4)})
    assert len(curves) == MOST_CURVES
    bad = {"folder": str(tmp_path), "seed": 1}
    curves, problems = read_curves({0: {0: trace(tmp_path / "bad", "nothing\n"), 1: bad, 2: good}})
    assert (len(curves), len(problems)) == (1, 2)


def test_a_chart_has_the_colours_of_the_page_and_a_class_for_each_row(tmp_path):
    good = trace(tmp_path, "step,distance\n0,1\n1,0.5\n2,0.25\n") | {"seed": 7}
    trials = {0: {7: good}, 12: {7: good}}
    section = section_of(trials, [f"row <{n}> x=0.12345" for n in range(13)], {0: {7: 0.1}, 12: {7: 0.2}})
    charts = draw_curves(section, read_curves(trials)[0])
    assert [chart.title for chart in charts] == [
        "distance to the target by time",
        "distance at the end",
        "distance to the target",
    ]
    ids = []
    for chart in charts:
        assert "&lt;bunny&gt;" in chart.svg
        assert not re.findall(r"#01[0-9a-f]{4}|clip-path|<style", chart.svg)
        assert all(f"var({name})" in chart.svg for name in ("--soft", "--rule", "--row-0", "--row-2", "--font"))
        tree = ElementTree.fromstring(chart.svg.replace("<svg ", '<svg xmlns:xlink="x" ', 1))
        series = {found.get("class"): found.find("title").text for found in tree.iter("g") if found.get("class")}
        assert series.keys() == {"row-0", "row-12"}
        assert series["row-12"].startswith("row <12> x=0.12345, seed 7")
        ids += [found.get("id") for found in tree.iter() if found.get("id")]
    assert len(ids) == len(set(ids))
    assert draw_curves(section, read_curves(trials)[0]) == charts


def test_a_mesh_for_the_viewer_is_what_it_was_to_its_steps():
    mesh = subdivide(icosahedron(), "loop", 2)
    mesh = Mesh(mesh.verts * [3.0, 1.0, 0.1] + [5.0, -2.0, 0.0], mesh.faces)
    distances = GENERATOR.uniform(0, 0.4, mesh.num_verts)
    found = quantise(mesh, distances, 0.2)
    steps = np.frombuffer(found.arrays["verts"], "<u2").reshape(-1, 3)
    assert np.abs(steps / 65_535 * found.extent + found.low - mesh.verts).max() <= found.extent / 131_070 * 1.001
    assert (np.frombuffer(found.arrays["faces"], "<u2").reshape(-1, 3) == mesh.faces).all()
    values = np.frombuffer(found.arrays["values"], "u1") / 255 * 0.2
    assert np.abs(values - np.minimum(distances, 0.2)).max() <= 0.2 / 510 * 1.001


def test_a_scene_tells_where_its_arrays_are():
    mesh = quantise(icosahedron(), None, 1.0)
    content = pack_scene([mesh, mesh], ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0), 1.0)
    (length,) = struct.unpack_from("<I", content)
    head = json.loads(content[4 : 4 + length])
    for found in head["meshes"]:
        for name, array in mesh.arrays.items():
            begin, size = found["arrays"][name]
            assert (4 + length + begin) % 4 == 0
            assert content[4 + length + begin : 4 + length + begin + size] == array


def test_packed_data_are_the_same_for_the_same_content_and_can_be_unpacked():
    content = b"some bytes </script>" * 9
    text = compress(content)
    assert text == compress(content)
    assert "<" not in text
    assert gzip.decompress(base64.b64decode(text)) == content


def test_a_histogram_holds_all_of_the_area():
    mesh = subdivide(icosahedron(), "loop", 2)
    corners = mesh.verts[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert vertex_areas(mesh).sum() == pytest.approx(area)
    shares, beyond = area_shares(mesh, GENERATOR.uniform(0, 1, mesh.num_verts), 0.7)
    assert len(shares) == BINS
    assert sum(shares) + beyond == pytest.approx(100, abs=0.1)
    assert 10 < beyond < 50


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


@over("vert", range(0, 12, 3))
def test_a_close_up_has_its_vert_is_visible(vert):
    mesh = icosahedron()
    camera = camera_of(mesh)
    found = close_up(mesh, vert, camera)
    assert is_visible(mesh, vert, found.camera)
    assert found.hidden == (not is_visible(mesh, vert, camera))
    assert found.camera.project(mesh.verts[[vert]])[0] == pytest.approx([0, 0, 0], abs=1e-9)


def test_of_many_targets_some_in_even_steps_are_drawn():
    values = np.random.default_rng(0).permutation(500).astype(float)
    places = _spread(values)
    assert places == sorted(places)
    drawn = np.sort(values[places])
    assert len(drawn) == MOST_SECTIONS
    assert (drawn[0], drawn[-1]) == (0, 499)
    assert set(np.diff(drawn)) <= {26, 27}
    assert _spread([3.0, 1.0, np.inf]) == [0, 1, 2]
