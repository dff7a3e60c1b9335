"""Copying of complete trials from other experiments of a run directory, so that no trial is run twice."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import (
    CHECKPOINT,
    FAILURE,
    LOG,
    PROGRESS,
    RESULT,
    RunDirectory,
    json_text,
    make_folder,
    now,
    read_result,
)
from meshfit.paths import write_error_message

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

_MESH = ".ply"


def find_complete(trials: Sequence["Trial"], store: RunDirectory) -> list[Path | None]:
    """Return the folder in which each trial is complete: its own, or that of the same trial of another experiment."""
    others = _experiments(store)
    return [store.folder(trial) if store.is_complete(trial) else _elsewhere(trial, others) for trial in trials]


def copy_complete(trials: Sequence["Trial"], store: RunDirectory) -> list[str]:
    """Copy trials that are complete in another experiment but not in their own, each with its result last.

    Returns:
        The name of the other experiment for each trial copied.

    Raises:
        StoreError: a file cannot be written.
    """
    names = []
    for trial, found in zip(trials, find_complete(trials, store), strict=True):
        if found is None or found == store.folder(trial):
            continue
        with store.lock(trial):
            if not store.is_complete(trial):
                _copy(trial, found, store)
                names.append(found.parents[2].name)
    return names


def _experiments(store: RunDirectory) -> list[Path]:
    try:
        return sorted(path for path in store.root.iterdir() if path.is_dir())
    except OSError:
        return []


def _elsewhere(trial: "Trial", experiments: Sequence[Path]) -> Path | None:
    within = trial.folder.relative_to(trial.experiment)
    for experiment in experiments:
        folder = experiment / within
        if experiment.name != trial.experiment and (folder / RESULT).is_file():
            try:
                result = read_result(folder)
            except StoreError:  # damaged
                continue
            if result is not None and result["identity"] == trial.identity:
                return folder
    return None


def _copy(trial: "Trial", source: Path, store: RunDirectory) -> None:
    result, folder = read_result(source), store.folder(trial)
    if result is None:
        return
    store.remove(trial, CHECKPOINT, FAILURE)
    try:
        for path in sorted(path for path in source.rglob("*") if path.is_file()):
            within = path.relative_to(source)
            if path.name not in (PROGRESS, RESULT) and not any(part.startswith(".") for part in within.parts):
                copy = folder / within
                make_folder(copy.parent)
                _link_or_copy(path, copy)
    except OSError as error:
        raise StoreError(f"{folder}: {write_error_message(folder, error)}") from error
    store.append(trial, LOG, f"{now()}  copied from {source}\n")
    store.write(trial, RESULT, json_text(result | {"experiment": trial.experiment, **trial.names}))


def _link_or_copy(path: Path, copy: Path) -> None:
    """Let a mesh be one file under two names where the file system can, as meshes are replaced but never changed."""
    copy.unlink(missing_ok=True)
    if path.suffix == _MESH:
        try:
            os.link(path, copy)
        except OSError:
            pass
        else:
            return
    shutil.copyfile(path, copy)
