"""The numbers of the paper, and the two ways of reading them."""

from meshfit.report.tables.paper_numbers import READINGS, paper_value


def test_the_two_readings_hold_the_same_numbers_in_another_order():
    by_column, by_row = READINGS["by column"], READINGS["by row"]
    assert sorted(by_column.values()) == sorted(by_row.values()) == [0.013013, 0.025621, 0.035352, 0.07518]
    assert by_column["bunny", "interp-loop"] == by_row["mousehead", "loop"] == 0.035352
    assert by_column["mousehead", "loop"] == by_row["bunny", "interp-loop"] == 0.07518


def test_the_paper_has_numbers_for_its_own_cells_only():
    assert paper_value("bunny", "loop") == 0.025621
    assert paper_value("cow", "loop") is None
    assert paper_value("bunny", "interp-loop:alpha=0.5") is None
