"""Result tables: which results share one, their order, and gaps and contradictions."""

from statistics import mean, stdev

import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.errors import ConfigError, SchemeError, StoreError
from meshfit.measuring.metrics import DEFAULT_METRIC
from meshfit.report.tables.grouping import distinguish_definitions
from meshfit.report.tables.paper_numbers import paper_value
from meshfit.report.tables.table import Row, build_tables
from meshfit.settings import deep_merge

TITLES = {"mousehead": "mousehead (stand-in)"}


def result(target="bunny", scheme="loop", seed=0, value=0.2, experiment="table1", **changes):
    """A result as a run leaves it, as far as reports look at it; `changes` are settings, `a__b` for a.b."""
    stem = target.rpartition("/")[2].partition(".")[0]
    found = ExperimentSettings(targets=(target,), schemes=(scheme,), seeds=(seed,)).model_dump(mode="json")
    for key, change in changes.items():
        for part in reversed(key.split("__")):
            change = {part: change}  # noqa: PLW2901
        found = deep_merge(found, change)
    return {
        "schema_version": 1,
        "identity": f"{seed:064x}",
        "experiment": experiment,
        "target": stem,
        "target_title": TITLES.get(target, stem),
        "scheme": scheme,
        "seed": seed,
        "hausdorff": {"forward": value, "symmetric": value},
        "f_score": {"f1": value},
        "quality": {"self_intersecting_faces": round(value * 1000), "euler_number": 2},
        "inputs": {"target": "00"},
        "settings": found,
    }


def grid(values, **changes):
    """Results from {(target, scheme): values by position of the seed}."""
    return [
        result(target, scheme, seed, value, **changes)
        for (target, scheme), sample in values.items()
        for seed, value in enumerate(sample)
    ]


CLEAR = {
    ("bunny", "loop"): [0.30, 0.31, 0.32],
    ("bunny", "interp-loop"): [0.20, 0.211, 0.219],
    ("mousehead", "loop"): [0.10, 0.12, 0.11],
    ("mousehead", "interp-loop"): [0.12, 0.10, 0.115],
}


def cells(table):
    return {(target, row.scheme): summary for (_, target, row), summary in table.cells.items()}


def best(table):
    return {target: row.scheme for (_, target), row in table.best.items()}


def on_targets(table):
    return [comparison for comparison in table.comparisons if comparison.target is not None]


def test_cells_are_summaries_over_seeds():
    (table,) = build_tables(grid(CLEAR))
    for cell, values in CLEAR.items():
        assert cells(table)[cell].mean == pytest.approx(mean(values))
        assert cells(table)[cell].spread == pytest.approx(stdev(values))
    assert table.seeds == (0, 1, 2)


def test_rows_and_columns_have_a_fixed_order_whatever_the_order_of_results():
    schemes = ["interp-loop:alpha=0.5", "sqrt3", "interp-loop", "loop", "midpoint"]
    targets = ["cow", "mousehead", "bone", "bunny"]
    (table,) = build_tables([result(target, scheme) for target in targets for scheme in schemes])
    assert table.schemes == ("midpoint", "loop", "interp-loop", "interp-loop:alpha=0.5", "sqrt3")
    assert list(table.targets) == ["bunny", "mousehead", "bone", "cow"]


def test_a_wanted_order_comes_first():
    found = [result(target, scheme) for target in ("bunny", "cow") for scheme in ("midpoint", "loop", "interp-loop")]
    (table,) = build_tables(found, schemes=["interp-loop", "loop"], targets=["cow"])
    assert table.schemes == ("interp-loop", "loop", "midpoint")
    assert list(table.targets) == ["cow", "bunny"]
    assert {comparison.against.scheme for comparison in table.comparisons} == {"interp-loop"}


def test_differences_are_paired_with_the_first_row_or_the_baseline():
    (table,) = build_tables(grid(CLEAR))
    first = table.comparisons[0]
    assert (first.target, first.row, first.against) == ("bunny", Row(0, "interp-loop"), Row(0, "loop"))
    assert first.difference.mean == pytest.approx((-0.1 - 0.099 - 0.101) / 3)
    assert [comparison.difference.significant for comparison in on_targets(table)] == [True, False]
    (turned,) = build_tables(grid(CLEAR), baseline="interp-loop:alpha=1")
    assert turned.comparisons[0].row.scheme == "loop"
    assert turned.comparisons[0].difference.mean == pytest.approx(-first.difference.mean)


def test_a_best_cell_is_named_only_where_it_is_significant():
    (table,) = build_tables(grid(CLEAR))
    assert best(table) == {"bunny": "interp-loop"}


def test_the_best_is_the_largest_where_larger_is_better_and_none_where_neither_is():
    (scores,) = build_tables(grid(CLEAR), "f_score.f1")
    assert best(scores) == {"bunny": "loop"}
    (euler,) = build_tables(grid(CLEAR), "quality.euler_number")
    assert euler.best == {}


