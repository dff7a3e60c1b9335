"""Measurements as tables on a terminal, as CSV and as JSON."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import typer
from rich.table import Table
from rich.text import Text

from meshfit.cli.console import out
from meshfit.measuring.metrics import CORRESPONDING, LENGTH, MEASURED, OF_IMAGES, OF_MEASUREMENTS
from meshfit.paths import STREAM, path_text
from meshfit.printable import csv_cell
from meshfit.units import count_text

GAP = 2
_COLUMNS = (
    "hausdorff.symmetric",
    "hausdorff.percent_of_diagonal",
    "distance.mean",
    "f_score.f1",
    "quality.self_intersecting_faces",
    "quality.flipped_faces",
)
"""The metrics of a table of several results."""

_WITH_TAU = ("f_score.", "edges.f1", "edges.precision", "edges.recall")
"""The starts of the names of metrics that count points within a distance."""
_COLUMNS_OF_CLOUDS = ("distance.backward_rms", "distance.backward_mean", "hausdorff.backward", *_COLUMNS)
"""Those where the target is a cloud of points, from which distances are exact."""
_COLUMNS_OF_TEMPLATES = (
    "iou.mean",
    "vertex_error.rms",
    "landmark_error.rms",
    "stretch.p99",
    "new_defects.crossing_faces",
)
"""Those that come first where they were measured."""
OF_MASKS_ALONE = (*OF_IMAGES, *(name for name in MEASURED if name.startswith("quality.")))
"""Those of results of images that tell no distance: without depth, and without a true mesh."""

_RESULT, _FAILED = "result", "failed"
_LEAST = 12
"""Width to which headings are wrapped."""
_WIDEST = 1000

Values = Mapping[str, Any]
"""The nested values of a measurement."""


@dataclass(frozen=True)
class Measured:
    """A result that has been measured, or the reason why it could not be."""

    result: str
    values: Values
    error: str = ""


def json_object(measured: Sequence[Measured], about: Mapping[str, str], *, single: bool) -> dict[str, Any]:
    """Return the JSON object of a single result, or of several."""
    if single:
        return {"result": measured[0].result, **about, **measured[0].values}
    results = [{"result": each.result, **({"error": each.error} if each.error else each.values)} for each in measured]
    return {**about, "results": results}


def _value(values: Values, name: str) -> Any:  # noqa: ANN401  a number, a boolean or None
    group, _, key = name.partition(".")
    return values[group][key]


def _text(values: Values, name: str) -> str:
    value = _value(values, name)
    return (
        "–" if value is None else str(value) if isinstance(value, bool) else format(value, OF_MEASUREMENTS[name].format)
    )


# CSV.


def write_csv(
    path: str, measured: Sequence[Measured], target: str, metrics: Sequence[str] | None, *, wide: bool
) -> None:
    """Write CSV to a file or to standard output.

    Args:
        path: of the file; `-` is standard output.
        measured: the results.
        target: name of the target.
        metrics: those to write; None for everything that was measured.
        wide: one row per result, rather than one per metric of the only result.

    Raises:
        StoreError: the file cannot be written.
    """
    from meshfit.experiment.storage.run_directory import write_atomically

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in _wide_rows(measured, metrics) if wide else _long_rows(measured[0], target, metrics):
        writer.writerow(map(csv_cell, row))
    if path == STREAM:
        typer.echo(text.getvalue(), nl=False)
    else:
        write_atomically(Path(path), text.getvalue())


def _long_rows(measured: Measured, target: str, metrics: Sequence[str] | None) -> Iterator[Sequence[object]]:
    """Yield one row per metric; without a choice, also for the settings and the farthest points."""
    yield "result", "target", "metric", "value", "unit"
    for name, value in _flat(measured.values, metrics).items():
        yield measured.result, target, name, value, _unit(name)


def _unit(name: str) -> str:
    if name in OF_MEASUREMENTS:
        return OF_MEASUREMENTS[name].unit
    return LENGTH if name == "f_score.tau" or (name.startswith("farthest") and not name.endswith("face")) else ""


def _wide_rows(measured: Sequence[Measured], metrics: Sequence[str] | None) -> Iterator[Sequence[object]]:
    """Yield one row per result, with the error of one that could not be measured."""
    flat = [_flat(each.values, metrics) if each.values else {} for each in measured]
    columns = list(dict.fromkeys([*(metrics or MEASURED), *(name for values in flat for name in values)]))
    yield "result", *columns, "error"
    for each, values in zip(measured, flat, strict=True):
        yield each.result, *map(values.get, columns), each.error or None


def _flat(values: Values, metrics: Sequence[str] | None) -> dict[str, object]:
    """Return values by dotted name: those of some metrics, or all, with coordinates as x, y and z."""
    if metrics:
        return {name: _value(values, name) for name in metrics}
    flat: dict[str, object] = {}

    def add(name: str, value: object) -> None:
        if isinstance(value, list):
            value = dict(zip("xyz", value, strict=True))
        if isinstance(value, Mapping):
            for key, inner in value.items():
                add(f"{name}.{key}" if name else key, inner)
        else:
            flat[name] = value

    add("", values)
    return flat


# The table.


def print_measured(
    measured: Sequence[Measured],
    target: str,
    metrics: Sequence[str] | None,
    diagonal: float,
    *,
    surface: str = "all",
    single: bool,
) -> None:
    """Print the metrics of a single result, one per row with notes, or several results, one per row.

    Args:
        measured: the results.
        target: name of the target.
        metrics: those to print; None for all, or a choice of several results.
        diagonal: of the target's bounding box.
        surface: the surfaces that were measured between, `all` or `outer`.
        single: whether there is one result, that was not given with others.
    """
    against = f"against {path_text(target)}" + (", between their outer surfaces" if surface == "outer" else "")
    if single:
        title = f"{path_text(measured[0].result)} {against}"
        out.print(title, soft_wrap=True, markup=False, style="italic")
        out.print(_table(measured[0], metrics))
        notes = _tau_notes(measured, metrics, diagonal) if metrics else _notes(measured[0].values, diagonal)
    elif any(each.values for each in measured):
        out.print(against, soft_wrap=True, markup=False, style="italic")
        usual = _COLUMNS_OF_CLOUDS if any("cloud" in each.values for each in measured) else _COLUMNS
        groups = {group for each in measured for group in each.values}
        usual = (*(name for name in _COLUMNS_OF_TEMPLATES if name.partition(".")[0] in groups), *usual)
        for number, table in enumerate(_results_tables(measured, metrics or usual, out.width)):
            if number:
                out.print()
            out.print(table, width=max(out.width, _WIDEST), crop=False)
        notes = _tau_notes(measured, metrics or usual, diagonal)
    else:
        return
    for line in notes:
        out.print(line, soft_wrap=single, markup=False)


def _table(measured: Measured, metrics: Sequence[str] | None) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("metric")
    table.add_column("value", justify="right", style="bold")
    before = ""
    for name in metrics or _order(measured.values):
        group = name.partition(".")[0]
        if not metrics and before not in ("", group):
            table.add_row()
        table.add_row(OF_MEASUREMENTS[name].title, _text(measured.values, name))
        before = group
    return table


def _order(values: Values) -> list[str]:
    """All metrics; first those against truth and source, then for a target of points those from it to the result."""
    first = [name for name in (*OF_IMAGES, *CORRESPONDING) if name.partition(".")[0] in values]
    if "cloud" in values:
        first += [name for name in MEASURED if ".backward" in name]
    return [*first, *(name for name in MEASURED if name not in first)]


def _results_tables(measured: Sequence[Measured], metrics: Sequence[str], width: int) -> Iterator[Table]:
    """Yield tables of some of the metrics each, so that none is wider than a width, if that can be."""
    names = [path_text(each.result) for each in measured]
    columns: list[_Column] = []
    left = width - max(len(_RESULT), *map(len, names))
    for metric in metrics:
        column = _Column.of(metric, measured)
        if columns and sum(GAP + other.width for other in [*columns, column]) > left:
            yield _results_table(names, columns)
            columns = []
        columns = [*columns, column]
    yield _results_table(names, columns)


def _results_table(names: Sequence[str], columns: Sequence["_Column"]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    table.add_column(_RESULT, no_wrap=True, vertical="bottom")
    for column in columns:
        table.add_column("\n".join(column.heading), justify="right", no_wrap=True, min_width=column.width)
    for name, *cells in zip(names, *(column.cells for column in columns), strict=True):
        table.add_row(Text(name), *cells)
    return table


@dataclass(frozen=True)
class _Column:
    """The lines of the heading of a metric, and its cells."""

    heading: Sequence[str]
    cells: Sequence[str]

    @classmethod
    def of(cls, metric: str, measured: Sequence[Measured]) -> "_Column":
        cells = [_text(each.values, metric) if each.values else _FAILED for each in measured]
        return cls(wrap(OF_MEASUREMENTS[metric].title, max(_LEAST, *map(len, cells))), cells)

    @property
    def width(self) -> int:
        return max(map(len, [*self.heading, *self.cells]))


def _notes(values: Values, diagonal: float) -> Iterator[str]:
    """Yield lines on the farthest points, the settings, and missing values."""
    yield ""
    for direction, own, other in (("forward", "result", "target"), ("backward", "target", "result")):
        point = values["farthest"][direction]
        where, near = _position(point["position"]), _position(point["nearest"])
        on, beside = _on(point["face"], own), _on(point["nearest_face"], other)
        yield f"farthest from the {other}: {point['distance']:.4g} at {where}, {on};"
        yield f"  nearest to it: {near}, {beside}"
    if "cloud" in values:
        yield from _notes_of_cloud(values["cloud"])
    yield (
        f"{values['hausdorff']['samples']:,} samples and {values['chamfer']['points']:,} points per surface, "
        f"{_tau_text(values, diagonal)}"
    )
    if values.get("stretch", {}).get("scale", 1.0) != 1.0:
        yield f"stretch is that of the source made {values['stretch']['scale']:.4g} times as large"
    if reason := values["edges"]["reason"]:
        yield f"–: {reason}"


def _tau_notes(measured: Sequence[Measured], metrics: Sequence[str], diagonal: float) -> Iterator[str]:
    """Yield a line on the distance of the F-scores, if one is printed."""
    values = next(each.values for each in measured if each.values)
    if any(name.startswith(_WITH_TAU) for name in metrics):
        yield ""
        yield _tau_text(values, diagonal)


def _tau_text(values: Values, diagonal: float) -> str:
    tau = values["f_score"]["tau"]
    return f"F-scores at τ = {tau:.4g}, {100 * tau / diagonal:.3g} % of the target's diagonal"


def _notes_of_cloud(cloud: Mapping[str, Any]) -> Iterator[str]:
    count = count_text(cloud["points"], "point")
    spacing = f"{cloud['spacing']:.4g}"
    yield f"the target is {count}, about {spacing} apart: distances from it are exact, those to it do not fall below"
    yield "  about half of that, and grow where the result goes on beyond the scan"
    if cloud["normals"] == "estimated":
        yield "it has no normals: angles are to estimated ones, which have no side, and thus at most 90°"


def _on(face: int | None, role: str) -> str:
    return f"a point of the {role}" if face is None else f"face {face} of the {role}"


def _position(point: Sequence[float]) -> str:
    return f"({', '.join(format(coordinate, '.6g') for coordinate in point)})"
