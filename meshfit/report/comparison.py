"""What is compared in a result table: schemes with the baseline, on each target and over all, and the best of them."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from meshfit.experiment.statistics import BySeed, PairedDifference, differ, mean_difference, paired_difference
from meshfit.measuring.metrics import METRICS
from meshfit.report.gather import Cell

_Name = TypeVar("_Name", bound=Hashable)
_Samples = Mapping[Cell, BySeed]


@dataclass(frozen=True)
class Difference:
    """How a scheme differs from the baseline: the scheme's value minus the baseline's.

    Attributes:
        target: the target; None for the mean over all targets that both schemes have.
        scheme: the scheme.
        baseline: what it is compared with.
        paired: the difference.
    """

    target: str | None
    scheme: str
    baseline: str
    paired: PairedDifference


def differences_on_targets(
    samples: _Samples, targets: Sequence[str], schemes: Sequence[str], baseline: str, metric: str
) -> tuple[Difference, ...]:
    """Of each target and scheme, from the baseline, where both have a seed in common."""
    better = METRICS[metric].smaller_is_better
    return tuple(
        Difference(target, scheme, baseline, paired_difference(*pair, smaller_is_better=better))
        for target in targets
        for scheme in schemes
        if scheme != baseline and comparable(pair := (_at(samples, target, scheme), _at(samples, target, baseline)))
    )


def differences_over_targets(
    samples: _Samples, targets: Sequence[str], schemes: Sequence[str], baseline: str, metric: str
) -> tuple[Difference, ...]:
    """Of each scheme, from the baseline, over the targets on which they can be compared, if these are several."""
    found = []
    for scheme in schemes:
        pairs = [(_at(samples, target, scheme), _at(samples, target, baseline)) for target in targets]
        paired = None if scheme == baseline else over_targets(pairs, metric)
        if paired is not None:
            found.append(Difference(None, scheme, baseline, paired))
    return tuple(found)


def over_targets(pairs: Sequence[tuple[BySeed, BySeed]], metric: str) -> PairedDifference | None:
    """The mean difference over the targets on which samples can be compared; None where these are not several."""
    able = [pair for pair in pairs if comparable(pair)]
    return mean_difference(able, smaller_is_better=METRICS[metric].smaller_is_better) if len(able) > 1 else None


def comparable(pair: tuple[BySeed, BySeed]) -> bool:
    """Whether two samples have a seed in common."""
    return not pair[0].keys().isdisjoint(pair[1].keys())


def best_of(samples: Mapping[_Name, BySeed], metric: str) -> _Name | None:
    """The one of several samples that differs significantly from every other one, for the better; None without one."""
    smaller_is_better = METRICS[metric].smaller_is_better
    means = {name: sum(sample.values()) / len(sample) for name, sample in samples.items() if sample}
    if smaller_is_better is None or len(means) < 2:
        return None
    first = (min if smaller_is_better else max)(means, key=means.__getitem__)
    return first if all(differ(samples[first], samples[name]) for name in means if name != first) else None


def best_on_targets(samples: _Samples, targets: Sequence[str], schemes: Sequence[str], metric: str) -> dict[str, str]:
    """By target, the scheme that is the best; targets without one are left out."""
    found = {target: best_of({name: _at(samples, target, name) for name in schemes}, metric) for target in targets}
    return {target: scheme for target, scheme in found.items() if scheme is not None}


def _at(samples: _Samples, target: str, scheme: str) -> BySeed:
    return samples.get((target, scheme), {})
