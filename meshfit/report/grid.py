"""A sheet laid out in cells of text, the same for every format that people read."""

from dataclasses import dataclass

from meshfit.measuring.metrics import METRICS
from meshfit.report.contrast import Row
from meshfit.report.numbers import mean_median_interval
from meshfit.report.paper import value_beside
from meshfit.report.sheet import Sheet

MISSING = "–"


@dataclass(frozen=True)
class Column:
    """A column: our figures of a metric on a target, or the paper's.

    Attributes:
        metric: dotted name of the metric.
        target: the target.
        heading: what stands above it: the target, and the metric where the sheet has several.
        below: what stands above it where the target's title stands above all its columns.
        paper: whether the figures are the paper's.
    """

    metric: str
    target: str
    heading: str
    below: str
    paper: bool = False


@dataclass(frozen=True)
class Entry:
    """The text of one place in the table.

    Attributes:
        text: mean and median, or what there is in their place.
        interval: the interval of the mean; empty where there is none.
        best: whether it is the best of its column.
        alike: whether it does not differ significantly from what it is compared with.
    """

    text: str
    interval: str = ""
    best: bool = False
    alike: bool = False


def columns(sheet: Sheet) -> list[Column]:
    """The columns: each metric on each target, and the paper's numbers beside it where the paper has some."""
    found = []
    several = len(sheet.metrics) > 1
    for target, title in sheet.targets.items():
        for metric in sheet.metrics:
            name = METRICS[metric].title
            found.append(Column(metric, target, f"{title}: {name}" if several else title, name))
            if any(shown_paper_value(sheet, metric, target, row.scheme) is not None for row in sheet.rows):
                found.append(Column(metric, target, f"paper's {target}", "paper's", paper=True))
    return found


def entries(sheet: Sheet, column: Column) -> list[Entry]:
    """What stands in a column, row by row."""
    if column.paper:
        values = [shown_paper_value(sheet, column.metric, column.target, row.scheme) for row in sheet.rows]
        return [Entry("" if value is None else f"{value}") for value in values]
    place = (column.metric, column.target)
    alike = {
        contrast.row
        for contrast in sheet.contrasts
        if (contrast.metric, contrast.target) == place and contrast.paired.significant is False
    }
    return [_entry(sheet, column, row, alike=row in alike) for row in sheet.rows]


def row_names(sheet: Sheet) -> tuple[str, ...]:
    """What it takes to name a row: its scheme, its variation, or both where the sheet has several of both."""
    if len(sheet.variations) == 1:
        return ("scheme",)
    return ("variation",) if len(sheet.schemes) == 1 else ("variation", "scheme")


def row_labels(sheet: Sheet, row: Row) -> tuple[str, ...]:
    """The name of a row, in as many parts as `row_names` has."""
    parts = {"variation": sheet.variations[row.variation], "scheme": row.scheme}
    return tuple(parts[name] for name in row_names(sheet))


def row_groups(sheet: Sheet) -> list[tuple[str, list[tuple[int, str]]]]:
    """Places and labels of rows, below the variation that they share; below no heading where one label names them."""
    labels = [(place, row_labels(sheet, row)) for place, row in enumerate(sheet.rows)]
    found: dict[str, list[tuple[int, str]]] = {}
    for place, (*above, label) in labels:
        found.setdefault("".join(above), []).append((place, label))
    return list(found.items())


def shown_paper_value(sheet: Sheet, metric: str, target: str, scheme: str) -> float | None:
    """The paper's number that stands beside a cell; none where settings vary, since it would stand beside each."""
    return value_beside(metric, target, scheme) if len(sheet.variations) == 1 else None


def _entry(sheet: Sheet, column: Column, row: Row, *, alike: bool) -> Entry:
    summary = sheet.summary(column.metric, column.target, row)
    if summary is None:
        return Entry(MISSING)
    text, interval = mean_median_interval(summary, whole=METRICS[column.metric].format in ("d", ""))
    return Entry(text, interval, best=sheet.best.get((column.metric, column.target)) == row, alike=alike)