def test_the_best_has_to_differ_from_every_other_scheme():
    close = CLEAR | {("bunny", "butterfly"): [0.21, 0.20, 0.22]}
    (table,) = build_tables(grid(close))
    assert "bunny" not in best(table)


def test_results_with_other_settings_get_a_table_of_their_own():
    tables = build_tables(grid(CLEAR) + grid(CLEAR, fit__steps=100) + grid(CLEAR, dtype="float64"))
    assert [table.title for table in tables] == [
        "table1 · fit.steps=2000, dtype=float32",
        "table1 · fit.steps=100, dtype=float32",
        "table1 · fit.steps=2000, dtype=float64",
    ]
    assert all(cells(table).keys() == CLEAR.keys() for table in tables)


def test_a_single_table_is_titled_by_its_experiments():
    (table,) = build_tables([result(seed=0), result(seed=1, experiment="quick")])
    assert table.title == "table1 + quick"
    assert cells(table)["bunny", "loop"].count == 2


def test_results_of_another_schema_version_are_kept_apart():
    tables = build_tables([result(), result(seed=1) | {"schema_version": 2}])
    assert [table.title for table in tables] == ["table1 · schema_version=1", "table1 · schema_version=2"]


def test_where_a_source_file_lies_does_not_split_a_table_and_its_content_does():
    here, there = (result(seed=seed, source__mesh=f"/{seed}/ball.ply") for seed in (0, 1))
    assert len(build_tables([here, there])) == 1
    assert len(build_tables([here | {"inputs": {"source": "a"}}, there | {"inputs": {"source": "b"}}])) == 2


def test_a_repeated_result_counts_once():
    (table,) = build_tables([result(), result(experiment="again")])
    assert cells(table)["bunny", "loop"].count == 1


def test_repeated_results_that_disagree_are_an_error_naming_both():
    second = result(value=0.25, experiment="again") | {"folder": "runs/again/bunny"}
    with pytest.raises(StoreError) as caught:
        build_tables([result("bunny"), second])
    for word in ("bunny, loop, seed 0", "hausdorff.symmetric", "0.2 (table1", "0.25 (runs/again/bunny)"):
        assert word in str(caught.value)


def test_a_users_own_bunny_is_not_the_named_one():
    (table,) = build_tables([result("bunny"), result("mine/bunny.ply", value=0.4)])
    assert dict(table.targets) == {"bunny": "bunny [bunny]", "bunny.ply": "bunny [bunny.ply]"}
    assert paper_value("bunny.ply", "loop") is None


def test_a_gap_is_a_cell_left_out():
    values = dict(CLEAR)
    del values["mousehead", "loop"]
    (table,) = build_tables(grid(values))
    assert ("mousehead", "loop") not in cells(table)
    assert [comparison.target for comparison in table.comparisons] == ["bunny"]
    assert "mousehead" not in best(table)


def test_a_result_without_the_figure_is_a_gap():
    (table,) = build_tables([result(), result(scheme="midpoint") | {"hausdorff": {}}])
    assert table.schemes == ("midpoint", "loop")
    assert list(table.cells) == [(DEFAULT_METRIC, "bunny", Row(0, "loop"))]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "0.2"])
def test_a_figure_that_is_no_number_is_refused(value):
    with pytest.raises(StoreError, match=r"bunny, loop, seed 0: hausdorff\.symmetric is"):
        build_tables([result(value=0.2) | {"hausdorff": {"symmetric": value}}])


def test_no_results_make_no_table():
    assert build_tables([]) == []


def test_an_unknown_metric_is_refused_with_a_suggestion():
    with pytest.raises(ConfigError, match=r"did you mean 'hausdorff\.symmetric'"):
        build_tables([result()], "hausdorf.symetric")


def test_a_baseline_without_results_is_refused():
    with pytest.raises(ConfigError, match="baseline 'midpoint' has no results: allowed: loop"):
        build_tables([result()], baseline="midpoint")
    with pytest.raises(SchemeError, match="loopy"):
        build_tables([result()], baseline="loopy")


def test_different_files_of_one_name_are_different_targets():
    """Two runs of a target that was edited between them, as ShapeNet's `model_normalized.obj` in two folders."""
    first, second = (result("a/model.obj", seed=0, value=value) for value in (0.2, 0.4))
    second = second | {"inputs": {"target": "11"}}
    (table,) = build_tables(distinguish_definitions([first, second]))
    assert [each.mean for each in table.cells.values()] == [0.2, 0.4]
    assert list(table.targets.values()) == ["model [00]", "model [11]"]
    labelled = [each | {"target": name} for each, name in ((first, "a-model"), (second, "b-model"))]
    (table,) = build_tables(distinguish_definitions(labelled))
    assert list(table.targets.values()) == ["a-model", "b-model"]
