"""How numbers are printed."""

import pytest

from meshfit.experiment.statistics import PairedDifference, Summary
from meshfit.report.numbers import difference_and_interval, mean_and_spread, plain


@pytest.mark.parametrize(
    ("mean", "spread", "text"),
    [
        (0.18304, 0.00213, "0.1830 ± 0.0021"),
        (0.18304, 0.00996, "0.183 ± 0.010"),
        (0.18304, 0.5, "0.18 ± 0.50"),
        (211.4, 121.7, "211 ± 122"),
        (-0.00004, 0.0021, "0.0000 ± 0.0021"),
        (0.000123, 0.0000042, "(1.230 ± 0.042)e−4"),
        (0.18304, 0.0, "0.1830 ± 0"),
        (0.18304, 1e-12, "0.1830 ± 1.0e−12"),
        (0.18304, None, "0.1830"),
        (-1.5, 0.25, "−1.50 ± 0.25"),
    ],
)
def test_the_spread_decides_the_decimals(mean, spread, text):
    assert mean_and_spread(Summary(mean, spread, mean, None, 5, ())) == text


def test_a_single_count_has_no_decimals():
    assert mean_and_spread(Summary(211.0, None, 211.0, None, 1, (211.0,)), whole=True) == "211"


@pytest.mark.parametrize(
    ("value", "text"), [(0, "0"), (1, "1.000"), (12345.6, "12346"), (-0.5, "−0.5000"), (1.23e-7, "1.230e−7")]
)
def test_a_number_by_itself_has_four_digits(value, text):
    assert plain(value) == text


@pytest.mark.parametrize(
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
    assert difference_and_interval(PairedDifference(mean, interval, 5)) == text
