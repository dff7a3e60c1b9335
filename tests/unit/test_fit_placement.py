"""Fits in any unit and at any place, their progress, their keywords, and how they are shown."""

import inspect
import re
import sys
import warnings
from types import SimpleNamespace
from typing import get_args, get_type_hints

import numpy as np
import pytest

import meshfit
from meshfit.errors import ConfigError, MeshfitWarning
from meshfit.fitting.arguments import with_pieces
from meshfit.fitting.differences import BY_KEYWORD, warn_of_differences
from meshfit.fitting.fit import ENGINE_KEYS
from meshfit.fitting.keywords import FitKeys, Losses, OptimizerKeys, ScheduleKeys, ViewKeys
from meshfit.fitting.progress import Course, step_costs
from meshfit.fitting.settings import (
    METHODS,
    GaussNewtonSettings,
    LossWeights,
    OptimizerSettings,
    Schedule,
    ViewSettings,
)
from meshfit.mesh.control_mesh import unseen_of_open_cloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.solids import cube, icosahedron, octahedron
from tests.cli import invoke, trials_in_this_process
from tests.fits import fit as raw_fit
from tests.loops import over
from tests.shapes import mixed_closed

FIT = {"steps": 15, "samples": 200, "device": "cpu", "dtype": "float64"}
HALF = mixed_closed().with_verts(0.5 * mixed_closed().verts)
SMALL = {"method": "gauss-newton", "verts": 150, "coarse_steps": 2, "tries": 1, "level_steps": 1, "last_steps": 1}


def moved(mesh, scale=1000.0, offset=1e4):
    return mesh.with_verts(mesh.verts * scale + offset)


@pytest.mark.usefixtures("fewer_target_points")
@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(FIT, id="first-order"),
        pytest.param(SMALL | {"device": "cpu"}, id="gauss-newton", marks=pytest.mark.slow),
    ],
)
@over(("source", "normalise"), [("sphere", "tutorial"), (HALF, "tutorial"), (HALF, "box")])
def test_a_fit_in_another_unit_and_at_another_place_is_the_same_fit(settings, source, normalise):
    here = meshfit.fit(source, mixed_closed(), normalise=normalise, **settings)
    source_there = source if isinstance(source, str) else moved(source)
    there = meshfit.fit(source_there, moved(mixed_closed()), normalise=normalise, **settings)
    np.testing.assert_array_equal(there.mesh.faces, here.mesh.faces)
    assert np.abs(there.mesh.verts - moved(here.mesh).verts).max() < 1e-5  # rounding of 1e4, grown over the steps


def test_the_result_is_that_of_the_normalised_meshes_to_the_byte():
    target = mixed_closed()
    frame = meshfit.frame_of(target, "tutorial")
    source = frame.restore(icosahedron())
    result = meshfit.fit(source, target, **FIT)
    raw = raw_fit(frame.normalise(source), frame.normalise(target), **FIT)
    assert result.trace == raw.trace
    assert result.mesh.verts.tobytes() == frame.restore(raw.mesh).verts.tobytes()
    assert result.frame == frame
    assert result.target is target


def test_a_run_with_the_same_settings_gives_the_same_bytes(tmp_path):
    meshfit.save_mesh(moved(mixed_closed()), tmp_path / "target.ply")
    config = tmp_path / "same.yaml"
    config.write_text(
        "targets: [target.ply]\nschemes: [midpoint]\nseeds: [3]\n"
        "source: {mesh: icosahedron, levels: 4, project: sphere}\n"
        "fit: {steps: 5, samples: 200}\nmeasure: {samples: 100, points: 100}\ndevice: cpu\n",
        encoding="utf-8",
    )
    with trials_in_this_process():
        assert invoke("run", config, "--runs", tmp_path / "runs", "--quiet").code == 0
    (path,) = (tmp_path / "runs").rglob("result.ply")
    result = meshfit.fit("sphere", tmp_path / "target.ply", steps=5, samples=200, seed=3, device="cpu")
    meshfit.save_mesh(result, tmp_path / "result.ply")
    assert (tmp_path / "result.ply").read_bytes() == path.read_bytes()


