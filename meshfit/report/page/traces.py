"""The curves of trials: what `trace.csv` has of each step, thinned to what a page can carry."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshfit.report.gather import Result

TRACE = "trace.csv"
MOST_POINTS = 150
MOST_CURVES = 60
"""On one target; with more, the first seeds of each row stand for all."""

_STEP = "step"
_DIGITS = 4
# What tells how near a fit has come, in either engine's trace.
_NEARNESS = ("distance", "chamfer")


@dataclass(frozen=True)
class Curve:
    """What a trial went through.

    Attributes:
        place: which row of the sheet it belongs to.
        seed: of the trial.
        seconds: that the fit took; None where the result does not say.
        steps: those that have values.
        values: by name of the column; None where there is no finite number.
    """

    place: int
    seed: int
    seconds: float | None
    steps: tuple[float, ...]
    values: Mapping[str, tuple[float | None, ...]]

    def data(self) -> dict[str, Any]:
        """What the charts need."""
        return {
            "row": self.place,
            "seed": self.seed,
            "seconds": self.seconds,
            "steps": self.steps,
            "values": dict(self.values),
        }


@dataclass(frozen=True)
class Curves:
    """The curves of one target in one sheet.

    Attributes:
        curves: as many as there is room for.
        trials: how many trials there are.
        terms: names of columns, what tells nearness first; those that never change are left out.
        nearness: the column that tells how near the fit has come; empty where none does.
        problems: traces that could not be read.
    """

    curves: tuple[Curve, ...]
    trials: int
    terms: tuple[str, ...]
    nearness: str
    problems: tuple[str, ...]


def curves_of(by_row: Mapping[int, Mapping[int, Result]]) -> Curves:
    """The curves of some trials, which are given by place of the row, then by seed."""
    each = max(1, MOST_CURVES // max(1, len(by_row)))
    curves, problems = [], []
    for place, by_seed in by_row.items():
        for result in list(by_seed.values())[:each]:
            try:
                curves.append(_read(place, result))
            except (OSError, ValueError) as error:
                problems.append(f"{result['folder']}/{TRACE}: {error}")
    terms = _terms(curves)
    nearness = next((term for term in _NEARNESS if term in terms), "")
    return Curves(tuple(curves), sum(map(len, by_row.values())), tuple(terms), nearness, tuple(problems))


def thinned(count: int, most: int) -> list[int]:
    """So many places at most among a number of them, evenly apart, the first and the last included."""
    if count <= most:
        return list(range(count))
    return sorted({round(place * (count - 1) / (most - 1)) for place in range(most)})


def _read(place: int, result: Result) -> Curve:
    with (Path(result["folder"]) / TRACE).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows or _STEP not in rows[0]:
        raise ValueError("no steps in it")
    kept = [rows[at] for at in thinned(len(rows), MOST_POINTS)]
    seconds = result.get("seconds", {}).get("fit")
    return Curve(
        place=place,
        seed=result["seed"],
        seconds=_short(seconds) if isinstance(seconds, int | float) else None,
        steps=tuple(float(row[_STEP]) for row in kept),
        values={name: tuple(_short(row[name]) for row in kept) for name in rows[0] if name != _STEP},
    )


def _short(text: str | float | None) -> float | None:
    """A number in as many digits as a curve shows."""
    value = float(text or "nan")
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def _terms(curves: Sequence[Curve]) -> list[str]:
    """Columns in which some curve moves, in the order of the files, what tells nearness first."""
    found = dict.fromkeys(
        name for curve in curves for name, values in curve.values.items() if len(set(values) - {None}) > 1
    )
    return sorted(found, key=lambda name: _NEARNESS.index(name) if name in _NEARNESS else len(_NEARNESS))
