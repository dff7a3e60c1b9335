"""Trials as rows of one flat table: every metric and every setting by its dotted name."""

import csv
import importlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from meshfit.config.experiment import default_settings
from meshfit.errors import ConfigError
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.result import read_result, read_settings
from meshfit.experiment.storage.run_directory import Result, write_atomically
from meshfit.experiment.trial_status import TrialStatus
from meshfit.fitting.settings import METHODS
from meshfit.measuring.metrics import METRICS
from meshfit.report.tables.grouping import flatten

Row = Mapping[str, bool | int | float | str | None]

HEAD = ("experiment", "target", "target_title", "scheme", "seed", "variant", "state", "identity", "folder")
FAILURE_HEAD = ("failure.kind", "failure.message")

# What follows metrics and settings, by the beginning of its name.
_AFTER = ("fit.", "seconds.", "peak_memory_mb", "warnings", "frame.", "versions.", "platform.", "inputs.")
_NOT_SHOWN = {*HEAD, "settings", "traceback", "log"}


def rows_of(experiments: Sequence[ScannedExperiment]) -> list[Row]:
    """A row for each trial that is complete or failed, in the order of their folders.

    Raises:
        StoreError: a file of one cannot be read.
        ConfigError: the settings of one are no settings.
    """
    ended = (TrialStatus.COMPLETE, TrialStatus.FAILED)
    return [
        _row(experiment, trial) for experiment in experiments for trial in experiment.trials if trial.status in ended
    ]


def columns_of(rows: Sequence[Row]) -> list[str]:
    """The columns that some rows have, in an order that does not hang on which rows these are."""
    found = dict.fromkeys(key for row in rows for key in row)
    settings = [key for key in _settings() if key in found]
    first = dict.fromkeys((*HEAD, *METRICS, *settings))
    rest = [key for key in found if key not in first and key not in FAILURE_HEAD]
    failure = [key for key in rest if key.startswith("failure.")]
    after = sorted((key for key in rest if key not in failure), key=_place)
    return [*first, *after, *FAILURE_HEAD, *failure]


def _row(experiment: ScannedExperiment, trial: ScannedTrial) -> Row:
    result = read_result(trial.path)
    settings = read_settings(trial.path, result)
    record = _failure_record(trial) if result is None else result
    head = {
        "experiment": record.get("experiment", experiment.name),
        "target": record.get("target", trial.target),
        "target_title": record.get("target_title", trial.planned.target_title if trial.planned else trial.target),
        "scheme": record.get("scheme", next(iter(settings.get("schemes", ())), trial.scheme)),
        "seed": record.get("seed", trial.seed),
        "variant": record.get("variant", trial.variant),
        "state": trial.status.value,
        "identity": record.get("identity", trial.identity),
        "folder": str(trial.path),
    }
    rest = {key: value for key, value in record.items() if key not in _NOT_SHOWN}
    facts = flatten(rest if result is not None else {"failure": rest})
    return {key: _cell(value) for key, value in (head | facts | flatten(settings)).items()}


def _failure_record(trial: ScannedTrial) -> Result:
    """What is known of a failure, even where its record is damaged."""
    failure = read_failure(trial.path)
    return failure.record | {"kind": failure.kind, "message": failure.message}


def _cell(value: Any) -> bool | int | float | str | None:  # noqa: ANN401  whatever JSON holds
    return value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)


def _settings() -> list[str]:
    """Every setting there is, of one engine or the other, in the order of a config."""
    found: dict[str, None] = {}
    for key, value in default_settings().items():
        several = [model().model_dump(mode="json") for model in METHODS.values()] if key == "fit" else [value]
        for one in several:
            found |= dict.fromkeys(flatten({key: one}))
    return list(found)


def _place(column: str) -> tuple[int, str]:
    """Those whose place is not known come last."""
    places = [place for place, start in enumerate(_AFTER) if column.startswith(start)]
    return (places[0], "") if places else (len(_AFTER), column)


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
