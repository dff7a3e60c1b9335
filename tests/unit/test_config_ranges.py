"""Every constrained key accepts values inside its range, and refuses others with line, key, value and expectation."""

import re

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.loading import load_experiment
from meshfit.config.strict_yaml import parse_document
from meshfit.errors import ConfigError
from meshfit.settings import build
from tests.loops import over

RANGES = {
    "source.decimate": (["4", "100"], ["3", "-1", "4.5"]),
    "source.levels": (["0", "8"], ["-1", "9", "1.5", "null"]),
    "source.radius": (["1e-9", "2", "null"], ["0", "-1"]),
    "source.radius_of": (["null", "area", "volume"], ["radius", "1"]),
    "source.centre": (["[0, 1, 2.5]", "null"], ["[0, 0]", "[0, 0, 0, 0]", "0", "[0, 0, x]"]),
    "source.creases": (
        ["null", "{angle: 30}", "{angle: 180, sharpness: 0}", "{file: edges.txt, sharpness: 1.5}"],
        ["30", "edges.txt", "{}", "{angle: 30, file: a}", "{sharpness: 1}", "{angle: 0}", "{angle: 181}", "[30]"],
    ),
    "source.creases.angle": (["1e-3", "180"], ["0", "-1", "180.5", ".nan"]),
    "source.wanted_verts": (["null", "4", "2562"], ["3", "0", "-1", "2.5"]),
    "source.alpha": (["null", "{file: a.txt}", "{attribute: alpha}"], ["0.5", "{}", "{file: a, attribute: b}"]),
    "source.landmarks": (
        ["null", "{file: a.csv, hold_out: 1}", "{file: a.fcsv, hold_out: 1.0}"],
        ["5", "{}", "{file: a.csv, hold_out: 1.5}", "{file: a.csv, hold_out: -1}", "[a.csv]"],
    ),
    "source.weights": (["null"], ["0.5", "{}", "{file: a, attribute: b}"]),
    "source.fixed": (["null"], ["true", "{}", "{file: a, attribute: b}"]),
    "source.rigid": (["null"], ["1", "{}", "{file: a, attribute: b}"]),
    "source.project": (["none", "sphere"], ["Sphere", "null"]),
    "source.mesh": (["cube", "target", "auto", "sphere"], ["5", "null"]),
    "source.wrap": (["null"], ["5", "[0.1]"]),
    "source.weld": (["null", "1e-9", "2.5"], ["0", "-1", ".inf", "small"]),
    "source.repair": (["split", "refuse"], ["Split", "null", "true"]),
    "weld": (["null", "1e-9", "2.5"], ["0", "-1", ".inf", "small"]),
    "repair": (["split", "refuse"], ["Split", "null", "true"]),
    "target.surface": (["all", "outer"], ["inner", "null"]),
    "target.keep": (["all", "null", "largest", "0.1", "1"], ["0", "1.5", "biggest", "true", "[1]"]),
    "target.sensor": (["null", "[0, 1.5, -2]"], ["5", "[0, 1]", "[0, 1, .inf]"]),
    "target.truth": (["null", "known.ply", "'{target}-truth.ply'"], ["5", "[a.ply]"]),
    "target.landmarks": (["null"], ["5", "[a.csv]"]),
    "targets": (["[cow]"], ["[]", "cow", "[1]", "[cow, cow]", "null"]),
    "define": (["{}", "{mine: {base: loop}}"], ["null", "[1]", "{Mine: {base: loop}}", "{mine: 3}", "{mine: {}}"]),
    "schemes": (["[loop, 'loop:weights=warren']"], ["[]", "[lop]", "[loop, loop]", "['interp-loop:alpha=2']", "[3]"]),
    "seeds": (["[0, 1]", "[4294967295]"], ["[]", "[-1]", "[4294967296]", "[0, 0]", "0", "[1.5]"]),
    "normalise": (["tutorial", "sphere", "box", "cube", "none"], ["Box", "null"]),
    "write_frame": (["normalised", "target"], ["own"]),
    "view.up": (["auto", "x", "y", "z"], ["Z", "-z", "null"]),
    "dtype": (["float32", "float64"], ["float16"]),
    "jobs": (["auto", "1", "64"], ["0", "-1", "many", "2.5", "null"]),
    "threads": (["auto", "2"], ["0", "all"]),
    "retries": (["0", "10"], ["-1", "11", "auto"]),
    "sweep": (["{}", "{fit.steps: [1, 2]}"], ["null", "[1]", "2"]),
    "source.frame": (["null"], ["box", "normalised"]),
    "source.align": (["none", "center", "centre", "box", "pca", "icp"], ["middle"]),
    "fit.method": (["first-order", "gauss-newton"], ["second-order"]),
    "fit.steps": (["0", "5", "1e3"], ["-1", "1.5", "1_000"]),
    "fit.samples": (["1"], ["0", "-5"]),
    **{
        f"fit.losses.{term}": (["0", "2.5"], ["-0.1", ".inf", ".nan", "1e400"])
        for term in ("chamfer", "normal", "edge", "laplacian", "consistency")
    },
    **{f"fit.losses.{term}": (["0", "2.5", "null"], ["-0.1", ".inf"]) for term in ("silhouette", "depth", "normals")},
    "fit.views": (["null", "{}", "{blur: 0.5, per_step: 1, silhouette: squared}"], ["{blur: 0}", "{per_step: 0}"]),
    "fit.laplacian": (["uniform", "cotangent"], ["mean"]),
    "fit.optimizer.name": (["sgd", "adam"], ["lbfgs"]),
    "fit.optimizer.lr": (["1e-9", "1"], ["0", "-1", ".inf"]),
    "fit.optimizer.momentum": (["0", "0.999"], ["1", "-0.1"]),
    "fit.optimizer.schedule.name": (["constant", "cosine", "step"], ["linear"]),
    "fit.optimizer.schedule.final": (["0", "1"], ["-0.1", "1.1"]),
    "fit.optimizer.schedule.every": (["1"], ["0"]),
    "fit.optimizer.schedule.factor": (["1", "0.1"], ["0", "1.1"]),
    "fit.trace_every": (["1"], ["0"]),
    "fit.snapshots": (["1", "null"], ["0"]),
    "measure.surface": (["all", "outer"], ["inner", "null"]),
    "measure.samples": (["100"], ["99"]),
    "measure.points": (["100"], ["99"]),
    "measure.f_score_tau": (["0.1", "1%", "0.5 %"], ["0", "-1", "0%", "-1%", "nan%", "'%'", "1mm", "null", "true"]),
    "measure.crease_angle": (["30", "179.5"], ["0", "180", ".nan"]),
    "measure.seed": (["0"], ["-1"]),
}
INSIDE = [(key, value) for key, (inside, _) in RANGES.items() for value in inside]
OUTSIDE = [(key, value) for key, (_, outside) in RANGES.items() for value in outside]
NUMBERS = [
    key for key, (inside, _) in RANGES.items() if inside[0].lstrip("-").replace(".", "").replace("e", "").isdigit()
]


