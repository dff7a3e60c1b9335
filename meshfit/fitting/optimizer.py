"""The optimisers of torch, and the learning rate at each step."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import cos, pi

import torch
from torch import Tensor
from torch.optim.adam import adam
from torch.optim.sgd import sgd

from meshfit.fitting.settings import OptimizerSettings

OptimizerState = dict[str, Tensor]


class Optimizer(ABC):
    """Moves a variable. Each tensor of its state has one row per row of the variable, or is one number for all.

    It calls the functions of `torch.optim`, not the classes: those load torch's compiler, which takes longer than a
    hundred steps and as much memory as a fit.
    """

    def __init__(self, variable: Tensor, settings: OptimizerSettings) -> None:
        self._variable, self._momentum = variable, settings.momentum
        self._state = self._initial_state(torch.zeros_like(variable, requires_grad=False))

    @abstractmethod
    def _initial_state(self, zeros: Tensor) -> OptimizerState:
        """Return the state before the first step."""

    @abstractmethod
    def step(self, gradient: Tensor, lr: float) -> None:
        """Move the variable by one step."""

    def state_of(self, rows: slice) -> OptimizerState:
        """Return a copy of the state of some rows."""
        return {name: (value[rows] if value.dim() else value).clone() for name, value in self._state.items()}

    def put(self, states: Sequence[OptimizerState]) -> None:
        """Restore states from `state_of`, in the order of the rows; numbers for all rows must agree."""
        for name, value in self._state.items():
            parts = [state[name] for state in states]
            value.copy_(torch.cat(parts) if value.dim() else parts[0])


class Sgd(Optimizer):
    """Gradient descent with momentum."""

    def _initial_state(self, zeros: Tensor) -> OptimizerState:
        return {"velocity": zeros}

    @torch.no_grad()
    def step(self, gradient: Tensor, lr: float) -> None:
        """Move the variable by one step."""
        sgd(
            [self._variable],
            [gradient],
            [self._state["velocity"]],
            lr=lr,
            momentum=self._momentum,
            dampening=0,
            weight_decay=0,
            nesterov=False,
            maximize=False,
            foreach=False,
        )


class Adam(Optimizer):
    """Adam (Kingma and Ba 2015); the momentum is its first beta."""

    def _initial_state(self, zeros: Tensor) -> OptimizerState:
        return {"mean": zeros, "square": zeros.clone(), "steps": torch.tensor(0.0)}

    @torch.no_grad()
    def step(self, gradient: Tensor, lr: float) -> None:
        """Move the variable by one step."""
        adam(
            [self._variable],
            [gradient],
            [self._state["mean"]],
            [self._state["square"]],
            [],
            [self._state["steps"]],
            lr=lr,
            beta1=self._momentum,
            beta2=0.999,
            eps=1e-8,
            weight_decay=0,
            amsgrad=False,
            maximize=False,
            foreach=False,
        )


OPTIMIZERS: dict[str, type[Optimizer]] = {"sgd": Sgd, "adam": Adam}


def learning_rate(settings: OptimizerSettings, step: int, steps: int) -> float:
    """Return the learning rate of one of `steps` steps, counted from 0."""
    schedule = settings.schedule
    if schedule.name == "cosine":
        return settings.lr * (schedule.final + (1 - schedule.final) * (1 + cos(pi * step / max(steps, 1))) / 2)
    return settings.lr * (schedule.factor ** (step // schedule.every) if schedule.name == "step" else 1.0)
