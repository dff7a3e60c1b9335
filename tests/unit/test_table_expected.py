"""The check of a reproduction: it passes its own results, fails what it should, and says why."""

import copy
import json
import math

import pytest

from meshfit.errors import ConfigError
from meshfit.report.tables.expected import check, expectation, parse_expected, read_expected, tolerance
from meshfit.report.tables.table import build_tables
from meshfit.statistics import summarise
from tests.loops import over
from tests.unit.test_table_model import CLEAR, grid, result

TABLES = build_tables(grid(CLEAR))
EXPECTED = expectation(TABLES)


def shifted(by, cell=("bunny", "interp-loop")):
    return build_tables(grid(CLEAR | {cell: [value + by for value in CLEAR[cell]]}))


def test_tables_meet_their_own_expectation_also_by_way_of_a_file(tmp_path):
    path = tmp_path / "expected.json"
    path.write_text(json.dumps(EXPECTED))
    assert check(TABLES, EXPECTED) == []
    assert check(TABLES, read_expected(path)) == []


def test_the_tolerance_is_four_standard_errors_of_a_difference():
    cell = summarise([1.0, 1.2, 0.8, 1.0])
    assert tolerance(cell, 0.0) == pytest.approx(4 * cell.spread * math.sqrt(2 / 4))


def test_a_spread_that_is_small_by_luck_is_raised_to_that_of_its_table():
    assert tolerance(summarise([1.0, 1.0]), 0.1) == pytest.approx(0.4)


def test_the_tolerance_has_a_floor_and_a_value_for_one_seed():
    assert tolerance(summarise([2.0, 2.0]), 1e-9) == pytest.approx(0.04)
    assert tolerance(summarise([2.0]), 0.5) == pytest.approx(0.4)


def test_what_no_seed_moves_may_only_be_moved_by_rounding():
    assert tolerance(summarise([2.0, 2.0]), 0.0) == pytest.approx(2e-6)


def test_a_cell_within_its_tolerance_passes_and_one_beyond_is_named():
    allowed = next(cell for cell in EXPECTED["tables"][0]["cells"] if cell["scheme"] == "interp-loop")["tolerance"]
    assert check(shifted(0.99 * allowed), EXPECTED) == []
    (found,) = check(shifted(1.01 * allowed), EXPECTED)
    assert (found.target, found.scheme) == ("bunny", "interp-loop")
    assert found.tolerance == allowed
    assert found.found - found.expected == pytest.approx(1.01 * allowed)
    assert str(found).startswith("bunny, interp-loop, hausdorff.symmetric: found 0.2")
    assert "expected 0.2100 ± 0." in str(found)


def test_a_swap_of_two_schemes_is_caught():
    swapped = CLEAR | {
        ("bunny", "loop"): CLEAR["bunny", "interp-loop"],
        ("bunny", "interp-loop"): CLEAR["bunny", "loop"],
    }
    assert len(check(build_tables(grid(swapped)), EXPECTED)) == 2


def test_the_stand_in_is_called_so():
    (found,) = check(shifted(0.5, ("mousehead", "loop")), EXPECTED)
    assert str(found).startswith("mousehead (stand-in), loop")


def test_a_missing_cell_is_a_deviation():
    values = {cell: sample for cell, sample in CLEAR.items() if cell != ("mousehead", "loop")}
    (found,) = check(build_tables(grid(values)), EXPECTED)
    assert (found.target, found.scheme, found.found) == ("mousehead", "loop", None)
    assert "found no result" in str(found)


def test_other_seeds_are_a_deviation():
    (found,) = check(build_tables([*grid(CLEAR), result(seed=3, value=0.31)]), EXPECTED)
    assert "found seeds [0, 1, 2, 3], expected [0, 1, 2]" in str(found)


def test_other_settings_are_a_deviation_that_names_them():
    (found,) = check(build_tables(grid(CLEAR, fit__steps=100)), EXPECTED)
    assert found.target is None
    assert str(found).endswith("the nearest have fit.steps 100 instead of 2000")


def test_the_right_table_is_found_among_several():
    tables = build_tables(grid(CLEAR, fit__steps=100) + grid(CLEAR))
    assert check(tables, EXPECTED) == []


def test_no_results_of_the_metric_are_a_deviation():
    (found,) = check(build_tables(grid(CLEAR), "hausdorff.forward"), EXPECTED)
    assert str(found) == "table1, hausdorff.symmetric: there are no results"


def test_more_results_than_expected_are_left_alone():
    assert check(build_tables(grid(CLEAR | {("cow", "loop"): [1.0]})), EXPECTED) == []


def broken(change):
    content = copy.deepcopy(EXPECTED)
    change(content)
    return content


@over(
    ("change", "key"),
    [
        (lambda e: e.update(schema_version=2), "schema_version"),
        (lambda e: e.pop("tables"), "tables"),
        (lambda e: e["tables"][0].update(metrik=1), r"tables\[0\]\.metrik"),
        (lambda e: e["tables"][0]["cells"][1].update(mean="0.2"), r"tables\[0\]\.cells\[1\]\.mean"),
        (lambda e: e["tables"][0]["cells"][1].pop("tolerance"), r"tables\[0\]\.cells\[1\]\.tolerance"),
        (lambda e: e["tables"][0]["cells"][0].update(tolerance=-1), r"tables\[0\]\.cells\[0\]\.tolerance"),
        (lambda e: e["tables"][0]["cells"][0].update(tolerance=math.inf), r"tables\[0\]\.cells\[0\]\.tolerance"),
        (lambda e: e["tables"][0]["cells"][0].update(seeds=[]), r"tables\[0\]\.cells\[0\]\.seeds"),
    ],
)
def test_a_malformed_expectation_names_the_key(change, key):
    with pytest.raises(ConfigError, match=key):
        check(TABLES, broken(change))


def test_a_malformed_file_is_named(tmp_path):
    path = tmp_path / "expected.json"
    with pytest.raises(ConfigError, match="cannot be read"):
        read_expected(path)
    path.write_text("{")
    with pytest.raises(ConfigError, match=r"expected\.json: not valid JSON"):
        read_expected(path)
    path.write_text("[]")
    with pytest.raises(ConfigError, match=r"expected\.json: expected a JSON object, got a list"):
        read_expected(path)
    path.write_text(json.dumps(broken(lambda e: e.update(schema_version=2))))
    with pytest.raises(ConfigError, match=r"expected\.json: schema_version"):
        read_expected(path)


def test_an_expectation_of_nothing_is_refused():
    with pytest.raises(ConfigError, match="tables"):
        parse_expected(expectation([]))
