"""Sweeps: their points, the identities of these, and refusals."""

import json
import math
import re
from collections import Counter

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import Experiment, load_experiment
from meshfit.config.sweep_samples import sampled_points
from meshfit.config.sweeps import value_text, variants_of
from meshfit.errors import ConfigError
from meshfit.experiment.plan import plan
from meshfit.settings import build, override
from tests.loops import over
from tests.small import CONFIG, config_file, ellipsoid, experiment


def variants(**sweep):
    return variants_of(build(ExperimentSettings, {"sweep": sweep}))


def test_without_a_sweep_there_is_one_nameless_point():
    (only,) = variants()
    assert (only.name, only.settings) == ("", ExperimentSettings())


def test_a_grid_is_the_product_of_its_lists_in_their_order():
    found = variants(**{"fit.losses.edge": [0.1, 1.0], "source.levels": [3, 4]})
    points = [(variant.settings.fit.losses.edge, variant.settings.source.levels) for variant in found]
    assert points == [(0.1, 3), (0.1, 4), (1.0, 3), (1.0, 4)]
    assert found[1].name == "edge=0.1, levels=4"
    assert all(variant.settings.sweep == {} for variant in found)


def test_what_is_zipped_goes_in_step():
    found = variants(zip={"fit.steps": [10, 20], "fit.optimizer.lr": [1.0, 0.5]}, **{"source.levels": [2, 3]})
    points = [(one.settings.fit.steps, one.settings.fit.optimizer.lr, one.settings.source.levels) for one in found]
    assert points == [(10, 1.0, 2), (10, 1.0, 3), (20, 0.5, 2), (20, 0.5, 3)]


def test_variants_have_names_and_change_several_settings_dotted_or_nested():
    found = variants(variants={"base": {}, "soft": {"fit.losses.edge": 0.1, "source": {"levels": 3}}})
    assert [variant.name for variant in found] == ["base", "soft"]
    assert found[0].settings == ExperimentSettings()
    assert (found[1].settings.fit.losses.edge, found[1].settings.source.levels) == (0.1, 3)
    assert found[1].settings.fit.losses.normal == ExperimentSettings().fit.losses.normal


@over(
    "change",
    [
        {"fit": {"method": "gauss-newton", "levels": 2}},
        {"fit.method": "gauss-newton", "fit.levels": 2},
        {"fit.levels": 2, "fit.method": "gauss-newton"},
    ],
)
def test_a_variant_may_be_fitted_by_the_other_engine(change):
    settings = build(ExperimentSettings, {"fit": {"steps": 7}, "sweep": {"variants": {"one": {}, "other": change}}})
    one, other = (variant.settings.fit for variant in variants_of(settings))
    assert (one.method, one.steps) == ("first-order", 7)
    assert (other.method, other.levels) == ("gauss-newton", 2)


def test_a_point_is_the_same_in_either_spelling_of_centre():
    points = [variants(**{key: [[0, 0, 1], None]}) for key in ("source.centre", "source.center")]
    assert points[0] == points[1]
    assert [point.settings.source.centre for point in points[0]] == [(0, 0, 1), None]


def test_keys_are_shortened_as_far_as_they_stay_apart():
    found = variants(
        **{"source.levels": [3], "fit.optimizer.schedule.name": ["cosine"], "fit.optimizer.name": ["adam"]}
    )
    assert found[0].name == "levels=3, schedule.name=cosine, optimizer.name=adam"


def test_names_of_values_stay_apart_and_are_never_cut():
    meshes = [
        {"mesh": "icosahedron", "levels": 3},
        {"mesh": "icosahedron", "levels": 3, "alpha_map": {"attribute": "a = b"}},
        *(f"/home/of/a/rather/long/path/{name}" for name in ("a/x.ply", "b/x.ply", "b/y.obj")),
    ]
    assert [value_text(mesh, meshes) for mesh in meshes] == [
        "(mesh=icosahedron levels=3)",
        '(mesh=icosahedron levels=3 alpha_map=(attribute="a = b"))',
        "a/x.ply",
        "b/x.ply",
        "y.obj",
    ]
    assert [value_text(value) for value in ("3/8", None, [1, "ä"], "a\nb")] == ["3/8", "null", '[1, "ä"]', "a\\nb"]
    ranges = {"source": [{"mesh": "cube"}, {"mesh": "target", "wanted_verts": 40}], "fit.steps": [3]}
    assert {each.name for each in variants(sample={"points": 9}, ranges=ranges)} == {
        "source=(mesh=cube), steps=3",
        "source=(mesh=target wanted_verts=40), steps=3",
    }


