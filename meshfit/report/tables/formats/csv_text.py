"""Tables as tidy CSV: a row for each table, target and scheme, at full precision."""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO

from meshfit.report.tables.paper_numbers import OTHER, paper_value, value_beside
from meshfit.report.tables.sheet import Sheet
from meshfit.report.tables.table import Difference, ResultTable

FIELDS = (
    "table", "experiment", "variant", "metric", "target", "target_title", "scheme",
    "mean", "mean_low", "mean_high", "spread", "median", "count", "seeds", "best", "paper", "paper_other_reading",
    "baseline", "difference", "low", "high", "common_seeds", "significant", "improvement", "seeds_needed",
)  # fmt: skip


def to_csv(sheets: Sequence[Sheet]) -> str:
    """One header, then the rows of all tables; what does not exist is empty, as the target of a mean over targets."""
    text = StringIO()
    writer = csv.DictWriter(text, FIELDS, restval="", lineterminator="\n")
    writer.writeheader()
    for table in (table for sheet in sheets for table in sheet.all_tables):
        writer.writerows(_rows(table))
    return text.getvalue()


def _rows(table: ResultTable) -> Iterator[dict[str, object]]:
    names = {"table": table.title, "experiment": table.experiment, "variant": table.variant, "metric": table.metric}
    differences = {(found.target, found.scheme): found for found in table.differences}
    for target, title in table.targets.items():
        for scheme in table.schemes:
            place = {"target": target, "target_title": title, "scheme": scheme}
            yield {**names, **place, **_cell(table, target, scheme), **_difference(differences.get((target, scheme)))}
    for found in table.over_targets:
        place = {"target_title": f"mean over {found.paired.targets} targets", "scheme": found.scheme}
        yield {**names, **place, **_difference(found)}


def _cell(table: ResultTable, target: str, scheme: str) -> dict[str, object]:
    row: dict[str, object] = {"count": 0}
    if summary := table.cells.get((target, scheme)):
        low, high = summary.interval or ("", "")
        row = {
            "mean": summary.mean,
            "mean_low": low,
            "mean_high": high,
            "spread": _value(summary.spread),
            "median": summary.median,
            "count": summary.count,
            "seeds": " ".join(map(str, sorted(table.samples[target, scheme]))),
            "best": _value(table.best.get(target) == scheme),
        }
    if (paper := value_beside(table.metric, target, scheme)) is not None:
        row |= {"paper": paper, "paper_other_reading": paper_value(target, scheme, OTHER)}
    return row


def _difference(found: Difference | None) -> dict[str, object]:
    if found is None:
        return {}
    paired = found.paired
    low, high = paired.interval or ("", "")
    return {
        "baseline": found.baseline,
        "difference": paired.mean,
        "low": low,
        "high": high,
        "common_seeds": paired.count,
        "significant": _value(paired.significant),
        "improvement": _value(paired.improvement),
        "seeds_needed": _value(paired.seeds_needed),
    }


def _value(value: float | None) -> object:
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None else value
