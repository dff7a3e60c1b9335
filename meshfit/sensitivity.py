"""Sensitivity of a response to factors: rank correlations, and Sobol' indices by a Gaussian-process surrogate.

The inputs are taken to be independent, each distributed as in the sample. The surrogate is a Gaussian process with one
length scale per factor; its indices are trusted only as far as it predicts points that it was not fitted to.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.optional import import_optional

LEAST_Q2 = 0.7
"""Least cross-validated Q² of a surrogate whose indices are shown."""
LEAST_POINTS = 20
"""Least number of points for a surrogate; and at least `_POINTS_PER_FACTOR` for each factor."""
LEAST_INTERACTION = 0.01
"""Least share of the variance of an interaction that is named."""
_POINTS_PER_FACTOR = 5
_FOLDS = 10
_RESAMPLES = 1000
_FEW_VALUES = 5
_MOST_FITTED = 300  # points that length scales are found from; all points are predicted from
_MOST_POINTS = 1500
_BASE = 1024  # a power of two, of Sobol' points for the indices
_LEVEL = 0.95
_MOST_FACTORS_FOR_PAIRS = 8


@dataclass(frozen=True)
class Factor:
    """A setting that differs between points.

    Attributes:
        name: its name.
        values: (N,) numbers, logarithms of numbers, or indices of categories.
        categories: names of the categories; empty for numbers.
        is_log: whether the values are logarithms.
    """

    name: str
    values: Float64[np.ndarray, " N"]
    categories: tuple[str, ...] = ()
    is_log: bool = False


@dataclass(frozen=True)
class Estimate:
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Effect:
    """The effect of a factor on the response.

    Attributes:
        factor: the factor.
        rank: Spearman's rank correlation; for categories, the share η² of the variance of ranks between them.
        moves: whether it is significant at 5 %: the interval of the correlation is on one side of 0; for categories, by
            the test of Kruskal and Wallis.
        first: first-order Sobol' index; None without a surrogate.
        total: total Sobol' index.
        low: mean response in the lowest third of the factor, at the lowest of a few values, or in the category in which
            it is least.
        high: mean response in the highest third, at the highest of a few values, or in the category in which it is
            largest.
        ends: of what `low` and `high` are: two values of the factor, or two categories.
    """

    factor: Factor
    rank: Estimate
    moves: bool
    first: Estimate | None
    total: Estimate | None
    low: float
    high: float
    ends: tuple[str, str]


@dataclass(frozen=True)
class Interaction:
    """The share of the variance that two factors have only together."""

    names: tuple[str, str]
    share: Estimate


@dataclass(frozen=True)
class Analysis:
    """The sensitivity of a response.

    Attributes:
        points: the number of points.
        effects: one per factor; the largest first.
        q2: share of the variance of left-out points that the surrogate predicts; None without one.
        why_not: why there are no Sobol' indices; empty if there are.
        interactions: the interactions of two factors, the largest first.
        confounded: pairs of factors that vary together, so that their effects cannot be told apart.
    """

    points: int
    effects: tuple[Effect, ...]
    q2: float | None
    why_not: str
    interactions: tuple[Interaction, ...]
    confounded: tuple[tuple[str, str, float], ...]


def analyse(
    factors: Sequence[Factor], response: Float64[np.ndarray, " N"], groups: Int64[np.ndarray, " N"] | None = None
) -> Analysis:
    """Estimate the effect of each factor on a response.

    Args:
        factors: the factors.
        response: (N,) response at each point.
        groups: (N,) points of a group, such as several schemes with the same settings, have the same number; they are
            resampled and left out together. By default each point is a group of its own.

    Raises:
        ConfigError: scikit-learn is not installed.
    """
    groups = np.arange(len(response)) if groups is None else groups
    weights = _resamples(groups)
    ranks = [_rank_effect(factor, response, weights) for factor in factors]
    q2, why_not, surrogate = _fit_surrogate(factors, response, groups)
    indices = None if surrogate is None else _indices(surrogate, factors)
    effects = []
    for i, (factor, (rank, moves)) in enumerate(zip(factors, ranks, strict=True)):
        first = None if indices is None else indices.first[i]
        total = None if indices is None else indices.total[i]
        effects.append(Effect(factor, rank, moves, first, total, *_ends(factor, response)))
    effects.sort(key=lambda effect: -(effect.total.value if effect.total else abs(effect.rank.value)))
    interactions = () if indices is None else indices.interactions
    return Analysis(len(response), tuple(effects), q2, why_not, interactions, tuple(_confounded(factors)))


def _resamples(groups: Int64[np.ndarray, " N"]) -> Float64[np.ndarray, "R N"]:
    """(R, N) how often each row is in each bootstrap sample; groups are drawn whole."""
    _, places = np.unique(groups, return_inverse=True)
    count = int(places.max()) + 1
    drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), _RESAMPLES)
    return drawn[:, places].astype(np.float64)


def _rank_effect(
    factor: Factor, response: Float64[np.ndarray, " N"], weights: Float64[np.ndarray, "R N"]
) -> tuple[Estimate, bool]:
    """Return the rank statistic with its bootstrap interval, and whether it is significant; ranks are those of all."""
    from scipy.stats import rankdata

    measure = _eta_squared if factor.categories else _correlations
    x, y = factor.values if factor.categories else rankdata(factor.values), rankdata(response)
    low, high = map(float, np.quantile(measure(x, y, weights), [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2]))
    estimate = Estimate(float(measure(x, y, np.ones((1, len(y))))[0]), low, high)
    if factor.categories:
        return estimate, _kruskal_p(factor.values, response) < 1 - _LEVEL
    return estimate, low > 0 or high < 0


def _correlations(
    x: Float64[np.ndarray, " N"], y: Float64[np.ndarray, " N"], weights: Float64[np.ndarray, "R N"]
) -> Float64[np.ndarray, " R"]:
    """(R,) weighted correlations."""
    x, y = x - x.mean(), y - y.mean()
    total = weights.sum(axis=1)
    mean_x, mean_y = weights @ x / total, weights @ y / total
    spread_x, spread_y = weights @ x**2 / total - mean_x**2, weights @ y**2 / total - mean_y**2
    scale = np.sqrt(np.maximum(spread_x * spread_y, 0))
    together = weights @ (x * y) / total - mean_x * mean_y
    return np.asarray(np.divide(together, scale, out=np.zeros_like(scale), where=scale > 0))


def _eta_squared(
    codes: Float64[np.ndarray, " N"], ranks: Float64[np.ndarray, " N"], weights: Float64[np.ndarray, "R N"]
) -> Float64[np.ndarray, " R"]:
    """(R,) weighted η² of ranks, (H − k + 1) / (n − k) of Kruskal and Wallis, 0 on average without an effect."""
    ranks = ranks - ranks.mean()
    total = weights.sum(axis=1)
    mean = weights @ ranks / total
    whole = weights @ ranks**2 - total * mean**2
    between, groups = np.zeros_like(total), np.zeros_like(total)
    for code in np.unique(codes):
        count = weights @ (codes == code)
        sums = weights @ np.where(codes == code, ranks, 0.0)
        between += np.divide(sums**2, count, out=np.zeros_like(count), where=count > 0)
        groups += count > 0
    share = np.divide(between - total * mean**2, whole, out=np.zeros_like(whole), where=whole > 0)
    statistic = (total - 1) * share
    free = np.maximum(total - groups, 1)
    return np.asarray(np.clip((statistic - groups + 1) / free, 0, 1))


def _groups(codes: Float64[np.ndarray, " N"], response: Float64[np.ndarray, " N"]) -> list[Float64[np.ndarray, " n"]]:
    return [response[codes == code] for code in np.unique(codes)]


def _kruskal_p(codes: Float64[np.ndarray, " N"], response: Float64[np.ndarray, " N"]) -> float:
    from scipy.stats import kruskal

    groups = _groups(codes, response)
    return float(kruskal(*groups).pvalue) if len(groups) > 1 and np.ptp(response) > 0 else 1.0


def _ends(factor: Factor, response: Float64[np.ndarray, " N"]) -> tuple[float, float, tuple[str, str]]:
    if factor.categories:
        means = {int(code): float(response[factor.values == code].mean()) for code in np.unique(factor.values)}
        least, most = min(means, key=lambda code: means[code]), max(means, key=lambda code: means[code])
        return means[least], means[most], (factor.categories[least], factor.categories[most])
    few = np.unique(factor.values)
    # Thirds of a few values may have the same median.
    lower, upper = few[[0, -1]] if len(few) <= _FEW_VALUES else np.quantile(factor.values, [1 / 3, 2 / 3])
    low, high = factor.values <= lower, factor.values >= upper
    texts = [
        f"{(math.exp(value) if factor.is_log else value):.3g}"
        for value in (np.median(factor.values[low]), np.median(factor.values[high]))
    ]
    return float(response[low].mean()), float(response[high].mean()), (texts[0], texts[1])


def _confounded(factors: Sequence[Factor]) -> list[tuple[str, str, float]]:
    """Return pairs of factors of numbers whose rank correlation is above 0.5 in size."""
    from scipy.stats import rankdata

    numbers = [factor for factor in factors if not factor.categories]
    found = []
    for first, second in combinations(numbers, 2):
        ranks = rankdata(first.values), rankdata(second.values)
        correlation = float(_correlations(*ranks, np.ones((1, len(first.values))))[0])
        if abs(correlation) > 0.5:
            found.append((first.name, second.name, correlation))
    return found


@dataclass(frozen=True)
class _Surrogate:
    """A Gaussian process fitted to all points, and others fitted without a fold each."""

    whole: Any
    folds: tuple[Any, ...]


@dataclass(frozen=True)
class _Indices:
    first: list[Estimate]
    total: list[Estimate]
    interactions: tuple[Interaction, ...]


def _fit_surrogate(
    factors: Sequence[Factor], response: Float64[np.ndarray, " N"], groups: Int64[np.ndarray, " N"]
) -> tuple[float | None, str, _Surrogate | None]:
    """Return Q², why there is no surrogate, and the surrogate."""
    n, least = len(response), max(LEAST_POINTS, _POINTS_PER_FACTOR * len(factors))
    if n < least:
        return None, f"{n} points are too few for a surrogate of {len(factors)} settings; it takes {least}", None
    if np.ptp(response) == 0:
        return None, "the metric is the same at all points", None
    generator = np.random.default_rng(0)
    if n > _MOST_POINTS:
        kept = np.sort(generator.permutation(n)[:_MOST_POINTS])
        factors = [Factor(each.name, each.values[kept], each.categories, each.is_log) for each in factors]
        response, groups, n = response[kept], groups[kept], _MOST_POINTS
    inputs = np.column_stack([_columns(factor) for factor in factors])
    order = generator.permutation(n)
    kernel = _fitted_kernel(inputs[order[:_MOST_FITTED]], response[order[:_MOST_FITTED]], factors)
    folds: list[Any] = []
    predicted = np.empty(n)
    for left_out in np.array_split(generator.permutation(np.unique(groups)), _FOLDS):
        is_out = np.isin(groups, left_out)
        fold, rest = np.flatnonzero(is_out), np.flatnonzero(~is_out)
        process = _process(kernel, optimizer=None).fit(inputs[rest], response[rest])
        predicted[fold] = process.predict(inputs[fold])
        folds.append(process)
    q2 = 1 - float(((response - predicted) ** 2).sum() / ((response - response.mean()) ** 2).sum())
    if q2 < LEAST_Q2:
        why = f"the surrogate predicts {max(q2, 0):.2f} of the variance of points left out (Q²), less than {LEAST_Q2}"
        return q2, f"{why}; more points help, unless the seeds differ as much as the settings", None
    whole = _process(kernel, optimizer=None).fit(inputs, response)
    return q2, "", _Surrogate(whole, tuple(folds))


def _columns(factor: Factor, values: Float64[np.ndarray, " M"] | None = None) -> Float64[np.ndarray, "M C"]:
    """(M, C) inputs of the surrogate: numbers between 0 and 1, or one column per category."""
    values = factor.values if values is None else values
    if factor.categories:
        return np.asarray(values[:, None] == np.arange(len(factor.categories)), dtype=np.float64)
    low, high = float(factor.values.min()), float(factor.values.max())
    return np.asarray((values - low) / (high - low))[:, None]


def _fitted_kernel(inputs: Float64[np.ndarray, "n C"], response: Float64[np.ndarray, " n"], factors: Any) -> Any:  # noqa: ANN401
    kernels = import_optional("sklearn.gaussian_process.kernels", "Sobol' indices need", "'meshfit[tune]'")
    scales = np.concatenate([np.full(max(1, len(factor.categories)), 1.0) for factor in factors])
    kernel = kernels.ConstantKernel(1.0, (1e-3, 1e4)) * kernels.Matern(scales, (0.05, 100.0), nu=2.5)
    kernel += kernels.WhiteKernel(1e-2, (1e-6, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length scale at its bound is a factor without effect
        return _process(kernel, n_restarts_optimizer=1).fit(inputs, response).kernel_


def _process(kernel: Any, **options: Any) -> Any:  # noqa: ANN401  an optional library
    processes = import_optional("sklearn.gaussian_process", "Sobol' indices need", "'meshfit[tune]'")
    return processes.GaussianProcessRegressor(kernel, normalize_y=True, random_state=0, **options)


def _indices(surrogate: _Surrogate, factors: Sequence[Factor]) -> _Indices:
    """Estimate indices from the surrogate, with jackknife intervals over the folds.

    First-order and total ones are those of `scipy.stats.sobol_indices`; the index of a pair, less those of its two
    factors, is their interaction.
    """
    count = len(factors)
    first, total, _ = _shares(surrogate.whole, factors, ())
    # A factor interacts by as much as its total index is above its own.
    joined = sorted(
        (i for i in range(count) if total[i] - first[i] >= LEAST_INTERACTION), key=lambda i: first[i] - total[i]
    )
    whole = _shares(surrogate.whole, factors, list(combinations(sorted(joined[:_MOST_FACTORS_FOR_PAIRS]), 2)))
    large = {pair: share for pair, share in whole[2].items() if share >= LEAST_INTERACTION}
    folds = [_shares(process, factors, list(large)) for process in surrogate.folds]
    firsts = [_jackknife(whole[0][i], [fold[0][i] for fold in folds]) for i in range(count)]
    totals = [_jackknife(whole[1][i], [fold[1][i] for fold in folds]) for i in range(count)]
    pairs = [
        Interaction((factors[i].name, factors[j].name), _jackknife(share, [fold[2][i, j] for fold in folds]))
        for (i, j), share in large.items()
    ]
    named = [pair for pair in pairs if pair.share.low > 0]
    return _Indices(firsts, totals, tuple(sorted(named, key=lambda pair: -pair.share.value)))


def _jackknife(value: float, folds: Sequence[float]) -> Estimate:
    """Return a share with its interval by the delete-a-group jackknife."""
    from scipy.stats import t

    spread = math.sqrt((len(folds) - 1) * float(np.var(folds)))
    reach = float(t.ppf((1 + _LEVEL) / 2, len(folds) - 1)) * spread
    return Estimate(*(float(min(1.0, max(0.0, share))) for share in (value, value - reach, value + reach)))


@dataclass(frozen=True)
class _Marginal:
    """The distribution of a factor in the sample."""

    factor: Factor

    def quantiles(self, shares: Float64[np.ndarray, " S"]) -> Float64[np.ndarray, " S"]:
        """Return the values below which some shares of the sample are."""
        ordered = np.sort(self.factor.values)
        if self.factor.categories or len(np.unique(ordered)) < len(ordered) / 2:
            return np.asarray(ordered[(shares * len(ordered)).astype(int)])
        return np.asarray(np.interp(shares, (np.arange(len(ordered)) + 0.5) / len(ordered), ordered))


def _shares(
    process: Any,  # noqa: ANN401  an optional library
    factors: Sequence[Factor],
    pairs: Sequence[tuple[int, int]],
) -> tuple[Float64[np.ndarray, " S"], Float64[np.ndarray, " S"], dict[tuple[int, int], float]]:
    """Return first-order and total indices, and the second-order ones of some pairs of factors."""
    from scipy.stats import qmc, sobol_indices

    count = len(factors)
    if count == 1:
        return np.ones(1), np.ones(1), {}
    points = qmc.Sobol(2 * count, rng=np.random.default_rng(0)).random(_BASE).T
    samples = [
        np.stack([_Marginal(factor).quantiles(points[start + i]) for i, factor in enumerate(factors)])
        for start in (0, count)
    ]

    def predict(values: Float64[np.ndarray, "S ..."]) -> Float64[np.ndarray, " ..."]:
        flat = values.reshape(count, -1)
        inputs = np.column_stack([_columns(factor, row) for factor, row in zip(factors, flat, strict=True)])
        return np.asarray(process.predict(inputs)).reshape(values.shape[1:])

    a, b = samples
    f_a, f_b = predict(a), predict(b)
    mixed = np.stack([_mixed(a, b, (i,)) for i in range(count)], axis=1)
    f_mixed = predict(mixed)
    found = sobol_indices(func={"f_A": f_a[None], "f_B": f_b[None], "f_AB": f_mixed[:, None]}, n=_BASE)
    first, total = np.ravel(found.first_order), np.ravel(found.total_order)
    variance = float(np.var(np.concatenate([f_a, f_b])))
    shares: dict[tuple[int, int], float] = {}
    centred = f_b - np.concatenate([f_a, f_b]).mean()
    for i, j in pairs:
        closed = float((centred * (predict(_mixed(a, b, (i, j))) - f_a)).mean()) / (variance or 1.0)
        shares[i, j] = closed - float(first[i]) - float(first[j])
    return first, total, shares


def _mixed(
    a: Float64[np.ndarray, "S n"], b: Float64[np.ndarray, "S n"], rows: Sequence[int]
) -> Float64[np.ndarray, "S n"]:
    """Return the first sample with some factors taken from the second."""
    mixed = a.copy()
    mixed[list(rows)] = b[list(rows)]
    return mixed


def codes_of(values: Sequence[object]) -> tuple[Int64[np.ndarray, " N"], list[object]]:
    """Return the index of each value among the different ones, in the order in which they first appear."""
    different = list(dict.fromkeys(values))
    places = {value: i for i, value in enumerate(different)}
    return np.array([places[value] for value in values], dtype=np.int64), different
