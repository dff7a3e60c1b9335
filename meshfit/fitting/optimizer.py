"""From settings to torch's optimisers, and the learning rate at each step."""

from collections.abc import Callable
from math import cos, pi

import torch
from torch import Tensor

from meshfit.fitting.settings import OptimizerSettings, Schedule

_DECAYS: dict[str, Callable[[Schedule, int, int], float]] = {
    "constant": lambda schedule, step, steps: 1.0,  # noqa: ARG005  every decay is asked alike
    "cosine": lambda schedule, step, steps: (
        schedule.final + (1 - schedule.final) * (1 + cos(pi * step / max(steps, 1))) / 2
    ),
    "step": lambda schedule, step, steps: schedule.factor ** (step // schedule.every),  # noqa: ARG005  likewise
}


def make_optimizer(variable: Tensor, settings: OptimizerSettings) -> torch.optim.Optimizer:
    """The optimiser of one variable."""
    if settings.name == "sgd":
        return torch.optim.SGD([variable], lr=settings.lr, momentum=settings.momentum)
    return torch.optim.Adam([variable], lr=settings.lr, betas=(settings.momentum, 0.999))


def learning_rate(settings: OptimizerSettings, step: int, steps: int) -> float:
    """The learning rate of one of `steps` steps, counted from 0."""
    return settings.lr * _DECAYS[settings.schedule.name](settings.schedule, step, steps)
