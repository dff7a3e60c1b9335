"""What the files of one trial say: its settings, its result, and when that was written."""

from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from meshfit.config.strict_yaml import parse_document
from meshfit.errors import StoreError
from meshfit.experiment.folders import State
from meshfit.experiment.overview import Standing
from meshfit.experiment.store import FAILURE, RESULT, Result, read_json

CONFIG = "config.yaml"


def read_result(trial: Standing) -> Result | None:
    """The result of a trial; None if it is not complete.

    Raises:
        StoreError: it cannot be read.
    """
    return read_json(trial.path / RESULT) if trial.state is State.COMPLETE else None


def read_settings(trial: Standing, result: Result | None) -> dict[str, Any]:
    """The settings of a trial: those of its result, else those in its folder; none where it has not begun.

    Raises:
        StoreError: they cannot be read.
        ConfigError: they are no settings.
    """
    if result is not None:
        return dict(result.get("settings", {}))
    if CONFIG not in trial.folder.files:
        return {}
    path = trial.path / CONFIG
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError(f"{path}: cannot be read: {error}") from error
    return parse_document(text, str(path)).data


def ended(trial: Standing) -> datetime | None:
    """When a trial became complete or failed: as its record says, else when that was written; None if it has not."""
    for name in (RESULT, FAILURE):
        if name in trial.folder.files:
            path = trial.path / name
            with suppress(StoreError, KeyError, TypeError, ValueError):
                return datetime.fromisoformat(read_json(path)["finished"])
            return datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return None
