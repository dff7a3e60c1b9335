"""`measurement.json`: a later measurement of a complete trial, whose values are read in place of those of its fit."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock

from meshfit.errors import StoreError
from meshfit.experiment.storage.file_models import MeasurementContent, fault_in
from meshfit.experiment.storage.run_directory import (
    LOCK,
    Result,
    is_half_written,
    json_text,
    now,
    problem_with,
    read_json,
    write_atomically,
)
from meshfit.paths import write_error_message

MEASUREMENT = "measurement.json"
AGAIN = "measured_again"
"""Key of a result whose values are those of a later measurement: the time, the versions, and the earlier settings."""
_ORIGIN = ("identity", "finished")


def write_measurement(
    folder: Path, result: Result, values: Mapping[str, Any], settings: Mapping[str, Any], versions: Mapping[str, str]
) -> None:
    """Write a later measurement of a trial, whole or not at all; its `result.json` stays as it is.

    Args:
        folder: the folder of the trial.
        result: content of its `result.json`.
        values: entries of its result that depend on the settings of the measurement.
        settings: the settings of the measurement.
        versions: versions of the packages that measured.

    Raises:
        StoreError: it cannot be written.
    """
    origin = {key: result.get(key) for key in _ORIGIN}
    record = {"of": origin, "settings": dict(settings), "values": dict(values), "finished": now()}
    with _locked(folder):
        write_atomically(folder / MEASUREMENT, json_text(record | {"versions": dict(versions)}))


def remove_measurement(folder: Path) -> bool:
    """Remove the later measurement of a trial, so that it has the values of its fit; return whether there was one.

    Raises:
        StoreError: it cannot be removed.
    """
    path = folder / MEASUREMENT
    if not path.is_file():
        return False
    with _locked(folder):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be removed: {error.strerror}") from error
    return True


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a trial, and remove what a killed process was writing of its measurement."""
    try:
        with FileLock(folder / LOCK):
            for path in folder.glob(f".{MEASUREMENT}.*"):
                if is_half_written(path.name):
                    path.unlink(missing_ok=True)
            yield
    except OSError as error:
        raise StoreError(f"{folder}: {write_error_message(folder, error)}") from error


def with_measurement(folder: Path, result: Result) -> Result:
    """Return a result with the values of a later measurement, if there is one of this very result.

    Raises:
        StoreError: it cannot be read.
    """
    path = folder / MEASUREMENT
    if not path.is_file():
        return result
    remedy = f"delete it to have the values of the fit, or repeat `meshfit measure --again {folder}`"
    try:
        record = read_json(path)
    except StoreError as error:
        raise StoreError(f"{str(error).partition('; delete it')[0]}; {remedy}") from None
    if (fault := fault_in(MeasurementContent, record)) is not None:
        raise StoreError(f"{path}: not a measurement of a trial: {fault}; {remedy}")
    content = MeasurementContent.model_validate(record)
    if content.of != {key: result.get(key) for key in _ORIGIN}:  # the trial has run again since
        return result
    about: dict[str, Any] = {"finished": content.finished, "versions": content.versions}
    about["settings"] = result["settings"].get("measure", {})
    latest = {
        **result,
        **content.values,
        "settings": {**result["settings"], "measure": content.settings},
        AGAIN: about,
    }
    if (problem := problem_with(latest)) is not None:
        raise StoreError(f"{path}: {problem}; {remedy}")
    return latest