@over("source", [moved(icosahedron(), 1e-3, 0.0), moved(icosahedron(), 1.0, 50.0), moved(icosahedron(), 30.0, 0.0)])
def test_a_source_far_from_the_target_is_brought_to_it_and_this_is_said(source):
    with pytest.warns(MeshfitWarning, match=r"source was moved and scaled .*boxes .*align='none' keeps it"):
        result = meshfit.fit(source, cube(), **FIT | {"steps": 0})
    extent = np.linalg.norm(result.mesh.verts, axis=1)
    assert extent.max() == pytest.approx(np.abs(cube().verts).max())
    with pytest.warns(MeshfitWarning):
        moved_target = meshfit.fit(source, moved(cube(), 1000.0, 1e4), **FIT)
    assert np.abs(moved_target.mesh.verts - 1e4).max() < 1000
    asked_for = meshfit.fit(source, cube(), align="sphere", **FIT | {"steps": 0})
    np.testing.assert_array_equal(asked_for.mesh.verts, result.mesh.verts)
    with pytest.warns(MeshfitWarning, match=r"boxes of source and target do not overlap|times as large as the"):
        kept = meshfit.fit(source, cube(), align="none", **FIT | {"steps": 0})
    np.testing.assert_allclose(kept.mesh.verts, source.verts, rtol=1e-12, atol=1e-12)


def test_a_source_near_the_target_stays_and_alignments_move_it():
    source = moved(octahedron(), 1.0, 0.2)
    stays = meshfit.fit(source, cube(), **FIT | {"steps": 0})
    np.testing.assert_allclose(stays.mesh.verts, source.verts, rtol=0, atol=1e-12)
    centred = meshfit.fit(source, moved(cube(), 2.0, 0.5), align="center", **FIT | {"steps": 0})
    np.testing.assert_allclose(centred.mesh.verts.mean(axis=0), 0.5, atol=0.05)


def test_snapshots_and_the_last_good_mesh_are_in_the_targets_coordinates():
    target, seen = moved(cube()), []
    meshfit.fit("icosahedron", "cube", snapshots=5, on_snapshot=lambda *shot: seen.append(shot), **FIT)
    assert [step for step, _ in seen] == [5, 10, 15]
    with pytest.raises(meshfit.Diverged) as caught:
        meshfit.fit("sphere", target, optimizer={"lr": 1e300}, **FIT)
    assert np.abs(caught.value.last_good.verts - 1e4).max() < 2000


def test_keywords_are_the_keys_of_both_engines_with_their_types():
    models = [METHODS[name] for name in ("first-order", "gauss-newton")]
    assert set().union(*(model.model_fields for model in models)) == ENGINE_KEYS
    assert set(inspect.signature(meshfit.fit).parameters) >= ENGINE_KEYS
    parameters, keys = inspect.signature(meshfit.fit).parameters, get_type_hints(FitKeys)
    for key in ENGINE_KEYS - {"losses", "optimizer", "views"}:
        assert parameters[key].annotation == keys[key], key
        fields = [model.model_fields[key].annotation for model in models if key in model.model_fields]
        plain = [getattr(get_args(field)[0], "__origin__", field) if get_args(field) else field for field in fields]
        names = [getattr(field, "__name__", str(field)).removesuffix(" | None") for field in plain]
        assert key in ("method", "snapshots") or any(name in str(keys[key]) for name in names), key
    for typed, model in (
        (Losses, LossWeights),
        (OptimizerKeys, OptimizerSettings),
        (ScheduleKeys, Schedule),
        (ViewKeys, ViewSettings),
    ):
        assert set(typed.__annotations__) == set(model.model_fields)
    assert set(inspect.signature(meshfit.measure).parameters) >= set(meshfit.MeasureSettings.model_fields)


