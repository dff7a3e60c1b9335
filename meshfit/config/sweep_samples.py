"""Sampled sweeps: points of a space-filling design over ranges of settings."""

import json
import math
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import Field

from meshfit.config.experiment import canonical_key
from meshfit.errors import ConfigError
from meshfit.settings import KIND_KEY, Settings, build

SAMPLE, RANGES = "sample", "ranges"
MOST_POINTS = 100_000
_LINEAR, _LOG, _INTEGER = "linear", "log", "integer"
# Significant digits of sampled numbers, so that the names of points can be read and typed.
_DIGITS = 4
_EXAMPLES = "[3, 4, 5], {linear: [0, 1]}, {log: [0.01, 2]} or {log: [100, 4000], integer: true}"


class SampleSettings(Settings):
    """The points of a sampled sweep."""

    points: Annotated[int, Field(ge=1, le=MOST_POINTS)]
    """Number of points. A larger number keeps the points of a smaller one."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the points."""
    method: Literal["sobol", "latin-hypercube", "random"] = "sobol"
    """Design: a scrambled Sobol' sequence, a nested Latin hypercube, or independent points."""


def sampled_points(sample: object, ranges: object) -> list[dict[str, Any]]:
    """Return the points of a sampled sweep, each with a value for every setting by its dotted key.

    Args:
        sample: number of points, seed and method, as a config holds them.
        ranges: of each setting: a list of values, or `{linear: [low, high]}` or `{log: [low, high]}`, with
            `integer: true` for whole numbers; nested or with dotted keys.

    Raises:
        ConfigError: malformed settings or ranges.
    """
    settings, axes = sample_settings(sample), read_ranges(ranges)
    shares = _DESIGNS[settings.method](len(axes), settings.points, settings.seed)
    points = [
        {key: _value(values, float(share)) for (key, values), share in zip(axes.items(), row, strict=True)}
        for row in shares
    ]
    # Points of a few values each may be equal; they would be the same trials.
    return list({json.dumps(point): point for point in points}.values())


def sample_settings(sample: object) -> SampleSettings:
    """Validate number of points, seed and method.

    Raises:
        ConfigError: a key or value that is not allowed.
    """
    if sample is None:
        remedy = f"sweep.{SAMPLE}: {{points: 200}} spreads points over them, and `meshfit tune` searches them"
        raise ConfigError(f"sweep.{RANGES}: expected a number of points, too: {remedy}")
    if not isinstance(sample, Mapping):
        raise ConfigError(f"sweep.{SAMPLE}: expected a mapping such as {{points: 200}}, got {json.dumps(sample)}")
    return build(SampleSettings, sample, lambda _: f"sweep.{SAMPLE}.")


def read_ranges(ranges: object) -> dict[str, Any]:
    """Validate ranges, and return them by dotted key: a list of values, or a mapping with `linear` or `log`.

    Raises:
        ConfigError: malformed ranges.
    """
    if not isinstance(ranges, Mapping) or not ranges:
        raise ConfigError(f"sweep.{RANGES}: expected settings and their ranges, got {json.dumps(ranges)}")
    axes: dict[str, Any] = {}
    for key, values in _flat(ranges):
        if key in axes:
            raise ConfigError(f"sweep.{RANGES}: duplicate key {key}")
        axes[key] = values
        _check(key, values)
    return axes


def limits(values: Mapping[str, Any]) -> tuple[float, float, bool, bool]:
    """Return the ends of a range, whether it is logarithmic, and whether its values are integers."""
    is_log = _LOG in values
    low, high = values[_LOG if is_log else _LINEAR]
    return low, high, is_log, values.get(_INTEGER, False)


def rounded(value: float, low: float, high: float) -> float:
    """Round a value of a range to the digits that names of points have, and keep it within the ends."""
    return min(max(float(f"{value:.{_DIGITS}g}"), low), high)


def _flat(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping) and value and KIND_KEY not in value and not _is_range(value):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield canonical_key(f"{above}{key}"), value


def _is_range(value: Mapping[str, Any]) -> bool:
    """Whether a mapping is a range, or a misspelt one, rather than settings below a key."""
    return _INTEGER in value or any(get_close_matches(str(key), (_LINEAR, _LOG)) for key in value)


def _check(key: str, values: object) -> None:
    where, got = f"sweep.{RANGES}: {key}", json.dumps(values, default=str)
    if isinstance(values, list):
        if len({json.dumps(value, sort_keys=True) for value in values}) < max(len(values), 1):
            raise ConfigError(f"{where}: expected different values, such as {_EXAMPLES}, got {got}")
        return
    scales = [scale for scale in (_LINEAR, _LOG) if isinstance(values, Mapping) and scale in values]
    if not isinstance(values, Mapping) or len(scales) != 1 or values.keys() - {*scales, _INTEGER}:
        raise ConfigError(f"{where}: expected a range such as {_EXAMPLES}, got {got}")
    ends = values[scales[0]]
    numbers = isinstance(ends, list) and len(ends) == 2 and all(type(end) in (int, float) for end in ends)
    if not numbers or not all(map(math.isfinite, ends)) or not ends[0] < ends[1]:
        raise ConfigError(f"{where}: expected two finite numbers, the smaller first, got {got}")
    if scales == [_LOG] and ends[0] <= 0:
        raise ConfigError(f"{where}: expected numbers above 0 for a logarithmic range, got {got}")
    if not isinstance(values.get(_INTEGER, False), bool):
        raise ConfigError(f"{where}: {_INTEGER}: expected true or false, got {got}")
    if values.get(_INTEGER) and any(end != int(end) for end in ends):
        raise ConfigError(f"{where}: expected integers at both ends, got {got}")


def _value(values: Any, share: float) -> Any:  # noqa: ANN401  any YAML values
    """Return the value at a share of a range, in [0, 1)."""
    if isinstance(values, list):
        return values[int(share * len(values))]
    low, high, is_log, integer = limits(values)
    first, last = (low - 0.5, high + 0.5) if integer else (low, high)  # an interval around each integer
    value = first * (last / first) ** share if is_log else first + (last - first) * share
    return math.floor(value + 0.5) if integer else rounded(value, low, high)


def _sobol(settings: int, points: int, seed: int) -> Float64[np.ndarray, "P S"]:
    from scipy.stats.qmc import Sobol

    sequence = Sobol(settings, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(sequence.random_base2(math.ceil(math.log2(points)))[:points])


def _latin_hypercube(settings: int, points: int, seed: int) -> Float64[np.ndarray, "P S"]:
    """Return the first points of Latin hypercubes of 1, 2, 4, … points, each with the one before in it (Qian 2009)."""
    shares = np.random.default_rng([seed, 1]).random((1, settings))
    while len(shares) < points:
        strata = 2 * len(shares)
        generator = np.random.default_rng([seed, strata])
        columns = []
        for column in shares.T:
            free = np.setdiff1d(np.arange(strata), np.floor(column * strata))
            columns.append((generator.permutation(free) + generator.random(len(free))) / strata)
        shares = np.concatenate([shares, np.stack(columns, axis=1)])
    return shares[:points]


def _random(settings: int, points: int, seed: int) -> Float64[np.ndarray, "P S"]:
    return np.random.default_rng(seed).random((points, settings))


_DESIGNS = {"sobol": _sobol, "latin-hypercube": _latin_hypercube, "random": _random}
