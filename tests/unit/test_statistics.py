"""Summaries against numbers worked out by hand; intervals against what an interval has to do."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshfit.experiment.statistics import paired_difference, summarise


def test_a_summary_has_the_known_mean_spread_and_median():
    found = summarise([1.0, 2.0, 4.0, 9.0])
    assert found.mean == 4.0
    assert found.spread == pytest.approx(math.sqrt((9 + 4 + 0 + 25) / 3))
    assert found.median == 3.0
    assert (found.count, found.values) == (4, (1.0, 2.0, 4.0, 9.0))


def test_one_value_has_no_spread():
    assert summarise([0.3]).spread is None


def test_equal_values_have_a_spread_of_exactly_zero():
    assert summarise([0.1] * 3).spread == 0.0


def test_a_summary_of_nothing_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        summarise([])


def test_only_common_seeds_are_paired():
    found = paired_difference({0: 5.0, 1: 7.0, 2: 100.0}, {1: 4.0, 0: 3.0, 9: -50.0})
    assert found.mean == 2.5
    assert found.count == 2


def test_samples_without_a_common_seed_are_refused():
    with pytest.raises(ValueError, match="in common"):
        paired_difference({0: 1.0}, {1: 1.0})


def test_one_pair_has_no_interval_and_no_verdict():
    found = paired_difference({3: 1.0}, {3: 4.0})
    assert (found.mean, found.interval, found.significant) == (-3.0, None, None)


@pytest.mark.parametrize(("shift", "verdict"), [(0.0, False), (0.5, True)])
def test_equal_differences_need_no_resampling(shift, verdict):
    found = paired_difference({seed: seed + shift for seed in range(4)}, {seed: float(seed) for seed in range(4)})
    assert found.interval == (shift, shift)
    assert found.significant is verdict


def sample(values):
    return dict(enumerate(values))


ZEROS = sample([0.0] * 10)
moderate = st.lists(st.floats(-10, 10).map(lambda x: round(x, 3)), min_size=2, max_size=10)


@settings(max_examples=30, deadline=None)
@given(moderate)
def test_an_interval_holds_the_mean_and_is_reproducible(values):
    found = paired_difference(sample(values), ZEROS)
    low, high = found.interval
    assert low - 1e-9 <= found.mean <= high + 1e-9
    assert paired_difference(sample(values), ZEROS) == found


@settings(max_examples=20, deadline=None)
@given(moderate, st.floats(-5, 5))
def test_an_interval_moves_with_its_data(values, shift):
    low, high = paired_difference(sample(values), ZEROS).interval
    moved = paired_difference(sample([value + shift for value in values]), ZEROS).interval
    assert moved == pytest.approx((low + shift, high + shift), abs=1e-6)


def test_exchanging_the_samples_turns_the_interval_round():
    first, second = sample([0.30, 0.35, 0.31, 0.38]), sample([0.28, 0.36, 0.29, 0.33])
    there, back = paired_difference(first, second), paired_difference(second, first)
    assert back.mean == pytest.approx(-there.mean)
    # The bounds are quantiles of the same resamples, turned round: equal up to the step between two of these.
    assert back.interval == pytest.approx((-there.interval[1], -there.interval[0]), abs=0.005)


def test_the_verdict_changes_with_the_size_of_the_effect():
    noise = [0.010, -0.008, 0.004, -0.006, 0.000]
    assert paired_difference(sample([0.001 + x for x in noise]), ZEROS).significant is False
    assert paired_difference(sample([0.100 + x for x in noise]), ZEROS).significant is True


def test_two_seeds_that_agree_in_sign_are_not_enough():
    assert paired_difference(sample([0.01, 0.02]), ZEROS).significant is False


@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_an_interval_keeps_its_promise_for_few_seeds(count):
    # 300 draws leave a standard deviation of 0.013; plain percentiles give 0.50, 0.75, 0.84 and 0.90.
    draws = np.random.default_rng(count).normal(size=(300, count))
    held = [not paired_difference(sample(draw.tolist()), ZEROS).significant for draw in draws]
    assert np.mean(held) == pytest.approx(0.95, abs=0.035)


def test_importing_statistics_does_not_import_scipy():
    code = "import sys, meshfit.experiment.statistics; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
