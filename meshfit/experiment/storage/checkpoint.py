"""Checkpoints of a trial, in a file of its folder."""

import io
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from meshfit.experiment.plan import Trial
from meshfit.experiment.storage.run_directory import CHECKPOINT, RunDirectory, make_folder
from meshfit.fitting.problem import Checkpoint

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial


def write_checkpoint(trial: Trial, store: RunDirectory, checkpoint: Checkpoint) -> None:
    """Write a checkpoint in place of the one before.

    Raises:
        StoreError: it cannot be written.
    """
    buffer = io.BytesIO()
    torch.save(checkpoint, buffer)
    store.write(trial, CHECKPOINT, buffer.getvalue())


def read_checkpoint(trial: Trial, store: RunDirectory) -> Checkpoint | None:
    """The trial's checkpoint; None where there is none, or none that can be read."""
    path = store.folder(trial) / CHECKPOINT
    if not path.is_file():
        return None
    try:
        # weights_only: a checkpoint holds tensors and numbers, and nothing in it is ever executed.
        checkpoint: Checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # noqa: BLE001  a damaged file makes torch raise anything; the trial then starts over
        return None
    return checkpoint


SNAPSHOTS = "snapshots"
_NAME = re.compile(r"step-(\d+)\.ply")


def snapshots_in(folder: Path) -> dict[int, Path]:
    """The snapshots in a trial's folder, by the number of steps that had been made, in their order."""
    if not (folder / SNAPSHOTS).is_dir():
        return {}
    found = {path: _NAME.fullmatch(path.name) for path in (folder / SNAPSHOTS).iterdir()}
    return dict(sorted((int(match[1]), path) for path, match in found.items() if match))


def write_snapshot(trial: "Trial", store: RunDirectory, step: int, content: bytes) -> None:
    """Write a snapshot, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    make_folder(store.folder(trial) / SNAPSHOTS)
    store.write(trial, f"{SNAPSHOTS}/step-{step:06d}.ply", content)


def steps_before(trial: "Trial", done: int) -> range:
    """After which of so many steps a snapshot is taken."""
    every = trial.settings.fit.snapshots
    return range(0) if every is None else range(every, done + 1, every)


def keep_snapshots(trial: "Trial", store: RunDirectory, steps: Collection[int]) -> bool:
    """Remove what an attempt would not have that got there undisturbed; whether nothing of that is missing."""
    folder = store.folder(trial)
    found = snapshots_in(folder)
    wanted = {path for step, path in found.items() if step in steps}
    if (folder / SNAPSHOTS).is_dir():
        for path in set((folder / SNAPSHOTS).iterdir()) - wanted:
            path.unlink()
        if not wanted:
            (folder / SNAPSHOTS).rmdir()
    return len(wanted) == len(steps)
