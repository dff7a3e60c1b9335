"""Tables as tidy CSV: a row for each table, target and scheme, at full precision."""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO

from meshfit.report.grid import shown_paper_value
from meshfit.report.paper import OTHER, paper_value
from meshfit.report.table import ResultTable

FIELDS = (
    "table", "experiment", "metric", "target", "target_title", "scheme",
    "mean", "spread", "median", "count", "seeds", "best", "paper", "paper_other_reading",
    "baseline", "difference", "low", "high", "common_seeds", "significant",
)  # fmt: skip


def to_csv(tables: Sequence[ResultTable]) -> str:
    """One header, then the rows of all tables; what does not exist is empty."""
    text = StringIO()
    writer = csv.DictWriter(text, FIELDS, restval="", lineterminator="\n")
    writer.writeheader()
    for table in tables:
        writer.writerows(_rows(table))
    return text.getvalue()


def _rows(table: ResultTable) -> Iterator[dict[str, object]]:
    for target, title in table.targets.items():
        for scheme in table.schemes:
            names = {"table": table.title, "experiment": table.experiment, "metric": table.metric}
            place = {"target": target, "target_title": title, "scheme": scheme}
            yield {**names, **place, **_cell(table, target, scheme), **_difference(table, target, scheme)}


def _cell(table: ResultTable, target: str, scheme: str) -> dict[str, object]:
    row: dict[str, object] = {"count": 0}
    if summary := table.cells.get((target, scheme)):
        row = {
            "mean": summary.mean,
            "spread": "" if summary.spread is None else summary.spread,
            "median": summary.median,
            "count": summary.count,
            "seeds": " ".join(map(str, sorted(table.samples[target, scheme]))),
            "best": _word(table.best.get(target) == scheme),
        }
    if (paper := shown_paper_value(table, target, scheme)) is not None:
        row |= {"paper": paper, "paper_other_reading": paper_value(target, scheme, OTHER)}
    return row


def _difference(table: ResultTable, target: str, scheme: str) -> dict[str, object]:
    for found in table.differences:
        if (found.target, found.scheme) == (target, scheme):
            paired = found.paired
            row: dict[str, object] = {"baseline": found.baseline, "difference": paired.mean}
            if paired.interval is not None:
                row |= {"low": paired.interval[0], "high": paired.interval[1]}
            return row | {"common_seeds": paired.count, "significant": _word(paired.significant)}
    return {}


def _word(value: bool | None) -> str:  # noqa: FBT001
    return "" if value is None else str(value).lower()