def nested(key, value):
    """A document whose last line holds the key."""
    parts = key.split(".")
    lines = [f"{'  ' * depth}{part}:" for depth, part in enumerate(parts)]
    return "\n".join(lines) + f" {value}\n", len(lines)


def keys_of(settings, before=""):
    for name in type(settings).model_fields:
        value = getattr(settings, name)
        yield from keys_of(value, f"{before}{name}.") if hasattr(value, "model_fields_set") else [before + name]


def test_every_key_is_tested_here():
    assert set(keys_of(ExperimentSettings())) - {"device"} <= RANGES.keys()


@over(("key", "value"), INSIDE)
def test_what_lies_inside_is_taken(key, value):
    text, _ = nested(key, value)
    assert build(ExperimentSettings, parse_document(text, "it").data) is not None


def refused(tmp_path, key, value):
    text, line = nested(key, value)
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_experiment(str(path))
    assert all("\n" not in fault for fault in caught.value.faults)
    message = caught.value.faults[0]
    assert message.startswith(f"{path}, line {line}: {key}")
    return message.removeprefix(f"{path}, line {line}: {key}")


@over(("key", "value"), OUTSIDE)
def test_what_lies_outside_is_refused_with_its_line(tmp_path, key, value):
    message = refused(tmp_path, key, value)
    assert re.search("got|duplicate|allowed|missing", message)


