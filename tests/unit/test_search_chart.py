"""The chart and the text of a search."""

import re
from itertools import accumulate

import pytest

from meshfit.config.sweep_samples import read_ranges, sampled_points
from meshfit.errors import ConfigError
from meshfit.experiment.tuning.objectives import Objective
from meshfit.experiment.tuning.search_file import COMPLETE, FAILED, OWN, Point, Search
from meshfit.report.figures.search import best_so_far, write_search_chart
from meshfit.report.tables.search import search_notes, search_rows, search_title

RANGES = read_ranges(
    {
        "fit.losses.edge": {"log": [0.01, 1]},
        "fit.optimizer.momentum": {"linear": [0, 0.9]},
        "source": [{"mesh": "cube"}, {"mesh": "icosahedron", "levels": 2}, {"mesh": "icosahedron", "levels": 3}],
    }
)
SMALLER, LARGER = Objective("distance.mean", maximise=False), Objective("f_score.f1", maximise=True)


def search(*objectives, points=40, fails=lambda i: i % 5 == 1):
    tried = []
    for i, changes in enumerate(sampled_points({"points": points}, RANGES)):
        values = (1.0 / (1 + i % 7) + 0.01 * changes["fit.losses.edge"], changes["fit.optimizer.momentum"])
        if i == 3:
            values = (1e6, values[1])  # a fit that nearly diverged
        state, batch = FAILED if fails(i) else COMPLETE, max(0, (i - 8) // 8)
        told = values[: len(objectives)] if state == COMPLETE else ()
        tried.append(Point(changes, f"p{i}", state, told, "" if told else f"diverged at step {i}", batch))
    own = Point({}, OWN, COMPLETE, (0.5, 0.5)[: len(objectives)])
    cells = {"targets": ["bunny"], "schemes": ["loop"], "seeds": [0]}
    return Search("my-tune", "0", objectives, RANGES, cells, own, tuple(tried))


def texts(path):
    """The words of an SVG, whose letters stand in comments beside their outlines."""
    return re.findall(r"<!-- (.+?) -->", path.read_text())


@pytest.mark.parametrize("objective", [SMALLER, Objective("distance.mean", maximise=True)])
def test_the_best_so_far_is_the_running_best_of_complete_points(objective):
    one = search(objective)
    numbers, best = best_so_far(one)
    values = {i + 1: one.points[i].values[0] for i in one.complete}
    running = dict(zip(values, accumulate(values.values(), max if objective.maximise else min), strict=True))
    assert best == list(dict.fromkeys(running.values()))
    assert [values[number] for number in numbers] == best
    assert numbers[-1] == one.best[0] + 1


def test_the_chart_has_the_best_its_settings_and_what_failed_and_the_same_bytes_each_time(tmp_path):
    one = search(SMALLER)
    for name in ("a.svg", "b.svg"):
        write_search_chart({"my-tune": one}, tmp_path / name, {"fit.optimizer.momentum": "inertia"})
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    found, best = texts(tmp_path / "a.svg"), one.points[one.best[0]]
    value, edge, momentum, source, number = search_rows(one)[0]
    assert f"best so far: {value} at point {number}" in found
    assert {f"edge = {edge}", f"inertia = {momentum}", "8 failed", "mean distance (smaller is better)"} <= set(found)
    assert float(edge) == best.changes["fit.losses.edge"]
    assert {"spread evenly", "searched"} <= set(found)
    assert "1000" not in found, "one far value leaves the others their room"
    assert f"source = {source}"[:20] in " ".join(found)


def test_two_metrics_are_drawn_as_their_front_and_several_searches_below_each_other(tmp_path):
    two = search(SMALLER, LARGER)
    write_search_chart({"one": search(SMALLER, points=4), "two": two}, tmp_path / "c.svg")
    found = texts(tmp_path / "c.svg")
    assert {"one", "two", "Pareto front", "F-score (larger is better)", "8 failed (not drawn)"} <= set(found)
    assert {str(i + 1) for i in two.best} <= set(found)
    assert len(search_rows(two)) == len(two.best) + 1
    with pytest.raises(ConfigError, match="three: none of its points is complete"):
        write_search_chart({"three": search(SMALLER, fails=lambda _: True)}, tmp_path / "d.svg")


def test_the_text_says_how_many_failed_and_why():
    one = search(SMALLER)
    assert search_title(one) == "distance.mean: best settings of 40 points, 8 failed"
    assert "8 points failed, such as: diverged at step 1" in search_notes(one)
    assert search_rows(one, most=3)[-1] == ("0.5000", "", "", "", OWN)
    assert len(search_rows(one, most=3)) == 4
