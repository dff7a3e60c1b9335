"""The optimisers of torch, and the learning rate at each step."""

from collections.abc import Sequence
from math import cos, pi
from typing import Any

import torch
from torch import Tensor
from torch.optim.adam import adam
from torch.optim.sgd import sgd

from meshfit.fitting.settings import OptimizerSettings

OptimizerState = dict[str, Tensor]

# Features of torch's optimisers that are not used.
_OFF: dict[str, Any] = {"weight_decay": 0, "maximize": False, "foreach": False}


class Optimizer:
    """Gradient descent with momentum, or Adam (Kingma and Ba 2015) with the momentum as its first beta.

    Each tensor of the state has one row per row of the variable, or is one number for all. The functions of
    `torch.optim` are called, not its classes: those load torch's compiler, which takes longer than a hundred steps and
    as much memory as a fit.
    """

    def __init__(self, variable: Tensor, settings: OptimizerSettings) -> None:
        self._variable, self._settings = variable, settings
        zeros = torch.zeros_like(variable, requires_grad=False)
        self._state: OptimizerState = {"velocity": zeros}
        if settings.name == "adam":
            self._state = {"mean": zeros, "square": zeros.clone(), "steps": torch.tensor(0.0)}

    @torch.no_grad()
    def step(self, gradient: Tensor, lr: float) -> None:
        """Move the variable by one step."""
        variable, momentum = [self._variable], self._settings.momentum
        if self._settings.name == "sgd":
            velocity: list[Tensor | None] = [self._state["velocity"]]
            sgd(variable, [gradient], velocity, lr=lr, momentum=momentum, dampening=0, nesterov=False, **_OFF)
            return
        means, squares, steps = ([self._state[name]] for name in ("mean", "square", "steps"))
        rates: dict[str, Any] = {"lr": lr, "beta1": momentum, "beta2": 0.999, "eps": 1e-8}
        adam(variable, [gradient], means, squares, [], steps, amsgrad=False, **rates, **_OFF)

    def state_of(self, rows: slice) -> OptimizerState:
        """Return a copy of the state of some rows."""
        return {name: (value[rows] if value.dim() else value).clone() for name, value in self._state.items()}

    def restore(self, states: Sequence[OptimizerState]) -> None:
        """Restore states from `state_of`, in the order of the rows; numbers for all rows must agree."""
        for name, value in self._state.items():
            parts = [state[name] for state in states]
            value.copy_(torch.cat(parts) if value.dim() else parts[0])


def learning_rate(settings: OptimizerSettings, step: int, steps: int) -> float:
    """Return the learning rate of one of `steps` steps, counted from 0."""
    schedule = settings.schedule
    if schedule.name == "cosine":
        return settings.lr * (schedule.final + (1 - schedule.final) * (1 + cos(pi * step / max(steps, 1))) / 2)
    return settings.lr * (schedule.factor ** (step // schedule.every) if schedule.name == "step" else 1.0)