def test_a_point_has_the_identity_of_the_same_settings_without_a_sweep(tmp_path):
    plain = plan([experiment(tmp_path, fit={"steps": 30}, seeds=[0, 1])])
    swept = plan([experiment(tmp_path, seeds=[1, 2], sweep={"fit.steps": [10, 30]})])
    assert {trial.folder for trial in plain} & {trial.folder for trial in swept} == {plain[1].folder}
    assert [trial.variant for trial in swept] == ["steps=10", "steps=10", "steps=30", "steps=30"]
    assert swept[0].label.endswith("loop · steps=10 · seed 1")


def test_the_order_of_keys_changes_no_identity(tmp_path):
    first = experiment(tmp_path, sweep={"fit.steps": [10, 30], "source.levels": [1, 2]})
    second = experiment(tmp_path, sweep={"source.levels": [2, 1], "fit.steps": [30, 10]})
    identities = [{trial.identity for trial in plan([one])} for one in (first, second)]
    assert identities[0] == identities[1]
    assert len(identities[0]) == 4


def test_a_changed_scheme_or_seed_list_keeps_the_sweep(tmp_path):
    swept = experiment(tmp_path, sweep={"fit.steps": [10, 30]})
    more = Experiment("small", override(swept.settings, {"schemes": ["loop", "midpoint"]}))
    assert len(plan([more])) == 4


def test_swept_mesh_files_lie_relative_to_the_config(tmp_path, monkeypatch):
    text = CONFIG + "sweep: {source.mesh: [octahedron, ellipsoid.ply]}\n"
    path = config_file(tmp_path, text)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    meshes = [variant.settings.source.mesh for variant in variants_of(load_experiment(str(path)).settings)]
    assert meshes == ["octahedron", str(ellipsoid(tmp_path))]


@over(
    ("sweep", "message"),
    [
        ({"fit.losses.egde": [1, 2]}, r"fit\.losses\.egde: no such key: did you mean 'edge'"),
        ({"fit.steps": 3}, r"fit\.steps: expected a list of values, such as \[0.1, 1.0\], got 3"),
        ({"fit.steps": []}, r"fit\.steps: expected a list .* got \[\]"),
        ({"fit.steps": [5, 5]}, "duplicate value in"),
        ({"fit.steps": [5, -5]}, r"fit\.steps: .* got -5"),
        ({"fit.losses.edge": [1, 1.0]}, "are the same settings"),
        ({"fit.steps": [5], "fit": {"steps": [6]}}, "duplicate key"),
        ({"seeds": [0, 1]}, "always varied; list its values under 'seeds'"),
        ({"jobs": [1, 2]}, "no effect on results"),
        ({"sweep": [1]}, "cannot be swept"),
        ({"zip": {"fit.steps": [1, 2], "fit.samples": [100]}}, r"fit\.steps has 2, fit\.samples has 1"),
        ({"zip": {"fit.steps": [1, 2]}, "fit.steps": [3]}, "varied in two ways"),
        ({"variants": {"a": {"fit.steps": 3}}, "fit.steps": [3]}, "varied in two ways"),
        ({"variants": {"a": {}, "b": {}}}, "'a' and 'b' are the same settings"),
        (
            {
                "variants": {
                    name: {"fit": {"method": "gauss-newton", "snapshots": i}} for i, name in ((1, "a"), (2, "b"))
                }
            },
            "'a' and 'b' are the same settings",
        ),
        ({"variants": ["a"]}, r"variants: expected a mapping"),
        ({"variants": {"a": 3}}, r"variants\.a: expected a mapping .* got 3"),
    ],
)
def test_what_is_no_sweep_is_refused_in_one_line_that_names_the_place(tmp_path, sweep, message):
    path = config_file(tmp_path, CONFIG + f"sweep: {json.dumps(sweep)}\n")
    with pytest.raises(ConfigError, match=message) as caught:
        load_experiment(str(path))
    assert str(caught.value).startswith(f"{path}, line 8: ")


_RANGES = {
    "fit.losses.edge": {"log": [0.01, 2]},
    "fit": {"steps": {"linear": [1, 4], "integer": True}, "losses": {"normal": {"linear": [0.0, 0.1]}}},
    "source.levels": [2, 3],
}


def sampled(points, method="sobol", ranges=_RANGES, seed=0):
    return sampled_points({"points": points, "seed": seed, "method": method}, ranges)


