"""Checkpoints as stored in a run directory."""

import io

import torch


def through_a_file(checkpoint):
    """A checkpoint as it is once it has been written and read."""
    buffer = io.BytesIO()
    torch.save(checkpoint, buffer)
    buffer.seek(0)
    return torch.load(buffer, weights_only=True)
