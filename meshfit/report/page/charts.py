"""The data of a wall's charts: curves of all its trials, and where each of them ended."""

from collections.abc import Mapping
from typing import Any

from meshfit.report.gather import Result
from meshfit.report.page.exhibits import Wall, row_title
from meshfit.report.page.traces import Curves


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
        sample = sheet.sample(sheet.metrics[0], wall.target, sheet.rows[place])
        for seed, result in by_seed.items():
            seconds = result.get("seconds", {}).get("fit")
            if seed in sample and isinstance(seconds, int | float):
                found.append({"row": place, "seed": seed, "seconds": round(seconds, 3), "value": sample[seed]})
    return found
