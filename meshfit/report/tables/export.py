"""The export: one record per trial, with every metric and setting by its dotted name, as CSV or Parquet."""

import csv
import importlib
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from meshfit.config.experiment import default_settings
from meshfit.errors import ConfigError
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial, absolute
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.result import read_settings
from meshfit.experiment.storage.run_directory import Result, write_atomically
from meshfit.experiment.trial_status import TrialStatus
from meshfit.fitting.settings import METHODS, default_fit
from meshfit.measuring.metrics import METRICS
from meshfit.printable import csv_cell
from meshfit.report.tables.grouping import flatten

Record = Mapping[str, bool | int | float | str | None]

HEAD = ("experiment", "target", "target_title", "scheme", "seed", "variant", "state", "identity", "folder")
"""The first columns, which identify a trial; metrics and settings follow."""
FAILURE_HEAD = ("failure.kind", "failure.message")

# Order of the columns after metrics and settings, by prefix.
_AFTER = (
    *("fit.", "tool.", "seconds.", "peak_memory_mb", "supported", "warnings", "shortfalls"),
    *("frame.", "versions.", "platform.", "inputs."),
)
_OMITTED = {*HEAD, "settings", "traceback", "log"}
_METRIC_TYPES = {"d": "int64", "": "bool"}
_TYPES = {bool: "bool", int: "int64", float: "float64", str: "string"}


def records_of(experiments: Sequence[ScannedExperiment], results: Iterable[Result]) -> list[Record]:
    """Return the record of each completed or failed trial, in the order of the experiments' trials.

    Args:
        experiments: the experiments, as `scan_with_results` returns them.
        results: their results.

    Raises:
        StoreError: a file of a trial cannot be read.
        ConfigError: the settings of a trial are invalid.
    """
    by_folder = {absolute(Path(result["folder"])): result for result in results}
    ended = (
        (experiment, trial, by_folder.get(absolute(trial.path)))
        for experiment in experiments
        for trial in experiment.trials
        if trial.status in (TrialStatus.COMPLETE, TrialStatus.FAILED)
    )
    return [_record(*trial) for trial in ended if trial[1].status is TrialStatus.FAILED or trial[2] is not None]


def _record(experiment: ScannedExperiment, trial: ScannedTrial, result: Result | None) -> Record:
    settings = read_settings(trial.path, result)
    stored = _failure(trial) if result is None else result
    head = {
        "experiment": stored.get("experiment", experiment.name),
        "target": stored.get("target", trial.target),
        "target_title": stored.get("target_title", trial.planned.target_title if trial.planned else trial.target),
        "scheme": stored.get("scheme", next(iter(settings.get("schemes", ())), trial.scheme)),
        "seed": stored.get("seed", trial.seed),
        "variant": stored.get("variant", trial.variant),
        "state": trial.status.value,
        "identity": stored.get("identity", trial.identity),
        "folder": str(trial.path),
    }
    rest = {key: value for key, value in stored.items() if key not in _OMITTED}
    values = head | flatten(rest if result is not None else {"failure": rest}) | flatten(settings)
    return {key: value if _is_scalar(value) else json.dumps(value) for key, value in values.items()}


def _failure(trial: ScannedTrial) -> Result:
    """Return the record of a failure; if it is damaged, its kind and message say so."""
    failure = read_failure(trial.path)
    return failure.record | {"kind": failure.kind, "message": failure.message}


def _is_scalar(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float | str)


def columns_of(records: Sequence[Record]) -> list[str]:
    """Return the columns of all records, in an order that does not depend on which records these are."""
    present = dict.fromkeys(key for record in records for key in record)
    first = dict.fromkeys((*HEAD, *METRICS, *(key for key in _setting_keys() if key in present)))
    rest = [key for key in present if key not in first and key not in FAILURE_HEAD]
    failure = [key for key in rest if key.startswith("failure.")]
    after = sorted((key for key in rest if key not in failure), key=_place_after)
    return [*first, *after, *FAILURE_HEAD, *failure]


def _setting_keys() -> list[str]:
    """Return the keys of all settings, of every method, in the order of a config."""
    keys: dict[str, None] = {}
    for key, value in default_settings().items():
        values = [default_fit(method) for method in METHODS] if key == "fit" else [value]
        for each in values:
            keys |= dict.fromkeys(flatten({key: each}))
    return list(keys)


def _place_after(column: str) -> tuple[int, str]:
    places = [place for place, prefix in enumerate(_AFTER) if column.startswith(prefix)]
    return (places[0], "") if places else (len(_AFTER), column)


def write_records(records: Sequence[Record], columns: Sequence[str], path: Path) -> None:
    """Write records to a file atomically, in the format of its suffix.

    Raises:
        ConfigError: the suffix is neither .csv nor .parquet, or pyarrow is required and not installed.
        StoreError: the file cannot be written.
    """
    write_atomically(path, encoder(path)(records, columns))


def encoder(path: Path) -> Callable[[Sequence[Record], Sequence[str]], bytes]:
    """Return the function that encodes records for a file with this suffix.

    Raises:
        ConfigError: as for `write_records`.
    """
    if path.suffix not in _ENCODERS:
        suffix = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(f"{path}: {suffix} is not a known format; allowed: {', '.join(_ENCODERS)}")
    if path.suffix == ".parquet":
        _pyarrow()
    return _ENCODERS[path.suffix]


def to_csv(records: Sequence[Record], columns: Sequence[str]) -> bytes:
    """Encode as CSV at full precision: booleans are `true` and `false`, missing values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([csv_cell(record.get(column)) for column in columns] for record in records)
    return text.getvalue().encode()


def to_parquet(records: Sequence[Record], columns: Sequence[str]) -> bytes:
    """Encode as Parquet with typed columns: integers, floats, booleans or texts; missing values are null.

    Raises:
        ConfigError: pyarrow is not installed.
    """
    arrow, parquet = _pyarrow()
    arrays = {column: _array(arrow, column, [record.get(column) for record in records]) for column in columns}
    file = io.BytesIO()
    parquet.write_table(arrow.table(arrays), file)
    return file.getvalue()


_ENCODERS: Mapping[str, Callable[[Sequence[Record], Sequence[str]], bytes]] = MappingProxyType(
    {".csv": to_csv, ".parquet": to_parquet}
)


def _array(arrow: Any, column: str, values: list[Any]) -> Any:  # noqa: ANN401  pyarrow is optional
    kind = _type(column, values)
    if kind == "string":
        values = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
    return arrow.array(values, arrow.type_for_alias(kind))


def _type(column: str, values: Sequence[Any]) -> str:
    """Return the type of a column: that of its values, or if there are none, the one that its values would have."""
    types = {_TYPES[type(value)] for value in values if value is not None}
    if types <= {"int64"} and column in METRICS:
        return _METRIC_TYPES.get(METRICS[column].format, "float64")
    if types == {"int64", "float64"}:
        return "float64"
    if not types:
        return "string" if column in (*HEAD, *FAILURE_HEAD) else "null"
    return types.pop() if len(types) == 1 else "string"


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise ConfigError("Parquet requires pyarrow, which is not installed: pip install 'meshfit[parquet]'") from None
