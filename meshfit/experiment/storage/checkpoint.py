"""Checkpoints and snapshots of a fit, in the folder of its trial."""

import io
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from meshfit.experiment.storage.run_directory import CHECKPOINT, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.fitting.problem import Checkpoint

SNAPSHOTS = "snapshots"
_SNAPSHOT = re.compile(r"step-(\d+)\.ply")


def write_checkpoint(trial: "Trial", store: RunDirectory, checkpoint: "Checkpoint") -> None:
    """Write a checkpoint in place of the previous one.

    Raises:
        StoreError: it cannot be written.
    """
    import torch

    buffer = io.BytesIO()
    torch.save(checkpoint, buffer)
    store.write(trial, CHECKPOINT, buffer.getvalue())


def read_checkpoint(trial: "Trial", store: RunDirectory) -> "Checkpoint | None":
    """Read the checkpoint of a trial; None where there is none, or none that can be read."""
    import torch

    path = store.folder(trial) / CHECKPOINT
    if not path.is_file():
        return None
    try:
        # weights_only: a checkpoint holds tensors and numbers, and nothing in it is ever executed.
        checkpoint: Checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # noqa: BLE001  a damaged file makes torch raise anything; the trial then starts over
        return None
    return checkpoint


def write_snapshot(trial: "Trial", store: RunDirectory, step: int, content: bytes) -> None:
    """Write a snapshot, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    make_folder(store.folder(trial) / SNAPSHOTS)
    store.write(trial, f"{SNAPSHOTS}/step-{step:06d}.ply", content)


def snapshots_in(folder: Path) -> dict[int, Path]:
    """The snapshots in the folder of a trial by the number of steps done, in ascending order."""
    if not (folder / SNAPSHOTS).is_dir():
        return {}
    matches = {path: _SNAPSHOT.fullmatch(path.name) for path in (folder / SNAPSHOTS).iterdir()}
    return dict(sorted((int(match[1]), path) for path, match in matches.items() if match))


def snapshot_steps(trial: "Trial", done: int) -> range:
    """The steps, among the first `done`, after which a snapshot is taken."""
    interval = trial.settings.fit.snapshots
    return range(0) if interval is None else range(interval, done + 1, interval)


def keep_snapshots(trial: "Trial", store: RunDirectory, steps: Collection[int]) -> bool:
    """Remove all snapshots but those of the given steps, and half-written ones; return whether none is missing."""
    folder = store.folder(trial) / SNAPSHOTS
    kept = {path for step, path in snapshots_in(folder.parent).items() if step in steps}
    if folder.is_dir():
        for path in set(folder.iterdir()) - kept:
            path.unlink()
        if not kept:
            folder.rmdir()
    return len(kept) == len(steps)
