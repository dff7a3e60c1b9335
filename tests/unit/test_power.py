"""The number of seeds needed, against known answers and against simulated experiments."""

import numpy as np
import pytest
from scipy import stats

from meshfit.statistics import MOST_SEEDS, mean_difference, seeds_needed

# Sample sizes of the paired t test for 80 % power at 5 %, two-sided, by effect size: G*Power 3.1 and Cohen's tables.
PUBLISHED = {0.2: 199, 0.5: 34, 0.8: 15, 1.0: 10}


@pytest.mark.parametrize(("effect", "needed"), PUBLISHED.items())
def test_published_sample_sizes_come_out(effect, needed):
    assert seeds_needed(effect, [1.0]) == needed


@pytest.mark.parametrize("effect", [0.3, 0.9, 2.0, 4.0, 9.0])
def test_it_is_the_least_number_with_the_power(effect):
    def power(seeds):
        bound = stats.t.ppf(0.975, seeds - 1)
        return stats.nct.sf(bound, seeds - 1, effect * seeds**0.5)

    needed = seeds_needed(effect, [1.0])
    assert power(needed) >= 0.8
    assert needed == 2 or power(needed - 1) < 0.8


@pytest.mark.parametrize("effect", [0.9, 1.5, 2.5])
def test_so_many_seeds_find_the_difference_in_four_of_five_experiments(effect):
    needed = seeds_needed(effect, [1.0])
    draws = np.random.default_rng(needed).normal(effect, size=(400, needed))
    zeros = dict.fromkeys(range(needed), 0.0)
    found = [mean_difference([(dict(enumerate(draw)), zeros)]).significant for draw in draws.tolist()]
    assert np.mean(found) > 0.75  # 400 experiments leave a standard deviation of 0.02
    assert needed < 5 or np.mean(found) < 0.90


def test_neither_sign_nor_unit_matters():
    assert seeds_needed(0.5, [1.0]) == seeds_needed(-0.5, [1.0]) == seeds_needed(-5e-7, [1e-6])


def test_more_spread_needs_more_seeds():
    needed = [seeds_needed(1.0, [spread]) for spread in (0.0, 0.01, 0.5, 1.0, 3.0, 20.0)]
    assert needed[:2] == [2, 2]
    assert needed == sorted(needed)


def test_over_several_targets_each_needs_fewer():
    assert seeds_needed(1.0, [2.0, 2.0, 2.0]) < seeds_needed(1.0, [2.0, 2.0]) < seeds_needed(1.0, [2.0])


def test_no_number_resolves_nothing_and_a_tiny_difference_needs_too_many():
    assert seeds_needed(0.0, [1.0]) is None
    assert seeds_needed(0.027, [1.0]) is None
    assert 9_000 < seeds_needed(0.029, [1.0]) <= MOST_SEEDS
