"""What `result.json` says of a trial."""

import platform
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from meshfit.config.strict_yaml import parse_document
from meshfit.errors import StoreError
from meshfit.experiment.plan import SCHEMA_VERSION, Trial
from meshfit.experiment.status.scan import Standing, State
from meshfit.experiment.storage.run_directory import FAILURE, RESULT, Result, now, read_json
from meshfit.fitting.loop import FitResult
from meshfit.measuring.measure import Measurement
from meshfit.mesh.normalisation import Frame

_PACKAGES = ("meshfit", "torch", "numpy", "scipy", "trimesh", "pymeshlab", "pykdtree")


def result_of(trial: Trial, frame: Frame, fitted: FitResult, measured: Measurement, work: Result) -> Result:
    """The record of a complete trial; `work` is what it took."""
    last = fitted.trace.rows[-1] if fitted.trace.rows else ()
    return {
        "schema_version": SCHEMA_VERSION,
        "identity": trial.identity,
        "experiment": trial.experiment,
        **trial.names,
        **measured.to_dict(),
        "fit": {"steps": trial.settings.fit.steps, "device": fitted.device, "final_loss": last[1] if last else None},
        "frame": asdict(frame) | {"normalise": trial.settings.normalise},
        "inputs": dict(trial.inputs),
        "settings": trial.plain_settings,
        **work,
        "finished": now(),
        **_provenance(),
    }


def _provenance() -> Result:
    packages = {name: version(name) for name in _PACKAGES}
    machine: dict[str, Any] = {"system": platform.platform(), "machine": platform.machine(), "host": platform.node()}
    return {"versions": {"python": platform.python_version()} | packages, "platform": machine}


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
