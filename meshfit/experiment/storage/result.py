"""`result.json`: measurements, settings and provenance of a complete trial."""

import os
import platform
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshfit.config.strict_yaml import parse_document
from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.storage.measurement import with_measurement
from meshfit.experiment.storage.run_directory import CONFIG, FAILURE, RESULT, Result, now, read_json, read_result
from meshfit.units import count_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.fitting.loop import FitResult
    from meshfit.measuring.measure import Measurement

_PACKAGES = ("meshfit", "torch", "numpy", "scipy", "pymeshlab", "pykdtree")


def result_record(trial: "Trial", frame: Result, fitted: "FitResult", measured: "Measurement", work: Result) -> Result:
    """Return the record of a complete trial; `frame` is that of `frame_record`, `work` holds time, memory, warnings."""
    last = fitted.trace.rows[-1] if fitted.trace.rows else ()
    tool = {} if fitted.tool is None else {"tool": fitted.tool.to_dict()}
    registered = {} if fitted.registered is None else {"register": asdict(fitted.registered)}
    supported = {} if fitted.supported is None else {"supported": fitted.supported}
    return {
        "schema_version": RESULTS_VERSION,
        "identity": trial.identity,
        "experiment": trial.experiment,
        **trial.names,
        **measured.to_dict(),
        "fit": {"steps": trial.settings.fit.steps, "device": fitted.device, "final_loss": last[1] if last else None},
        **tool,
        **supported,
        **registered,
        "frame": frame,
        "inputs": dict(trial.inputs),
        "settings": trial.plain_settings,
        **work,
        "finished": now(),
        **_provenance(),
    }


def _provenance() -> Result:
    machine: dict[str, Any] = {"system": platform.platform(), "machine": platform.machine(), "host": platform.node()}
    return {"versions": {"python": platform.python_version()} | package_versions(), "platform": machine}


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of the packages on which numbers depend."""
    return {name: version(name) for name in _PACKAGES}


def read_settings(folder: Path, result: Result | None) -> dict[str, Any]:
    """Read the settings of a trial, from its result if there is one, else from its folder; empty if it has not begun.

    Raises:
        StoreError: they cannot be read.
        ConfigError: they are not valid settings.
    """
    if result is not None:
        return dict(result.get("settings", {}))
    path = folder / CONFIG
    if not path.is_file():
        return {}
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError(f"{path}: cannot be read: {error}") from error
    return parse_document(text, str(path)).data


def end_time(folder: Path) -> datetime | None:
    """Return the time at which a trial became complete or failed; None if it has done neither.

    It is the recorded time; failing that, the time at which the record was written.
    """
    for path in (folder / RESULT, folder / FAILURE):
        if path.is_file():
            with suppress(StoreError, KeyError, TypeError, ValueError):
                return datetime.fromisoformat(read_json(path)["finished"])
            return datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return None


def read_results(roots: Iterable[Path], *, required: bool = True) -> list[Result]:
    """Read every result under some run directories, or under folders of them, in the order of their paths.

    Damaged results are left out with a warning.

    Raises:
        StoreError: no such directory, or no complete trial in any of them where one is required.
    """
    paths: list[Path] = []
    for root in roots:
        if not root.exists():
            raise StoreError(f"{root}: no such run directory; `meshfit run` makes one")
        paths += _results_below(root)
    results = [result for path in dict.fromkeys(paths) if (result := read_result_or_warn(path.parent)) is not None]
    if not results and required:
        damaged = f"; damaged: {count_text(len(paths), 'result')}" if paths else ""
        raise StoreError(f"no complete trial under {', '.join(map(str, roots))}; `meshfit run` makes them{damaged}")
    return results


def read_result_or_warn(folder: Path) -> Result | None:
    """Read the result of the trial in a folder, with its `folder`, and the values of a later measurement if it has one.

    Returns:
        The result; None, with a warning, if it is damaged, or if there is none.
    """
    try:
        result = read_result(folder)
    except StoreError as error:
        warnings.warn(f"left out: {error}", MeshfitWarning, stacklevel=2)
        return None
    if result is None:
        return None
    try:
        result = with_measurement(folder, result)
    except StoreError as error:
        warnings.warn(f"{error}; values of the fit are used", MeshfitWarning, stacklevel=2)
    return result | {"folder": str(folder)}


def _results_below(folder: Path) -> Iterator[Path]:
    """Every result at any depth, in the order of their paths; links to folders are not followed."""
    try:
        with os.scandir(folder) as scanned:
            entries = sorted(scanned, key=lambda entry: entry.name)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _results_below(Path(entry))
        elif entry.name == RESULT:
            yield Path(entry)
