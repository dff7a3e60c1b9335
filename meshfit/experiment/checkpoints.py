"""Checkpoints of a trial, in a file of its folder."""

import io

import torch

from meshfit.experiment.plan import Trial
from meshfit.experiment.store import CHECKPOINT, RunDirectory
from meshfit.fitting.problem import Checkpoint


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