@over(
    ("changes", "message"),
    [
        ({"step": 5}, "step: no such key: did you mean 'steps'\\? allowed: "),
        (
            {"verts": 500},
            "verts: no such key: it is one of method='gauss-newton', and this is 'first-order'; allowed: ",
        ),
        ({"method": "gauss-newton", "losses": {"edge": 1.0}}, "losses: no such key: it is one of method='first-order'"),
        ({"method": "newton"}, "method: got \"newton\"; did you mean 'gauss-newton'"),
        ({"normalise": "unit"}, 'normalise: got "unit"; allowed: tutorial, box, sphere, cube, none'),
        ({"align": "centre"}, "align: got \"centre\"; did you mean 'center'"),
        ({"settings": {"steps": 3}}, "settings: expected FirstOrderSettings, GaussNewtonSettings or ExternalSettings"),
    ],
)
def test_a_wrong_keyword_or_value_names_what_is_allowed(changes, message):
    with pytest.raises(ConfigError, match=f"^{message}"):
        meshfit.fit("icosahedron", "cube", **changes)
    with pytest.raises(ConfigError, match=r"^sample: no such key: did you mean 'samples'\?"):
        meshfit.measure("cube", "cube", sample=3)


def test_settings_models_are_taken_for_groups_of_keys():
    plain = meshfit.fit("icosahedron", "cube", losses={"edge": 0.3}, **FIT)
    model = meshfit.fit("icosahedron", "cube", losses=LossWeights(edge=0.3), **FIT)
    assert plain.trace == model.trace


def test_progress_is_printed_for_a_log_and_ends_with_the_seconds(capsys):
    meshfit.fit("icosahedron", "cube", progress=True, **FIT)
    assert re.fullmatch(r"fit: 15 steps in \d+ s\n", capsys.readouterr().err)


def test_progress_is_one_line_in_a_notebook(monkeypatch, capsys):
    shown = []
    handle = SimpleNamespace(update=lambda data, raw: shown.append(data["text/plain"]))

    def display(data, *, raw, display_id):
        shown.append(data["text/plain"])
        return handle

    module = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=True), display=SimpleNamespace(display=display))
    monkeypatch.setitem(sys.modules, "IPython", module)
    monkeypatch.setattr("meshfit.fitting.progress._SECONDS_BETWEEN_UPDATES", 0.0)
    meshfit.fit("icosahedron", "cube", progress=True, **FIT)
    assert shown[0] == "starting"
    assert re.fullmatch(r"█+░+ +\d+ %  step \d+ of 15, loss [\d.e+-]+, about \d+ s left", shown[5])
    assert shown[-1].startswith("fit: 15 steps in ")
    assert capsys.readouterr().err == ""


def test_a_bar_is_shown_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    meshfit.fit("icosahedron", "cube", progress=True, **FIT)
    assert capsys.readouterr().out == ""


def test_the_remaining_time_weighs_steps_by_their_cost():
    settings = meshfit.GaussNewtonSettings(coarse_steps=10, tries=1, level_steps=4, last_steps=2, levels=1)
    costs = step_costs(settings)
    assert len(costs) == settings.steps == 20
    assert costs[14] > 2 * costs[11]  # a step of level 1, with four times as many vertices, and one of level 0
    assert costs[10] > costs[11]  # the remesh that level 0 begins with
    for pace, after in ((1.0, 0.0), (3.0, 2.0)):  # a clock that goes by the costs makes the estimate exact
        now = [0.0]
        course = Course(settings, lambda now=now: now[0], after=after)
        for done, cost in enumerate(costs, 1):
            now[0] += pace * cost
            course.update(meshfit.Step(done, settings.steps, 1.0, "level 0"))
            if done > 1:
                assert course.seconds_left == pytest.approx(pace * (sum(costs) + after) - now[0])
        assert course.share == pytest.approx(sum(costs) / (sum(costs) + after))


