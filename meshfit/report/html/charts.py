"""Differences with their intervals, as lines beside zero: places along one axis, in percent of its width."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from meshfit.experiment.storage.run_directory import Result
from meshfit.mesh.mesh import Mesh
from meshfit.report.html.images import limit_of
from meshfit.report.html.target_section import Subjects, Wall, row_title
from meshfit.statistics import PairedDifference

_MARGIN = 4.0


@dataclass(frozen=True)
class Whisker:
    """Where zero, the mean and the ends of the interval are, from 0 to 100."""

    zero: float
    mean: float
    low: float
    high: float


def whiskers(paired: Sequence[PairedDifference]) -> list[Whisker | None]:
    """Where differences lie along one axis that holds all of them, and zero; None for one without an interval."""
    ends = [0.0, *(end for each in paired if each.interval is not None for end in each.interval)]
    least, most = min(ends), max(ends)
    width = (most - least) or 1.0

    def place(value: float) -> float:
        return round(_MARGIN + (100 - 2 * _MARGIN) * (value - least) / width, 2)

    return [
        None
        if each.interval is None
        else Whisker(place(0.0), place(each.mean), place(each.interval[0]), place(each.interval[1]))
        for each in paired
    ]


BINS = 40


@dataclass(frozen=True)
class Histogram:
    """The distances of one result.

    Attributes:
        place: which row of the sheet it belongs to.
        shares: of the area in each bin, in percent.
        beyond: share of the area that is farther off than the last bin, in percent.
    """

    place: int
    shares: tuple[float, ...]
    beyond: float


def histograms_of(subjects: Subjects) -> dict[str, Any]:
    """The histograms of a wall, for the charts; they end where its scale of colours does."""
    limit = limit_of(subjects)
    found = [
        histogram(subject.exhibit.place, subject.result, subject.distances, limit)
        for subject in subjects.shown
        if subject.distances is not None
    ]
    rows = [{"row": each.place, "shares": each.shares, "beyond": each.beyond} for each in found]
    return {"limit": limit, "rows": rows}


def histogram(place: int, mesh: Mesh, distances: Float64[np.ndarray, " V"], limit: float) -> Histogram:
    """The shares of a mesh's area by distance, in even bins from 0 to `limit`."""
    weights = vert_areas(mesh)
    weights = weights / (weights.sum() or 1.0) * 100
    shares, _ = np.histogram(distances, bins=BINS, range=(0.0, limit), weights=weights)
    beyond = float(weights[distances > limit].sum())
    return Histogram(place, tuple(round(float(share), 3) for share in shares), round(beyond, 3))


def vert_areas(mesh: Mesh) -> Float64[np.ndarray, " V"]:
    """(V,) a third of the area of the faces at each vert."""
    corners = mesh.verts[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 6
    return np.bincount(mesh.faces.reshape(-1), weights=np.repeat(areas, 3), minlength=mesh.num_verts)


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


def chart_of(wall: Wall, curves: Curves, by_row: Mapping[int, Mapping[int, Result]]) -> dict[str, Any]:
    """What the charts of a wall need, as plain data."""
    sheet = wall.sheet
    return {
        "key": wall.key,
        "title": wall.title,
        "metric": wall.metric,
        "unit": wall.unit,
        "trials": curves.trials,
        "rows": [row_title(sheet, row) for row in sheet.rows],
        "present": list(by_row),
        "terms": curves.terms,
        "nearness": curves.nearness,
        "curves": [curve.data() for curve in curves.curves],
        "ends": _ends(wall, by_row),
    }


def _ends(wall: Wall, by_row: Mapping[int, Mapping[int, Result]]) -> list[dict[str, Any]]:
    """The seconds that each fit took, and the value of the first metric that it came to."""
    sheet, found = wall.sheet, []
    for place, by_seed in by_row.items():
        sample = sheet.samples.get((sheet.metrics[0], wall.target, sheet.rows[place]), {})
        for seed, result in by_seed.items():
            seconds = result.get("seconds", {}).get("fit")
            if seed in sample and isinstance(seconds, int | float):
                found.append({"row": place, "seed": seed, "seconds": round(seconds, 3), "value": sample[seed]})
    return found