@over("method", ["sobol", "latin-hypercube", "random"])
def test_samples_lie_in_their_ranges_and_more_points_keep_the_first(method):
    points = sampled(50, method)
    assert points == sampled(90, method)[:50]
    assert points != sampled(50, method, seed=1)
    assert all(0.01 <= point["fit.losses.edge"] <= 2 and 0 <= point["fit.losses.normal"] <= 0.1 for point in points)
    assert {point["fit.steps"] for point in points} == {1, 2, 3, 4}
    assert {point["source.levels"] for point in points} == {2, 3}


@over("method", ["sobol", "latin-hypercube"])
def test_designs_put_equally_many_points_into_equal_parts_of_each_range(method):
    points = sampled(64, method)
    octaves = [int(8 * math.log(point["fit.losses.edge"] / 0.01, 200)) for point in points]
    assert Counter(octaves) == dict.fromkeys(range(8), 8)
    assert Counter(point["fit.steps"] for point in points) == dict.fromkeys(range(1, 5), 16)
    assert Counter(point["source.levels"] for point in points) == dict.fromkeys((2, 3), 32)
    strata = sorted(int(64 * point["fit.losses.normal"] / 0.1) for point in points)
    assert strata == list(range(64))


def test_sobol_points_fill_products_of_parts_too():
    points = sampled(64)
    cells = [
        (int(4 * point["fit.losses.normal"] / 0.1), point["fit.steps"], point["source.levels"]) for point in points
    ]
    assert max(Counter(cells).values()) <= 4  # 64 points, 32 cells


def test_samples_are_an_axis_and_equal_to_their_settings_written_out():
    ranges = {"fit.losses.edge": {"log": [0.01, 2]}, "fit.steps": {"log": [10, 99], "integer": True}}
    found = variants(sample={"points": 3}, ranges=ranges, **{"source.levels": [2, 3]})
    assert [variant.settings.source.levels for variant in found] == [2, 3] * 3
    edge, steps = found[0].settings.fit.losses.edge, found[0].settings.fit.steps
    assert found[0].name == f"edge={edge}, steps={steps}, levels=2"
    (same,) = variants(**{"fit.losses.edge": [edge], "fit.steps": [steps], "source.levels": [2]})
    assert same.settings == found[0].settings


def test_equal_points_of_a_few_values_are_one_point():
    assert len(sampled(50, ranges={"source.levels": [2, 3, 4]})) == 3


@over(
    "sweep, message",
    [
        ({"sample": {"points": 3}}, "sweep.ranges: expected settings and their ranges, got null"),
        ({"sample": 3, "ranges": _RANGES}, "sweep.sample: expected a mapping"),
        ({"sample": {"points": 0}, "ranges": _RANGES}, "sweep.sample.points: expected a number of 1 or more, got 0"),
        ({"sample": {"points": 3, "method": "halton"}, "ranges": _RANGES}, "sweep.sample.method: got"),
        ({"ranges": {"fit.losses.edge": {"log": [0, 2]}}}, "expected numbers above 0 for a logarithmic range"),
        ({"ranges": {"fit.losses.edge": {"log": [2, 1]}}}, "the smaller first"),
        ({"ranges": {"fit.losses.edge": {"linear": [0, math.inf]}}}, "expected two finite numbers"),
        ({"ranges": {"fit.losses.edge": {"linear": [0, 1], "log": [1, 2]}}}, "expected a range such as"),
        ({"ranges": {"fit.losses.edge": {"linear": [0, 1], "step": 2}}}, "expected a range such as"),
        ({"ranges": {"fit.losses.edge": 0.5}}, "fit.losses.edge: expected a range such as"),
        ({"ranges": {"fit.steps": {"linear": [0.5, 3], "integer": True}}}, "expected integers at both ends"),
        ({"ranges": {"fit.steps": {"linear": [5, 9], "integer": 1}}}, "integer: expected true or false"),
        ({"ranges": {"source.levels": []}}, "expected different values"),
        ({"ranges": {"source.levels": [2, 2]}}, "expected different values"),
        ({"ranges": {"fit.steps": {"linear": [5, 9]}}}, "sweep: fit.steps: expected an integer"),
        ({"ranges": {"seeds": [0, 1]}}, "list its values under 'seeds'"),
        ({"ranges": {"source.levels": [2, 3]}, "source.levels": [2]}, "use only one of zip, variants, ranges"),
        ({"ranges": {"fit.edge": [2, 3]}}, "no such key"),
    ],
)
def test_malformed_samples_are_refused(sweep, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        variants(**{"sample": {"points": 3}} | sweep)
