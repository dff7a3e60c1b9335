"""Sensitivity: functions whose indices are known, and run directories written by hand."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import qmc, spearmanr

from meshfit.errors import ConfigError, StoreError
from meshfit.report.tables.sensitivity import POOLED, read_sensitivity
from meshfit.sensitivity import Factor, analyse
from tests.cli import answered, refused
from tests.runs import result_of

pytest.importorskip("sklearn")


def sample(settings, points=64):
    return qmc.Sobol(settings, rng=np.random.default_rng(3)).random(points)


def analysed(function, settings, points=64):
    x = sample(settings, points)
    return analyse([Factor(f"x{i}", x[:, i]) for i in range(settings)], function(x))


def ishigami(x):
    x = (2 * x - 1) * np.pi
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


A = np.array([0.0, 1.0, 4.5, 9.0])


def g_function(x):
    return np.prod((np.abs(4 * x - 2) + A) / (1 + A), axis=1)


def g_indices():
    parts = 1 / (3 * (1 + A) ** 2)
    whole = np.prod(1 + parts) - 1
    return parts / whole, parts * np.prod(1 + parts) / (1 + parts) / whole


CASES = [
    # Ishigami and Homma (1990) with a = 7, b = 0.1
    (ishigami, 128, [0.3139, 0.4424, 0.0], [0.5576, 0.4424, 0.2437], {("x0", "x2"): 0.2437}),
    (g_function, 128, *g_indices(), {("x0", "x1"): 0.0580}),
    # Var(x0 x1) = 7/144, of which each explains 1/48 alone.
    (lambda x: x[:, 0] * x[:, 1], 64, [3 / 7, 3 / 7, 0], [4 / 7, 4 / 7, 0], {("x0", "x1"): 1 / 7}),
    (lambda x: (x[:, 0] - 0.5) * (x[:, 1] - 0.5), 64, [0, 0, 0], [1, 1, 0], {("x0", "x1"): 1.0}),
]


@pytest.mark.parametrize(("function", "points", "first", "total", "together"), CASES)
def test_indices_of_known_functions_are_found_within_their_intervals(function, points, first, total, together):
    found = analysed(function, len(first), points)
    assert found.q2 is not None
    assert found.q2 > 0.7
    for effect in found.effects:
        place = int(effect.factor.name[1:])
        assert effect.first.value == pytest.approx(first[place], abs=0.06)
        assert effect.total.value == pytest.approx(total[place], abs=0.08)
        assert effect.first.low - 0.02 <= first[place] <= effect.first.high + 0.02
        assert effect.total.low - 0.02 <= total[place] <= effect.total.high + 0.02
    named = {tuple(sorted(pair.names)): pair.share.value for pair in found.interactions}
    for names, share in together.items():
        assert named[names] == pytest.approx(share, abs=0.1)
    assert max(named, key=named.get) == next(iter(together))


def test_rank_correlations_are_spearmans_and_do_not_depend_on_a_monotone_scale():
    x = sample(2)
    noisy = x[:, 0] + 0.3 * np.sin(40 * x[:, 1])
    plain, bent = (analyse([Factor("x", x[:, 0])], response) for response in (noisy, np.exp(5 * noisy)))
    assert plain.effects[0].rank == bent.effects[0].rank
    assert plain.effects[0].rank.value == pytest.approx(spearmanr(x[:, 0], noisy).statistic)
    assert plain.effects[0].rank.low < plain.effects[0].rank.value < plain.effects[0].rank.high
    monotone = analyse([Factor("x", x[:, 0])], -(x[:, 0] ** 3)).effects[0]
    assert monotone.rank.value == pytest.approx(-1)
    assert monotone.moves


def test_noise_has_no_indices_and_moves_about_one_setting_in_twenty():
    generator = np.random.default_rng(1)
    factors = [Factor(f"x{i}", column) for i, column in enumerate(generator.random((60, 60)))]
    many = analyse(factors, generator.normal(size=60))
    assert many.why_not == "60 points are too few for a surrogate of 60 settings; it takes 300"
    assert sum(effect.moves for effect in many.effects) <= 8
    one = analyse(factors[:2], generator.normal(size=60))
    assert one.effects[0].total is None
    assert "(Q²), less than 0.7" in one.why_not


def test_categories_have_a_share_of_the_variance_of_ranks_and_indices_of_their_own():
    codes = np.arange(60) % 3
    x = sample(1, 64)[:60, 0]
    response = np.array([0.0, 10.0, 1.0])[codes] + 0.001 * x
    found = analyse([Factor("kind", codes.astype(float), ("a", "b", "c")), Factor("x", x)], response)
    kind = found.effects[0]
    assert kind.factor.name == "kind"
    assert kind.rank.value > 0.85
    assert kind.moves
    assert kind.ends == ("a", "b")
    assert kind.first.value == pytest.approx(1, abs=0.03)
    assert found.effects[1].total.value == pytest.approx(0, abs=0.03)


def test_the_change_of_a_setting_with_a_few_values_is_between_its_ends():
    levels = np.repeat([1.0, 2.0, 3.0], [21, 22, 21])
    effect = analyse([Factor("levels", levels)], levels**2).effects[0]
    assert (effect.ends, effect.low, effect.high) == (("1", "3"), 1, 9)


def test_twins_are_left_out_together():
    x = np.repeat(np.random.default_rng(0).random(30), 2)
    noise = np.repeat(np.random.default_rng(1).normal(size=30), 2)
    groups = np.repeat(np.arange(30), 2)
    alone = analyse([Factor("x", x), Factor("side", np.tile([0.0, 1.0], 30), ("a", "b"))], noise)
    together = analyse([Factor("x", x), Factor("side", np.tile([0.0, 1.0], 30), ("a", "b"))], noise, groups)
    assert together.q2 < 0.3 < alone.q2


def results(points=32, targets=("bunny", "cow"), schemes=("loop", "butterfly"), seeds=(0, 1)):
    """Results whose mean distance is edge², times 3 for the cow, and times 1 + steps / 100 for the second scheme."""
    found = []
    for row in sample(3, 64)[:points]:
        edge, steps, name = 0.01 * 100 ** row[0], int(10 + 90 * row[1]), "sgd" if row[2] < 0.5 else "adam"
        for target in targets:
            for scheme in schemes:
                for seed in seeds:
                    fit = {"losses": {"edge": edge}, "steps": steps, "optimizer": {"name": name}}
                    result = result_of(target, scheme, seed, "swept", **fit)
                    factor = 1 + steps / 100 if scheme == schemes[-1] else 1.0
                    result["distance"]["mean"] = edge**2 * factor * (3 if target == "cow" else 1) * (1 + 0.01 * seed)
                    found.append(result)
    return found


def test_settings_of_runs_are_analysed_per_target_and_pooled():
    found = read_sensitivity(results(), "distance.mean")
    assert list(found.groups) == [POOLED, "bunny", "cow"]
    assert found.is_log
    for analysis in found.groups.values():
        first = analysis.effects[0]
        assert first.factor.name == "fit.losses.edge"
        assert first.factor.is_log
        assert first.rank.value > 0.95
        assert first.total.value > 0.9
        assert {effect.factor.name for effect in analysis.effects} == {
            *("fit.losses.edge", "fit.steps", "fit.optimizer.name", "scheme")
        }


def test_a_baseline_shows_what_moves_the_difference_of_schemes():
    found = read_sensitivity(results(), "distance.mean", "loop")
    for analysis in found.groups.values():
        first = analysis.effects[0]
        assert first.factor.name == "fit.steps"
        assert first.rank.value > 0.999
        assert first.total.value == pytest.approx(1, abs=0.01)
        assert "scheme" not in [effect.factor.name for effect in analysis.effects]
    with pytest.raises(ConfigError, match="expected one of several schemes"):
        read_sensitivity(results(), "distance.mean", "midpoint")


def test_settings_that_change_together_are_one():
    swept = results(16, ("cow",), ("loop",), (0,))
    for result in swept:
        steps = result["settings"]["fit"]["steps"]
        result["settings"]["fit"]["samples"] = 10 * steps
    names = [effect.factor.name for effect in read_sensitivity(swept, "distance.mean").groups["cow"].effects]
    assert sorted(names) == ["fit.losses.edge", "fit.optimizer.name", "fit.steps = fit.samples"]


def test_a_setting_that_comes_with_a_category_is_left_out_and_named():
    swept = results(16, ("cow",), ("loop",), (0,))
    for place, result in enumerate(swept):
        mesh = ("cube", "octahedron", "target")[place % 3]
        result["settings"]["source"] |= {"mesh": mesh, "levels": 2 if mesh == "target" else 4}
    found = read_sensitivity(swept, "distance.mean")
    names = {effect.factor.name for effect in found.groups["cow"].effects}
    assert names == {"fit.losses.edge", "fit.optimizer.name", "fit.steps", "source.mesh"}
    assert "source.levels: left out, since source.mesh determines it" in found.notes


def test_what_cannot_be_analysed_is_refused():
    with pytest.raises(StoreError, match="1 point that differ in 0 settings; expected 8 or more"):
        read_sensitivity(results(points=1, schemes=("loop",)), "distance.mean")
    with pytest.raises(ConfigError, match="none of 32 results has it"):
        read_sensitivity(results(points=4), "vertex_error.rms")
    with pytest.raises(ConfigError, match="did you mean"):
        read_sensitivity(results(points=4), "distance.men")


def test_the_command_prints_a_table_and_writes_csv_json_and_a_chart(tmp_path):
    for number, result in enumerate(results(24, ("cow",), ("loop",), (0,))):
        folder = tmp_path / "swept" / result["target"] / result["scheme"] / f"seed-0-{number:010x}"
        folder.mkdir(parents=True)
        (folder / "result.json").write_text(json.dumps(result | {"identity": f"{number:010x}"}))
    text = answered("sensitivity", tmp_path / "swept", "--metric", "distance.mean", "-q", "-o", tmp_path / "chart.png")
    assert "cow: 24 points, Q² " in text
    assert text.splitlines()[4].startswith("edge  ")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    for number, kind in enumerate(("diverged", "diverged", "memory")):
        folder = tmp_path / "swept" / "cow" / "loop" / f"seed-0-f{number:09x}"
        folder.mkdir()
        (folder / "failure.json").write_text(json.dumps({"kind": kind, "message": f"at step {number}"}))
    without = {**results(1)[0], "distance": {}, "identity": "e000000000"}
    folder.with_name("seed-0-e000000000").mkdir()
    (folder.with_name("seed-0-e000000000") / "result.json").write_text(json.dumps(without))
    command = ("sensitivity", tmp_path / "swept", "--metric", "distance.mean", "-q", "-f")
    lines = answered(*command, "rich").splitlines()
    assert "Not in the analysis: 4 trials." in lines
    named = "(cow/loop/seed-0-f000000000, cow/loop/seed-0-f000000001)"
    assert f"2 failed, such as: diverged: at step 0 {named}" in lines
    assert "1 no value: the result has no distance.mean (cow/loop/seed-0-e000000000)" in lines
    assert [each["state"] for each in json.loads(answered(*command, "json"))["absent"]] == [*["failed"] * 3, "no value"]
    markdown = answered(*command, "md").splitlines()
    assert markdown[4] == "| setting | rank | from | to | change | first-order | total |"
    assert all(line.count("|") == markdown[4].count("|") for line in markdown[4:8])
    assert markdown[6].startswith("| edge | ρ ")
    rows = list(csv.DictReader(answered(*command, "csv").splitlines()))
    effects = json.loads(answered(*command, "json"))["effects"]
    assert [row["setting"] for row in rows] == [effect["setting"] for effect in effects]
    assert float(rows[0]["total"]) == effects[0]["total"] > 0.9
    assert "did you mean 'distance.mean'" in refused("sensitivity", tmp_path / "swept", "--metric", "distance.men")
    assert "no such run directory" in refused("sensitivity", tmp_path / "nothing")
    assert "allowed" in refused("sensitivity", tmp_path / "swept", "-o", tmp_path / "chart.txt")
