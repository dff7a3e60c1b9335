"""Rows of trials as a file for pandas and its like: CSV, or Parquet (the extra `parquet`)."""

import csv
import importlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from meshfit.errors import ConfigError
from meshfit.experiment.store import write_atomically
from meshfit.measuring.metrics import METRICS
from meshfit.report.rows import FAILURE_HEAD, HEAD, Row

_METRIC_TYPES = {"d": "int64", "": "bool"}
_KINDS = {bool: "bool", int: "int64", float: "float64", str: "string"}


def write_rows(rows: Sequence[Row], columns: Sequence[str], path: Path) -> None:
    """Write rows to a file, whole or not at all; its suffix says in which format.

    Raises:
        ConfigError: another suffix than .csv and .parquet, or pyarrow is needed and not installed.
        StoreError: it cannot be written.
    """
    write_atomically(path, encoder(path)(rows, columns))


def encoder(path: Path) -> Callable[[Sequence[Row], Sequence[str]], bytes]:
    """What makes the bytes of a file with this suffix.

    Raises:
        ConfigError: as `write_rows` does.
    """
    if path.suffix not in _ENCODERS:
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {found} is not a format that is known; allowed: {', '.join(_ENCODERS)}")
    if path.suffix == ".parquet":
        _pyarrow()
    return _ENCODERS[path.suffix]


def to_csv(rows: Sequence[Row], columns: Sequence[str]) -> bytes:
    """One header, then a line for each row: full precision, `true` and `false`, nothing where there is no value."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_word(row.get(column)) for column in columns] for row in rows)
    return text.getvalue().encode()


def to_parquet(rows: Sequence[Row], columns: Sequence[str]) -> bytes:
    """A typed column for each name: integers, floats, booleans and texts, null where there is no value.

    Raises:
        ConfigError: pyarrow is not installed.
    """
    arrow, parquet = _pyarrow()
    arrays = {column: _array(arrow, column, [row.get(column) for row in rows]) for column in columns}
    file = io.BytesIO()
    parquet.write_table(arrow.table(arrays), file)
    return file.getvalue()


_ENCODERS: Mapping[str, Callable[[Sequence[Row], Sequence[str]], bytes]] = MappingProxyType(
    {".csv": to_csv, ".parquet": to_parquet}
)


def _array(arrow: Any, column: str, values: list[Any]) -> Any:  # noqa: ANN401  pyarrow is optional
    kind = _kind(column, values)
    if kind == "string":
        values = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
    return arrow.array(values, arrow.type_for_alias(kind))


def _kind(column: str, values: Sequence[Any]) -> str:
    """The type of a column: that of its values, or where these say nothing, that which its values would have."""
    kinds = {_KINDS[type(value)] for value in values if value is not None}
    if kinds <= {"int64"} and column in METRICS:
        return _METRIC_TYPES.get(METRICS[column].format, "float64")
    if kinds == {"int64", "float64"}:
        return "float64"
    if not kinds:
        return "string" if column in (*HEAD, *FAILURE_HEAD) else "null"
    return kinds.pop() if len(kinds) == 1 else "string"


def _word(value: bool | float | str | None) -> str:  # noqa: FBT001
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value)


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise ConfigError("Parquet needs pyarrow, which is not installed: pip install 'meshfit[parquet]'") from None
