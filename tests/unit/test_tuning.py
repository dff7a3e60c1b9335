"""The points that a search asks for, and what it makes of their results."""

import math

import pytest

from meshfit.config.loading import load_experiment, with_axes
from meshfit.config.sweep_samples import SampleSettings, read_ranges, sampled_points
from meshfit.config.sweeps import variants_of
from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.tuning.objectives import Objective, front, objectives_of, score
from meshfit.experiment.tuning.sampler import BATCH, FIRST, ask
from meshfit.experiment.tuning.search import Problem, run_search, start_search
from meshfit.experiment.tuning.search_file import COMPLETE, FAILED, Point, read_search, search_path
from tests.small import config_file

pytest.importorskip("optuna")
RANGES = read_ranges(
    {
        "fit.losses.edge": {"log": [0.01, 1]},
        "fit.optimizer.momentum": {"linear": [0, 0.9]},
        "fit.steps": {"log": [10, 1000], "integer": True},
        "source.levels": [2, 4, 3],
        "source.mesh": ["cube", "icosphere"],
    }
)
SAMPLE = SampleSettings(points=1)
SMALLEST = (Objective("distance.mean", maximise=False),)


def cost(changes):
    """A bowl whose least value, 0, is at edge 0.1, momentum 0.5, level 3 and the icosphere."""
    edge = math.log10(changes["fit.losses.edge"]) + 1
    momentum, level = changes["fit.optimizer.momentum"] - 0.5, changes["source.levels"] - 3
    return edge**2 + momentum**2 + level**2 + (changes["source.mesh"] == "cube")


def searched(batches, objectives=SMALLEST, values=lambda changes: (cost(changes),), sample=SAMPLE):
    points = []
    for batch in range(batches):
        asked = ask(points, RANGES, objectives, sample, batch)
        points += [Point(changes, "", COMPLETE, values(changes), batch=batch) for changes in asked]
    return points


def test_a_search_starts_with_a_design_and_then_comes_nearer_to_the_best_than_the_design_does():
    points = searched(9)
    assert [point.changes for point in points[:FIRST]] == sampled_points({"points": FIRST}, RANGES)
    assert len({str(point.changes) for point in points}) == len(points) == FIRST + 8 * BATCH
    best = min(cost(point.changes) for point in points)
    assert best < min(cost(changes) for changes in sampled_points({"points": len(points)}, RANGES))
    assert best < 0.03
    for point in points:
        assert 0.01 <= point.changes["fit.losses.edge"] <= 1
        assert type(point.changes["fit.steps"]) is int
        assert point.changes["source.levels"] in (2, 3, 4)
        assert float(f"{point.changes['fit.losses.edge']:.4g}") == point.changes["fit.losses.edge"]


def test_points_depend_on_the_points_before_and_the_seed_alone():
    points = searched(3)
    assert points == searched(3)
    assert ask(points, RANGES, SMALLEST, SAMPLE, 3) == ask(points, RANGES, SMALLEST, SAMPLE, 3)
    assert points[FIRST:] != searched(3, sample=SampleSettings(points=1, seed=1))[FIRST:]


def test_a_search_goes_away_from_points_that_fail():
    points = []
    for batch in range(5):
        for changes in ask(points, RANGES, SMALLEST, SAMPLE, batch):
            fails = changes["fit.optimizer.momentum"] > 0.45
            values = () if fails else (cost(changes),)
            points.append(Point(changes, "", FAILED if fails else COMPLETE, values, batch=batch))
    late = points[FIRST:]
    assert sum(point.state == FAILED for point in late) < len(late) / 3


def test_a_search_of_two_metrics_spreads_along_the_front():
    objectives = (Objective("distance.mean", maximise=False), Objective("f_score.f1", maximise=True))
    points = searched(4, objectives, lambda changes: (cost(changes), changes["fit.optimizer.momentum"]))
    found = front([point.values for point in points], objectives)
    for i in found:
        assert not any(p.values[0] < points[i].values[0] and p.values[1] > points[i].values[1] for p in points)
    assert len(found) > 1


def test_a_search_ends_where_all_combinations_have_been_tried():
    ranges = read_ranges({"source.levels": [2, 3, 4], "source.mesh": ["cube", "icosphere", None]})
    points = []
    for batch in range(4):
        asked = ask(points, ranges, SMALLEST, SAMPLE, batch)
        points += [Point(changes, "", COMPLETE, (1.0,), batch=batch) for changes in asked]
    assert len(points) == len({str(point.changes) for point in points}) == 9


