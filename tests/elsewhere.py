"""Another device, pretended on the CPU, so that code for other devices runs here on real numbers."""

from functools import partial

import pytest
import torch


class _Elsewhere(str):
    """Taken by torch for the CPU's name, and by others for a device that is not the CPU."""

    type = "elsewhere"
    __slots__ = ()


def pretend_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let all tensors say that they are not on the CPU."""
    monkeypatch.setattr(torch.Tensor, "device", property(lambda _: _Elsewhere("cpu")))


def make_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let tensors from data be made on the CPU, whatever device is asked for."""
    for name in ("tensor", "as_tensor"):
        monkeypatch.setattr(torch, name, partial(_on_cpu, getattr(torch, name)))


def _on_cpu(make, data, device=None, **options):
    return make(data, **options)