def test_the_remaining_time_follows_the_pace_and_counts_a_further_search_once_it_has_begun():
    settings = meshfit.GaussNewtonSettings(coarse_steps=10, tries=2, level_steps=40, last_steps=2, levels=0)
    once, again, now = step_costs(settings), step_costs(settings, 1), [0.0]
    assert len(once) == len(again) == 52
    for searches in (0, 1, 2):
        costs = [*once[:10], *again] if searches == 2 else once[10 * (1 - searches) :]
        course = Course(settings, lambda now=now: now[0])
        for done, cost in enumerate(costs, 1):
            now[0] += cost * (2.0 if done > 30 else 1.0)
            known = len(costs) - (10 if searches == 2 and done <= 10 else 0)
            course.update(meshfit.Step(done, known, 1.0, "level 0"))
            if done in (9, 15):
                ahead = costs[done:] if known == len(costs) else once[done:]
                assert course.seconds_left == pytest.approx(sum(ahead), rel=0.02)
        assert course.seconds_left == 0
        assert course.share == pytest.approx(1)


def test_traces_become_tables_and_pictures():
    trace = meshfit.fit("icosahedron", "cube", trace_every=1, **FIT).trace
    html = trace._repr_html_()
    assert html.count("<tr>") == 1 + 9  # of 15 rows the first and the last four
    assert "<th>chamfer</th>" in html
    assert trace.column("step") == list(range(15))
    with pytest.raises(ConfigError, match="'los' is not a column of the trace: did you mean 'loss'"):
        trace.plot("los")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    axes = trace.plot("loss", "edge", ax=pyplot.figure().add_subplot())
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), trace.column("edge"))
    assert axes.get_yscale() == "log"
    axes = trace.plot("loss", over="seconds", ax=pyplot.figure().add_subplot())
    np.testing.assert_array_equal(axes.lines[0].get_xdata(), trace.column("seconds"))
    pyplot.close("all")


def test_tables_for_pandas(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    measured = meshfit.measure("octahedron", "cube", samples=100, points=100)
    for thing in (measured, meshfit.Trace()):
        with pytest.raises(ConfigError, match=r"^to_pandas\(\) needs pandas, .*: pip install pandas$"):
            thing.to_pandas()
    monkeypatch.undo()
    pandas = pytest.importorskip("pandas")
    table = pandas.concat([measured.to_pandas(), measured.to_pandas()])
    assert table["quality.faces"].tolist() == [8, 8]
    assert table["hausdorff.symmetric"].dtype == np.float64
    trace = meshfit.fit("icosahedron", "cube", **FIT).trace
    assert trace.to_pandas()["loss"].tolist() == trace.column("loss")
    assert trace.to_pandas()["seconds"].tolist() == trace.seconds == sorted(trace.seconds)


def test_a_measurement_is_a_table_in_a_notebook():
    measured = meshfit.measure("octahedron", "cube", samples=100, points=100)
    html = measured._repr_html_()
    assert f"<td>{measured.hausdorff.symmetric:.4g}</td>" in html
    assert html.count("<tr>") == 1 + 10 + 1 + len(measured.flat())
    assert "Mesh" not in repr(measured)
    assert len(repr(measured)) < 150


@pytest.mark.slow
def test_meshes_are_shown_as_images_without_a_display(monkeypatch):
    pytest.importorskip("pyvista")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    pixels = np.asarray(octahedron().show(octahedron().verts[:, 0], label="x", size=(80, 60), image=True))
    assert pixels.shape == (60, 80, 3)
    assert pixels.std() > 10
    result = meshfit.fit("icosahedron", "cube", **FIT)
    assert np.asarray(result.show(image=True)).shape[1] == 2 * 560
    with pytest.raises(meshfit.MeshfitError, match="values: expected one for each of 6 vertices or 8 faces"):
        octahedron().show([1.0, 2.0])
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ConfigError, match=r"pictures need pyvista, .*: pip install 'meshfit\[report\]'"):
        octahedron().show()


def test_nothing_warns_where_all_is_well():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        meshfit.fit("sphere", moved(cube()), **FIT)


def with_floater(mesh, size=0.02, offset=3.0):
    """A mesh with a small copy of itself far off."""
    verts = np.concatenate([mesh.verts, size * mesh.verts + offset])
    return Mesh(verts, np.concatenate([mesh.faces, mesh.faces + mesh.num_verts]))


