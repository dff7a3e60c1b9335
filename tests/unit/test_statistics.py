"""Summaries against numbers computed by hand, and the coverage of intervals."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from meshfit.statistics import differ, mean_difference, summarise
from tests.loops import over


def paired_difference(first, second, **options):
    return mean_difference([(first, second)], **options)


def test_a_summary_has_the_known_mean_spread_and_median():
    found = summarise([1.0, 2.0, 4.0, 9.0])
    assert found.mean == 4.0
    assert found.spread == pytest.approx(math.sqrt((9 + 4 + 0 + 25) / 3))
    assert found.median == 3.0
    assert (found.count, found.values) == (4, (1.0, 2.0, 4.0, 9.0))


def test_one_value_has_no_spread_and_no_interval():
    assert summarise([0.3]).spread is None
    assert summarise([0.3]).interval is None


def test_equal_values_have_a_spread_of_exactly_zero_and_an_interval_of_no_width():
    found = summarise([0.1] * 3)
    assert (found.mean, found.spread, found.interval) == (0.1, 0.0, (0.1, 0.1))


def test_a_summary_has_the_interval_of_a_difference_from_nothing():
    values = [0.3, 0.35, 0.31, 0.4]
    assert summarise(values).interval == paired_difference(sample(values), ZEROS).interval


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
def test_equal_differences_have_an_interval_of_no_width(shift, verdict):
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
    assert moved == pytest.approx((low + shift, high + shift), abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(moderate, st.floats(0.01, 100))
def test_an_interval_grows_with_its_data(values, scale):
    low, high = summarise(values).interval
    assert summarise([scale * value for value in values]).interval == pytest.approx(
        (scale * low, scale * high), rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("scale", [1e-200, 1e-90, 1e90])
def test_no_size_of_numbers_is_too_small_or_too_large(scale):
    found = mean_difference([({0: 1 * scale, 1: 2 * scale}, {0: 0.0, 1: 0.0})] * 2)
    plain = mean_difference([({0: 1.0, 1: 2.0}, {0: 0.0, 1: 0.0})] * 2)
    assert np.array(found.interval) / scale == pytest.approx(plain.interval)


def test_the_interval_of_one_sample_is_that_of_the_t_test():
    values = [0.30, 0.35, 0.31, 0.38, 0.29]
    expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert summarise(values).interval == pytest.approx(tuple(expected), rel=1e-12)


def test_the_interval_over_two_targets_is_that_of_welchs_test():
    first, second = [0.30, 0.35, 0.31, 0.38], [1.0, 1.4, 0.9]
    expected = stats.ttest_ind(first, np.negative(second), equal_var=False).confidence_interval(0.95)
    found = mean_difference([(sample(first), ZEROS), (sample(second), ZEROS)]).interval
    assert found == pytest.approx((expected.low / 2, expected.high / 2), rel=1e-12)


def test_exchanging_the_samples_turns_the_interval_round():
    first, second = sample([0.30, 0.35, 0.31, 0.38]), sample([0.28, 0.36, 0.29, 0.33])
    there, back = paired_difference(first, second), paired_difference(second, first)
    assert back.mean == pytest.approx(-there.mean)
    assert back.interval == (-there.interval[1], -there.interval[0])
    assert back.seeds_needed == there.seeds_needed


def test_the_verdict_changes_with_the_size_of_the_effect():
    noise = [0.010, -0.008, 0.004, -0.006, 0.000]
    assert paired_difference(sample([0.001 + x for x in noise]), ZEROS).significant is False
    assert paired_difference(sample([0.100 + x for x in noise]), ZEROS).significant is True


def test_two_seeds_that_agree_in_sign_are_not_enough():
    assert paired_difference(sample([0.01, 0.02]), ZEROS).significant is False


@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_an_interval_has_its_coverage_for_few_seeds(count):
    # 1000 draws leave a standard deviation of 0.007.
    draws = np.random.default_rng(count).normal(size=(1000, count))
    held = [not paired_difference(sample(draw.tolist()), ZEROS).significant for draw in draws]
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)


def better(first, second, *, smaller=True):
    return paired_difference(sample(first), sample(second), smaller_is_better=smaller).improvement


def test_the_probability_of_improvement_is_the_share_of_pairs_and_ties_count_a_half():
    assert better([1, 2], [3, 4]) == 1.0
    assert better([1, 3], [2, 3]) == (1 + 1 + 0 + 0.5) / 4
    assert better([1, 3], [2, 3], smaller=False) == 1 - 2.5 / 4
    assert better([7], [7]) == 0.5
    assert better([1, 2], [3, 4], smaller=None) is None


@given(st.lists(st.integers(0, 5), min_size=1, max_size=8), st.lists(st.integers(0, 5), min_size=1, max_size=8))
def test_better_and_worse_are_certain_together(first, second):
    count = min(len(first), len(second))
    pairs = [(a, b) for a in first[:count] for b in second[:count]]
    assert better(first, second) == pytest.approx(sum((a < b) + 0.5 * (a == b) for a, b in pairs) / len(pairs))
    assert better(first, second) + better(second, first) == pytest.approx(1)
    assert better(first, second) + better(first, second, smaller=False) == pytest.approx(1)


def test_the_probability_of_improvement_is_the_statistic_of_mann_and_whitney():
    first, second = [0.3, 0.5, 0.5, 0.2], [0.5, 0.1, 0.5, 0.4]
    expected = stats.mannwhitneyu(first, second).statistic / (len(first) * len(second))
    assert better(first, second, smaller=False) == expected


def test_samples_differ_where_their_interval_leaves_out_zero():
    noise = [0.010, -0.008, 0.004, -0.006, 0.000]
    assert differ(sample([0.1 + x for x in noise]), ZEROS) is True
    assert differ(sample([0.001 + x for x in noise]), ZEROS) is False
    assert differ({0: 1.0}, {0: 2.0}) is False
    assert differ({0: 1.0, 1: 1.0}, {2: 2.0, 3: 2.0}) is False


BUNNY = (sample([0.30, 0.35, 0.31, 0.38]), sample([0.28, 0.36, 0.29, 0.33]))
COW = (sample([1.0, 1.1, 1.3]), sample([0.7, 1.0, 1.1]))


def test_over_one_target_a_mean_difference_is_the_plain_one():
    assert mean_difference([BUNNY], smaller_is_better=True) == paired_difference(*BUNNY, smaller_is_better=True)


def test_over_two_targets_they_count_alike_and_the_seeds_of_each_are_paired():
    found = mean_difference([BUNNY, COW], smaller_is_better=True)
    each = [paired_difference(*target, smaller_is_better=True) for target in (BUNNY, COW)]
    assert found.mean == pytest.approx((each[0].mean + each[1].mean) / 2)
    assert found.improvement == pytest.approx((each[0].improvement + each[1].improvement) / 2)
    assert (found.count, found.targets) == (3, 2)
    low, high = found.interval
    assert low < found.mean < high


def test_targets_that_agree_exactly_leave_no_doubt_and_one_with_a_single_seed_leaves_all():
    alike = (sample([1.0, 2.0]), sample([0.5, 1.5]))
    assert mean_difference([alike, alike]).interval == (0.5, 0.5)
    assert mean_difference([BUNNY, ({0: 1.0}, {0: 0.5})]).interval is None


def test_a_difference_over_no_targets_is_refused():
    with pytest.raises(ValueError, match="at least one target"):
        mean_difference([])


def test_a_target_that_hardly_varies_halves_the_interval():
    steady = (sample([1.0, 1.0 + 1e-9, 1.0, 1.0]), sample([0.5] * 4))
    low, high = mean_difference([BUNNY, steady]).interval
    alone = paired_difference(*BUNNY).interval
    assert high - low == pytest.approx((alone[1] - alone[0]) / 2, rel=1e-4)


@pytest.mark.parametrize("spreads", [(1, 1), (1, 1, 1), (1, 0.1), (1, 0.3, 0.1)])
@over("count", [2, 3, 5])
def test_an_interval_over_targets_has_its_coverage_for_few_seeds(count, spreads):
    # 400 draws leave a standard deviation of 0.011. Two or three seeds tell little of which target varies more, so that
    # the interval is sometimes too wide; with the plain sum of degrees of freedom, (1, 0.1) would give 0.84 and 0.90.
    generator = np.random.default_rng(10 * count + len(spreads))
    draws = generator.normal(size=(400, len(spreads), count)) * np.array(spreads)[:, None]
    held = [not mean_difference([(sample(row), ZEROS) for row in draw.tolist()]).significant for draw in draws]
    assert 0.90 < np.mean(held) < 0.995


def test_importing_statistics_does_not_import_scipy():
    code = "import sys, meshfit.statistics; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
