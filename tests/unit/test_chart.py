"""The chart of results: its contents and its refusals."""

import re
from dataclasses import replace

import pytest

from meshfit.errors import ConfigError
from meshfit.report.figures.chart import geometric_means, write_chart
from meshfit.report.tables.table import build_tables
from tests.cli import answered, refused
from tests.runs import complete, result_of

SCHEMES = ("loop", "interp-loop", "interp-loop:alpha=0.5", "midpoint")


def results(**changes):
    found = []
    for engine, fit in (("first", {}), ("second", {"method": "gauss-newton"})):
        for target in ("bunny", "cow"):
            for place, scheme in enumerate(SCHEMES):
                one = result_of(target, scheme, **fit) | {"variant": engine}
                found.append(one | {"hausdorff": one["hausdorff"] | {"symmetric": 0.01 * (place + 1)}} | changes)
    return found


def texts(path):
    """The words of an SVG, whose letters stand in comments beside their outlines."""
    return re.findall(r"<!-- (.+?) -->", path.read_text())


def test_schemes_stand_under_their_kind_and_each_setting_has_a_panel(tmp_path):
    path = tmp_path / "chart.svg"
    write_chart(build_tables(results()), path)
    found = texts(path)
    kinds = [text for text in found if text in (*SCHEMES, "approximating", "interpolatory")]
    order = ["approximating", "loop", "interp-loop:alpha=0.5", "interpolatory", "midpoint", "interp-loop"]
    assert kinds == order
    assert {"first", "second", "the bunny", "the cow", "geometric mean"} <= set(found)
    assert found.count("Hausdorff distance") == 2


def test_the_same_numbers_give_the_same_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        write_chart(build_tables(results()), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_scheme_without_results_in_one_setting_leaves_its_line_free(tmp_path):
    some = [one for one in results() if not (one["variant"] == "first" and one["scheme"] == "loop")]
    write_chart(build_tables(some), tmp_path / "chart.svg")
    assert "loop" in texts(tmp_path / "chart.svg")


def test_geometric_means_are_over_all_targets_or_none():
    some = [one for one in results() if (one["target"], one["scheme"]) != ("cow", "midpoint")]
    for table in build_tables(some):
        (variation,) = table.variations
        samples = {
            key: {seed: value * (4 if key[1] == "cow" else 1) for seed, value in sample.items()}
            for key, sample in variation.samples.items()
        }
        doubled = replace(table, variations=(replace(variation, samples=samples),))
        assert geometric_means(doubled) == pytest.approx(
            {"loop": 0.02, "interp-loop": 0.04, "interp-loop:alpha=0.5": 0.06}
        )
    alone = [one for one in results() if one["target"] == "cow"]
    assert all(geometric_means(table) == {} for table in build_tables(alone))


def test_what_a_logarithm_does_not_take_is_refused(tmp_path):
    zero = results(quality={"flipped_faces": 0, "self_intersecting_faces": 0})
    with pytest.raises(ConfigError, match=r"quality\.flipped_faces: a chart has a logarithmic scale"):
        write_chart(build_tables(zero, "quality.flipped_faces"), tmp_path / "chart.svg")


def test_the_command_writes_it_and_refuses_what_is_no_picture(tmp_path):
    complete(tmp_path / "runs")
    path = tmp_path / "chart.pdf"
    assert str(path) in answered("chart", str(tmp_path / "runs"), "-o", str(path))
    assert path.read_bytes().startswith(b"%PDF")
    assert "not a known picture format" in refused("chart", str(tmp_path / "runs"), "-o", str(tmp_path / "chart.gif"))


def test_intervals_widen_the_axis_and_one_that_includes_zero_runs_off_it(tmp_path):
    pytest.importorskip("matplotlib")
    paths = [tmp_path / f"{name}.svg" for name in ("one", "near", "far")]
    for path, spreads in zip(paths, ([1.0], [0.99, 1.01], [0.5, 1.5]), strict=True):
        seeds = [
            one | {"seed": seed, "hausdorff": {**one["hausdorff"], "symmetric": one["hausdorff"]["symmetric"] * factor}}
            for seed, factor in enumerate(spreads)
            for one in results()
        ]
        write_chart(build_tables(seeds), path)
    lines = [path.read_text().count("stroke-width: 0.8") for path in paths]
    assert lines[0] < lines[2] < lines[1]  # no interval, upper ends only, both ends