def test_small_pieces_far_off_are_warned_of_and_left_out_where_asked():
    alone = meshfit.subdivide("cube", "midpoint", 2)
    both = with_floater(alone)
    expected = meshfit.fit("sphere", alone, **FIT).mesh.verts
    np.testing.assert_array_equal(meshfit.fit("sphere", both, keep="largest", **FIT).mesh.verts, expected)
    np.testing.assert_array_equal(meshfit.fit("sphere", both, keep=0.5, **FIT).mesh.verts, expected)
    points = PointCloud(with_floater(meshfit.subdivide("cube", "midpoint", 3)).verts)
    for target in (both, points):
        with pytest.warns(MeshfitWarning, match=r"target: 1 small piece far off .* set keep='largest'"):
            assert with_pieces(target, None, has_images=False) is target
    assert with_pieces(points, "largest", has_images=False).num_verts == points.num_verts // 2
    for wrong in ("most", 0.0, 1.5, True, [1]):
        with pytest.raises(ConfigError, match=r"^keep: expected 'all', 'largest', or a share above 0"):
            meshfit.fit("sphere", both, keep=wrong, **FIT)


def differences_of(source, target):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        meshfit.fit(source, target, align="none", **FIT | {"steps": 0})
    return [str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning)]


def test_what_a_fit_cannot_make_up_for_is_warned_of_before_it():
    fine = meshfit.subdivide("cube", "midpoint", 2)
    without_top = Mesh(fine.verts, fine.faces[fine.verts[fine.faces][:, :, 2].min(axis=1) < fine.verts[:, 2].max()])
    texts = differences_of(fine, without_top)
    assert any("the target is open (1 opening), and the source is closed" in text for text in texts)
    assert any("the source 'target' (or 'auto')" in text for text in texts)
    assert any("differ in topology" in text for text in texts)
    assert not differences_of("closed", without_top)
    (text,) = [text for text in differences_of(moved(fine, 1.0, 9.0), fine) if "boxes" in text]
    assert text == "the bounding boxes of source and target do not overlap; set align"
    (text,) = [text for text in differences_of(moved(fine, 0.01, 0.0), fine) if "times as large" in text]
    assert text.endswith("give a larger source, or set align='pca'")


def test_points_of_an_open_surface_are_warned_of_where_the_source_is_closed():
    sphere = meshfit.icosphere(4).verts
    open_points, closed_points = PointCloud(sphere[sphere[:, 2] > 0.2]), PointCloud(sphere)
    assert unseen_of_open_cloud(closed_points) == 0
    unseen = unseen_of_open_cloud(open_points)
    settings = GaussNewtonSettings()
    with pytest.warns(MeshfitWarning, match=rf"an open surface \(it shows {1 - unseen:.0%} of .* source 'open'"):
        warn_of_differences(icosahedron(), open_points, settings, "all", fills=False, remedies=BY_KEYWORD)
    warn_of_differences(icosahedron(), closed_points, settings, "all", fills=False, remedies=BY_KEYWORD)


WRONG = [None, 1.5, ["a", "b"], np.zeros(3), object(), {}, b"x", ("a",)]


@over("name", ["seed", "device", "dtype", "threads", "method", "normalise", "align", "source", "target"])
def test_a_value_of_a_wrong_type_is_refused_by_name(name):
    for value in WRONG:
        if value is None and name == "method":
            continue  # the default
        given = {"source": "icosahedron", "target": "cube", **FIT, name: value}
        with pytest.raises(meshfit.MeshfitError, match=rf"^{name}: ") as caught:
            meshfit.fit(**given)
        assert "\n" not in str(caught.value)


def test_an_angle_that_is_no_number_is_refused_by_name():
    for value in WRONG:
        if not isinstance(value, float):
            with pytest.raises(meshfit.MeshfitError, match=r"^degrees: expected a number"):
                meshfit.creases_by_angle("cube", value)
