"""Limits on metrics, such as `hausdorff=0.5` or `distance.mean=0.1%`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from meshfit.errors import ConfigError
from meshfit.measuring.metrics import LENGTH, NO_SIDE, OF_MEASUREMENTS, metric_named
from meshfit.specs import suggest

_LIMIT = re.compile(r"(?P<name>[^=]*)=\s*(?P<number>[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)\s*(?P<unit>.*)", re.IGNORECASE)


@dataclass(frozen=True)
class Limit:
    """The largest or the smallest value of a metric that passes.

    Attributes:
        metric: dotted name of the metric.
        value: the limit.
        above: whether values above it fail, rather than those below it.
        percent: whether it is in percent of the diagonal of the target's bounding box.
    """

    metric: str
    value: float
    above: bool
    percent: bool

    def failure(self, values: Mapping[str, Any], diagonal: float) -> str | None:
        """Return one line with metric, value and limit where a measurement fails; None where it passes.

        Args:
            values: a measurement's nested values, as from `Measurement.to_dict`.
            diagonal: of the bounding box of the target.
        """
        group, _, key = self.metric.partition(".")
        value, spec = values[group][key], OF_MEASUREMENTS[self.metric].format or "d"
        limit = self.value / 100 * diagonal if self.percent else self.value
        side = "above" if self.above else "below"
        if value is None:
            reason = values[group].get("reason") or ("no face has a normal" if "cloud" not in values else NO_SIDE)
            return f"{self.metric} has no value to compare with {limit:g}: {reason}"
        if not (value > limit if self.above else value < limit):
            return None
        digits = format(value, spec) if float(format(value, spec)) != limit else repr(value)
        share = f", {self.value:g} % of the target's diagonal" if self.percent else ""
        return f"{self.metric} is {digits}, {side} the limit {limit:.6g}{share}"


def parse_limit(text: str, *, above: bool) -> Limit:
    """Parse a limit: `METRIC=NUMBER`, or `METRIC=NUMBER%` of the target's diagonal for a length.

    Args:
        text: the limit.
        above: whether values above it fail, rather than those below it.

    Raises:
        ConfigError: another form, no such metric, one that is better on the failing side, or a unit.
    """
    match = _LIMIT.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"'{text}': expected METRIC=NUMBER, such as hausdorff=0.5 or hausdorff=0.5%")
    name, unit = metric_named(match["name"].strip()), match["unit"].strip()
    if name not in OF_MEASUREMENTS:
        raise ConfigError(f"'{text}': '{name}' is not a metric of a measurement: {suggest(name, OF_MEASUREMENTS)}")
    metric = OF_MEASUREMENTS[name]
    if unit and unit != "%":
        lengths = ", or in % of the target's diagonal" if metric.unit == LENGTH else ""
        raise ConfigError(f"'{text}': unknown unit '{unit}': mesh files name none; give a number in theirs{lengths}")
    if unit and metric.unit != LENGTH:
        raise ConfigError(f"'{text}': % is of the target's diagonal, and {name} is not a length; give a plain number")
    if metric.smaller_is_better is not None and metric.smaller_is_better != above:
        better, option = ("larger", "--fail-below") if above else ("smaller", "--fail-above")
        raise ConfigError(f"'{text}': {name} is better when it is {better}; use {option} {text}")
    return Limit(name, float(match["number"]), above, percent=bool(unit))
