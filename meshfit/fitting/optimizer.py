"""Gradients into steps, by torch's optimisers, and the learning rate at each step."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from math import cos, pi

import torch
from torch import Tensor
from torch.optim.adam import adam
from torch.optim.sgd import sgd

from meshfit.fitting.settings import OptimizerSettings, Schedule

OptimizerState = dict[str, Tensor]

_DECAYS: dict[str, Callable[[Schedule, int, int], float]] = {
    "constant": lambda schedule, step, steps: 1.0,  # noqa: ARG005  every decay is asked alike
    "cosine": lambda schedule, step, steps: (
        schedule.final + (1 - schedule.final) * (1 + cos(pi * step / max(steps, 1))) / 2
    ),
    "step": lambda schedule, step, steps: schedule.factor ** (step // schedule.every),  # noqa: ARG005  likewise
}


class Optimizer(ABC):
    """Moves a variable. What it remembers has a row for each row of the variable, or is one number for all.

    The functions of `torch.optim` are called, not its classes: those load torch's compiler, which takes longer than a
    hundred steps and as much memory as a fit.
    """

    def __init__(self, variable: Tensor, settings: OptimizerSettings) -> None:
        self._variable, self._momentum = variable, settings.momentum
        self._state = self._nothing_yet(torch.zeros_like(variable, requires_grad=False))

    @abstractmethod
    def _nothing_yet(self, zeros: Tensor) -> OptimizerState:
        """The state before the first step."""

    @abstractmethod
    def step(self, gradient: Tensor, lr: float) -> None:
        """Move the variable by one step."""

    def state_of(self, rows: slice) -> OptimizerState:
        """A copy of what is remembered of some rows."""
        return {name: (value[rows] if value.dim() else value).clone() for name, value in self._state.items()}

    def put(self, states: Sequence[OptimizerState]) -> None:
        """Remember what `state_of` copied, row after row; numbers for all rows have to be the same in all."""
        for name, value in self._state.items():
            parts = [state[name] for state in states]
            value.copy_(torch.cat(parts) if value.dim() else parts[0])


class Sgd(Optimizer):
    """Gradient descent with momentum."""

    def _nothing_yet(self, zeros: Tensor) -> OptimizerState:
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

    def _nothing_yet(self, zeros: Tensor) -> OptimizerState:
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
    """The learning rate of one of `steps` steps, counted from 0."""
    return settings.lr * _DECAYS[settings.schedule.name](settings.schedule, step, steps)
