"""Printing of numbers."""

import pytest

from meshfit.report.tables.numbers import format_difference, format_mean, format_number
from meshfit.statistics import PairedDifference, Summary
from tests.loops import over


def summary(mean, half, median=None):
    interval = None if half is None else (mean - half, mean + half)
    return Summary(mean, half, mean if median is None else median, interval, 5, ())


@over(
    ("mean", "half", "texts"),
    [
        (0.18304, 0.00213, ("0.1830 (0.1830)", "[0.1809, 0.1852]")),
        (0.18304, 0.00996, ("0.183 (0.183)", "[0.173, 0.193]")),
        (0.18304, 0.5, ("0.18 (0.18)", "[−0.32, 0.68]")),
        (211.4, 121.7, ("211 (211)", "[90, 333]")),
        (-0.00004, 0.0021, ("0.0000 (0.0000)", "[−0.0021, 0.0021]")),
        (0.000123, 0.0000042, ("1.230 (1.230) e−4", "[1.188, 1.272] e−4")),
        (0.18304, 0.0, ("0.1830 ± 0", "")),
        (0.18304, 1e-12, ("0.1830 (0.1830)", "± 1.0e−12")),
        (0.18304, None, ("0.1830", "")),
        (-1.5, 0.25, ("−1.50 (−1.50)", "[−1.75, −1.25]")),
        (3e7, 2e6, ("3.00 (3.00) e7", "[2.80, 3.20] e7")),
    ],
)
def test_the_interval_decides_the_decimals(mean, half, texts):
    assert format_mean(summary(mean, half)) == texts


def test_the_median_has_the_decimals_of_the_mean():
    assert format_mean(summary(0.11, 0.0056, 0.109342)) == ("0.1100 (0.1093)", "[0.1044, 0.1156]")


def test_an_interval_is_printed_as_it_lies_about_the_mean():
    lopsided = Summary(0.11, 0.01, 0.1, (0.104, 0.1153), 5, ())
    assert format_mean(lopsided)[1] == "[0.1040, 0.1153]"


def test_a_count_that_never_varies_has_no_decimals():
    assert format_mean(summary(211.0, None), whole=True) == ("211", "")
    assert format_mean(summary(0.0, 0.0), whole=True) == ("0 ± 0", "")


@pytest.mark.parametrize(
    ("value", "text"), [(0, "0"), (1, "1.000"), (12345.6, "12346"), (-0.5, "−0.5000"), (1.23e-7, "1.230e−7")]
)
def test_a_number_by_itself_has_four_digits(value, text):
    assert format_number(value) == text


@over(
    ("mean", "interval", "text"),
    [
        (-0.0123, (-0.02, -0.0046), "−0.0123 [−0.0200, −0.0046]"),
        (0.004, (-0.0031, 0.011), "+0.0040 [−0.0031, +0.0110]"),
        (0.0021, (0.0000124, 0.00418), "+0.00210 [+0.00001, +0.00418]"),
        (0.5, (0.5, 0.5), "+0.5000 [+0.5000, +0.5000]"),
        (0.0, (0.0, 0.0), "0 [0, 0]"),
        (-0.25, None, "−0.2500"),
        (-0.0000123, (-0.00002, -0.0000046), "(−1.23 [−2.00, −0.46])e−5"),
    ],
)
def test_a_difference_has_the_decimals_of_its_interval(mean, interval, text):
    assert format_difference(PairedDifference(mean, interval, 5)) == text
