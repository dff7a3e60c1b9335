"""Checkpoints and snapshots of a fit, in the folder of its trial."""

import hashlib
import io
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import CHECKPOINT, RunDirectory, make_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.fitting.problem import Checkpoint

SNAPSHOTS = "snapshots"
_IDENTITY, _ENGINE, _DIGEST = "identity", "engine", "sha256"
_SNAPSHOT = re.compile(r"step-(\d+)\.ply")


def write_checkpoint(trial: "Trial", store: RunDirectory, checkpoint: "Checkpoint") -> None:
    """Write a checkpoint in place of the previous one, with the identity of its trial and a digest of its content.

    Raises:
        StoreError: it cannot be written.
    """
    import torch

    content = checkpoint | {_IDENTITY: trial.identity, _ENGINE: trial.settings.fit.method}
    buffer = io.BytesIO()
    torch.save(content | {_DIGEST: _digest(content)}, buffer)
    store.write(trial, CHECKPOINT, buffer.getvalue())


def read_checkpoint(trial: "Trial", store: RunDirectory) -> "Checkpoint | None":
    """Read the checkpoint of a trial; None where there is none.

    Raises:
        StoreError: it is damaged, or that of another trial or engine.
    """
    import torch

    path = store.folder(trial) / CHECKPOINT
    if not path.is_file():
        return None
    try:
        # weights_only: a checkpoint holds tensors and numbers, and nothing in it is ever executed.
        content = torch.load(path, map_location="cpu", weights_only=True)
        found = content.pop(_DIGEST)
        is_whole = found == _digest(content)
    except Exception:  # noqa: BLE001  a damaged file makes torch raise anything
        is_whole = False
    if not is_whole:
        raise StoreError(f"{CHECKPOINT} is damaged, or of another version of meshfit")
    if content.pop(_IDENTITY) != trial.identity:
        raise StoreError(f"{CHECKPOINT} is that of another trial")
    if (engine := content.pop(_ENGINE)) != trial.settings.fit.method:
        raise StoreError(f"{CHECKPOINT} is that of engine {engine}")
    checkpoint: Checkpoint = content
    return checkpoint


def _digest(content: object) -> str:
    """Return the SHA-256 of nested dicts and sequences of tensors and plain values."""
    digest = hashlib.sha256()

    def update(value: Any) -> None:  # noqa: ANN401  whatever a checkpoint holds
        if isinstance(value, dict):
            digest.update(f"dict {len(value)} ".encode())
            for key, entry in value.items():
                update(key)
                update(entry)
        elif isinstance(value, list | tuple):
            digest.update(f"sequence {len(value)} ".encode())
            for entry in value:
                update(entry)
        elif hasattr(value, "untyped_storage"):
            array = value.detach().cpu().contiguous().numpy()
            digest.update(f"tensor {array.dtype} {array.shape} ".encode())
            digest.update(array.tobytes())
        else:
            digest.update(f"{type(value).__name__} {value!r} ".encode())

    update(content)
    return digest.hexdigest()


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
    return dict(sorted((int(match[1]), path) for path, match in matches.items() if match and path.is_file()))


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
