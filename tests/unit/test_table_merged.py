"""Merged tables: which tables are shown as one, with unchanged contents."""

import pytest

from meshfit.report.tables.table import VARIED, Row, build_tables, merge_tables
from meshfit.statistics import mean_difference
from tests.unit.test_table_model import CLEAR, grid, result

DEFAULT = "hausdorff.symmetric"
EDGES = (10.0, 0.1, 1.0)


def scaled(factor, values=CLEAR):
    return {cell: [factor * value for value in sample] for cell, sample in values.items()}


def names(table):
    return tuple(variation.name for variation in table.variations)


def sweep(values=CLEAR, **changes):
    """The same experiment with three weights, the numbers of each larger than those before."""
    found = enumerate(EDGES, start=1)
    return [one for at, edge in found for one in grid(scaled(at, values), fit__losses__edge=edge, **changes)]


def merged(results, *metrics, **options):
    return merge_tables(build_tables(results, *metrics, **options))


def test_one_table_stays_as_it_is_and_needs_no_name():
    (table,) = merged(grid(CLEAR))
    assert (table.title, names(table), table.metrics) == ("table1", ("",), (DEFAULT,))
    assert table.rows == (Row(0, "loop"), Row(0, "interp-loop"))
    assert build_tables(grid(CLEAR)) == table.split() == [table]


def test_metrics_of_the_same_settings_stand_side_by_side():
    (table,) = merged(grid(CLEAR), "f_score.f1", DEFAULT)
    assert table.metrics == ("f_score.f1", DEFAULT)
    assert len(table.rows) == 2
    assert table.best == {(DEFAULT, "bunny"): Row(0, "interp-loop"), ("f_score.f1", "bunny"): Row(0, "loop")}
    assert [one.metric for one in table.comparisons] == ["f_score.f1"] * 3 + [DEFAULT] * 3


def test_variations_of_an_experiment_stand_below_each_other_and_the_setting_is_varied():
    (table,) = merged(sweep())
    assert table.title == "table1"
    assert names(table) == ("edge=0.1", "edge=1.0", "edge=10.0")
    assert table.settings["fit.losses.edge"] == VARIED
    assert table.settings["fit.steps"] == 2000
    assert len(table.rows) == 6


def test_a_planned_order_is_kept():
    (table,) = merged([each | {"place": (0, 0, 0, number)} for number, each in enumerate(sweep())])
    assert names(table) == ("edge=0.1", "edge=1.0", "edge=10.0")  # a plan without variants does not decide
    places = {edge: place for place, edge in enumerate(EDGES)}
    placed = [each | {"place": (places[each["settings"]["fit"]["losses"]["edge"]], 0, 0, 0)} for each in sweep()]
    (table,) = merged(placed[::-1])
    assert names(table) == ("edge=10.0", "edge=0.1", "edge=1.0")


def test_every_cell_of_a_merged_table_is_that_of_its_own_table():
    (table,) = merged(sweep())
    for place, edge in enumerate(sorted(EDGES)):
        (alone,) = build_tables(grid(scaled(EDGES.index(edge) + 1), fit__losses__edge=edge))
        for (_, target, row), summary in alone.cells.items():
            cell = (DEFAULT, target, Row(place, row.scheme))
            assert table.cells[cell] == summary
            assert table.samples[cell] == alone.samples[DEFAULT, target, row]
        within = [one.difference for one in table.comparisons if one.row.variation == one.against.variation == place]
        assert within == [one.difference for one in alone.comparisons]


def test_the_baseline_is_compared_with_what_it_was_in_the_first_variation():
    (table,) = merged(sweep(), baseline="interp-loop")
    across = [one for one in table.comparisons if one.row.variation != one.against.variation]
    assert {(one.row.scheme, one.against) for one in across} == {("interp-loop", Row(0, "interp-loop"))}
    at = {(one.target, one.row.variation): one.difference for one in across}
    pairs = {
        target: [table.samples[DEFAULT, target, Row(place, "interp-loop")] for place in (1, 0)]
        for target in ("bunny", "mousehead")
    }
    assert at["bunny", 1] == mean_difference([pairs["bunny"]], smaller_is_better=True)
    assert at[None, 1] == mean_difference([tuple(pair) for pair in pairs.values()], smaller_is_better=True)
    assert set(at) == {(target, place) for target in ("bunny", "mousehead", None) for place in (1, 2)}


def test_the_best_of_a_merged_column_beats_the_rows_of_all_variations():
    clear = {("bunny", "loop"): [0.30, 0.31, 0.32], ("bunny", "interp-loop"): [0.20, 0.211, 0.219]}
    (table,) = merged(grid(clear, fit__steps=1) + grid(scaled(0.5, clear), fit__steps=2))
    assert table.best == {(DEFAULT, "bunny"): Row(1, "interp-loop")}
    (close,) = merged(grid(clear, fit__steps=1) + grid(scaled(1.001, clear), fit__steps=2))
    assert close.best == {(DEFAULT, "bunny"): Row(0, "interp-loop")}  # the same seeds, each a little worse
    (equal,) = merged(grid(clear, fit__steps=1) + grid(clear, fit__steps=2))
    assert equal.best == {}


@pytest.mark.parametrize("apart", [{"normalise": "box"}, {"measure__samples": 5}, {"measure__f_score_tau": 0.5}])
def test_what_is_measured_differently_stays_apart(apart):
    (key,) = apart
    found = merged(sweep() + sweep(**apart))
    assert [len(table.variations) for table in found] == [3, 3]
    assert all(table.title.startswith(f"table1 · {key.replace('__', '.')}=") for table in found)
    assert "edge" not in found[0].title


def test_other_schema_versions_and_other_experiments_stay_apart():
    assert len(merged([result(), result(fit__steps=1) | {"schema_version": 2}])) == 2
    assert len(merged([result(), result(fit__steps=1, experiment="other")])) == 2


def test_source_files_of_other_content_are_variations():
    there = result(source__mesh="ball.ply")
    found = [there | {"inputs": {"source": "a" * 64}}, there | {"inputs": {"source": "b" * 64}}]
    (table,) = merged(found)
    assert names(table) == ("sha256=aaaaaaaaaaaa", "sha256=bbbbbbbbbbbb")


def test_variants_are_taken_over_from_results_that_agree_on_them():
    weak, strong = ([result(seed=seed, fit__losses__edge=edge) for seed in (0, 1)] for edge in (0.1, 1.0))
    named = [one | {"variant": "weak"} for one in weak] + [one | {"variant": "strong"} for one in strong]
    (table,) = merged(named)
    assert names(table) == ("weak", "strong")
    (table,) = merged([named[0], weak[1], *named[2:]])
    assert names(table) == ("edge=0.1", "strong")


def test_targets_and_schemes_that_some_variations_lack_are_gaps():
    (table,) = merged([result("bunny", "loop", fit__steps=1), result("cow", "midpoint", fit__steps=2)])
    assert list(table.targets) == ["bunny", "cow"]
    assert table.rows == (Row(0, "loop"), Row(1, "midpoint"))
    assert (DEFAULT, "cow", Row(0, "loop")) not in table.cells
    assert table.comparisons == ()


def test_no_tables_make_no_table():
    assert merge_tables([]) == []
