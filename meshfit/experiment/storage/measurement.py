"""`measurement.json`: a later measurement of a complete trial, whose values are read in place of those of its fit."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import Result, json_text, now, problem_with, read_json, write_atomically

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
        values: groups of metrics that depend on the settings of the measurement.
        settings: the settings of the measurement.
        versions: versions of the packages that measured.

    Raises:
        StoreError: it cannot be written.
    """
    origin = {key: result.get(key) for key in _ORIGIN}
    record = {"of": origin, "settings": dict(settings), "values": dict(values), "finished": now()}
    write_atomically(folder / MEASUREMENT, json_text(record | {"versions": dict(versions)}))


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
        if record["of"] != {key: result.get(key) for key in _ORIGIN}:  # the trial has run again since
            return result
        values, settings = dict(record["values"]), dict(record["settings"])
        about: dict[str, Any] = {"finished": str(record["finished"]), "versions": dict(record["versions"])}
    except StoreError as error:
        raise StoreError(f"{str(error).partition('; delete it')[0]}; {remedy}") from None
    except (KeyError, TypeError, ValueError):
        raise StoreError(f"{path}: not a measurement of a trial; {remedy}") from None
    about["settings"] = result["settings"].get("measure", {})
    latest = {**result, **values, "settings": {**result["settings"], "measure": settings}, AGAIN: about}
    if (problem := problem_with(latest)) is not None:
        raise StoreError(f"{path}: {problem}; {remedy}")
    return latest