@over("value", ["true", "false", "'1'", "[1]", "{a: 1}"])
@over("key", NUMBERS)
def test_truth_texts_and_collections_are_no_numbers(tmp_path, key, value):
    assert refused(tmp_path, key, value).startswith(": expected ")


SAID = [
    ("fit.steps", "1.5", ": expected an integer, got 1.5"),
    ("fit.optimizer.lr", "'1'", ': expected a number, got "1"'),
    ("fit.optimizer.lr", ".nan", ": expected a finite number, got NaN"),
    ("fit.optimizer.lr", "0", ": expected a number above 0, got 0"),
    ("source.levels", "9", ": expected a number of 8 or less, got 9"),
    ("normalise", "Box", ": got \"Box\"; did you mean 'box'? allowed: tutorial, box, sphere, cube, none"),
    ("seeds", "[]", ": expected at least one entry, got []"),
    ("seeds", "[3, x]", '[1]: expected an integer, got "x"'),
    ("seeds", "[5, 1, 5]", ": duplicate entry 5"),
    ("schemes", "[lop]", "[0]: 'lop' is not a scheme: did you mean 'loop'? allowed: midpoint, loop"),
    ("schemes", "['interp-loop:alpha=1,weights=loop', interp-loop]", ": duplicate entry interp-loop"),
    ("source.centre", "[0, 0, 0, 0]", ": expected a shorter list, got [0, 0, 0, 0]"),
    ("fit", "3", ": expected a mapping of keys to values, got 3"),
    ("fit.stps", "3", ": no such key: did you mean 'steps'? allowed: method, steps"),
    ("fit.losses.egde", "3", ": no such key: did you mean 'edge'? allowed: chamfer, normal, edge"),
    ("seed", "3", ": no such key: did you mean 'seeds'? allowed: targets, target, define, schemes"),
    ("1", "3", ": no such key: allowed: targets"),
    ("source.creases", "30", ": expected a mapping of keys to values, got 30"),
    ("source.creases", "{}", ": expected either angle or file, got neither"),
    ("source.creases.angel", "30", ": no such key: did you mean 'angle'? allowed: angle, file, sharpness"),
    ("source", "{mesh: target, radius_of: area}", ": radius_of: has no effect with mesh: target; remove it"),
    ("source.alpha", "{file: a, attribute: b}", ": expected either file or attribute, got both"),
]


@over(("key", "value", "expected"), SAID)
def test_what_is_said(tmp_path, key, value, expected):
    assert refused(tmp_path, key, value).startswith(expected)


def test_unknown_keys_in_flow_mappings_have_the_line_they_stand_on(tmp_path):
    (tmp_path / "c.yaml").write_text("seeds: [0]\nfit: {steps: 3,\n  losses: {edge: 1,\n    chamfr: 2}}\n")
    with pytest.raises(ConfigError, match=r"c\.yaml, line 4: fit\.losses\.chamfr: no such key: did you mean 'chamfer'"):
        load_experiment(str(tmp_path / "c.yaml"))


def test_schemes_are_kept_in_their_one_canonical_form():
    data = {"schemes": ["interp-loop:weights=loop,alpha=0.5", "loop:weights=loop", "butterfly:tension=0.0625"]}
    assert build(ExperimentSettings, data).schemes == ("interp-loop:alpha=0.5", "loop", "butterfly")


def test_settings_nested_beyond_what_json_can_hold(tmp_path):
    (tmp_path / "c.yaml").write_text("seeds: " + "[" * 250 + "]" * 250)
    with pytest.raises(ConfigError, match=r"c\.yaml: settings that JSON cannot hold: recursion limit exceeded$"):
        load_experiment(str(tmp_path / "c.yaml"))


@over("value", ["0", "many", "2.5", "[1]"])
def test_a_count_that_is_refused_says_both_things_that_are_allowed(tmp_path, value):
    (tmp_path / "a.yaml").write_text(f"jobs: {value}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"line 1: jobs: expected auto or an integer of 1 or more, got .+"):
        load_experiment(str(tmp_path / "a.yaml"))