def result(target, seed, **metrics):
    return {"target": target, "scheme": "loop", "seed": seed, "distance": {"mean": metrics.get("mean")}} | {
        "f_score": {"f1": metrics.get("f1")}
    }


def test_a_point_is_the_mean_over_seeds_and_the_geometric_mean_over_targets():
    results = [result("bunny", 0, mean=1.0), result("bunny", 1, mean=3.0), result("cow", 0, mean=8.0)]
    assert score(results, SMALLEST[0]) == pytest.approx(math.sqrt(2 * 8))
    shares = [result("bunny", 0, f1=0.5), result("cow", 0, f1=1.0)]
    assert score(shares, Objective("f_score.f1", maximise=True)) == pytest.approx(0.75)
    assert score([*results, result("cow", 1)], SMALLEST[0]) is None


def test_directions_are_those_of_the_metrics_unless_given():
    directions = {each.metric: each.maximise for each in objectives_of(["distance.mean", "f_score.f1"], [], [])}
    assert directions == {"distance.mean": False, "f_score.f1": True}
    assert objectives_of([], ["quality.verts"], []) == (Objective("quality.verts", maximise=True),)
    assert objectives_of(["f_score.f1"], [], ["f_score.f1"])[0].maximise is False
    for options, message in (
        ((["quality.verts"], [], []), "neither smaller nor larger is better; give --minimise quality.verts"),
        (([], ["distance.mean"], ["distance.mean"]), "got both"),
        ((["distance.men"], [], []), "did you mean 'distance.mean'"),
    ):
        with pytest.raises(ConfigError, match=message):
            objectives_of(*options)


def problem_of(tmp_path):
    text = "targets: [ellipsoid.ply]\nschemes: [loop]\nsource: {mesh: octahedron, levels: 1}\ndevice: cpu\n"
    experiment = load_experiment(str(config_file(tmp_path, text)))
    ranges = {"fit.losses.edge": {"log": [0.01, 1]}, "fit": [{"method": "first-order"}, {"method": "gauss-newton"}]}
    return Problem(experiment, read_ranges(ranges), SMALLEST, SAMPLE)


def test_settings_that_do_not_go_together_fail_and_the_file_holds_the_search(tmp_path, monkeypatch):
    problem, store = problem_of(tmp_path), RunDirectory(tmp_path / "runs")
    asked = []

    def run(trials):
        asked.append([trial.identity for trial in trials])
        return {}

    monkeypatch.setattr("meshfit.experiment.tuning.search.read_result", lambda folder: result("bunny", 0, mean=2.0))
    search = run_search(problem, start_search(problem, store.root), 10, store, run)
    assert len(search.complete) + len(search.failed) == 10
    assert {search.points[i].changes["fit"]["method"] for i in search.complete} == {"first-order"}
    assert all("fit.losses: no such key" in search.points[i].reason for i in search.failed)
    assert read_search(search_path(store.root, "small", search.key)) == search
    further = run_search(problem, start_search(problem, store.root), 20, store, run)
    assert further.points[:10] == search.points[:10]
    ran = [identity for identities in asked for identity in identities]
    assert len(ran) == len(set(ran)) == len(further.complete) + 1
    search_path(store.root, "small", search.key).write_text('{"schema_version": 1, "objectives": []}')
    with pytest.raises(StoreError, match="not a search: no 'experiment'; delete it"):
        start_search(problem, store.root)


def test_a_metric_without_values_is_refused(tmp_path, monkeypatch):
    problem, store = problem_of(tmp_path), RunDirectory(tmp_path / "runs")
    monkeypatch.setattr("meshfit.experiment.tuning.search.read_result", lambda folder: result("bunny", 0))
    with pytest.raises(ConfigError, match=r"distance\.mean: the results have no value; choose another --metric"):
        run_search(problem, start_search(problem, store.root), 10, store, lambda trials: {})


def test_defaults_that_depend_on_a_swept_setting_hold_on_the_command_line_too(tmp_path):
    text = "targets: [bunny]\nsource: {mesh: cube}\nsweep: {source.mesh: [icosphere, target]}\n"
    experiment = with_axes(load_experiment(str(config_file(tmp_path, text))))
    assert [variant.settings.source.levels for variant in variants_of(experiment.settings)] == [4, 0]
