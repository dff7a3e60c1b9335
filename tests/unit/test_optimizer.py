"""Optimisers against their recurrences by hand, learning rates at known steps, and the rate that the engine uses."""

from itertools import pairwise
from math import cos, pi, sqrt

import numpy as np
import pytest
import torch

from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.optimizer import Optimizer, learning_rate
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings, OptimizerSettings, Schedule
from meshfit.mesh.solids import cube, icosahedron
from meshfit.settings import build
from tests.loops import over

RATES = [0.3, 0.3, 0.1, 0.2, 0.05, 0.3]
GRADIENTS = np.random.default_rng(0).normal(size=(len(RATES), 4, 3))


def optimizer_of(variable, settings):
    return Optimizer(variable, settings)


def path_of(settings):
    """Where a variable goes under those gradients and rates."""
    variable = torch.zeros(4, 3, dtype=torch.float64, requires_grad=True)
    optimizer = optimizer_of(variable, settings)
    places = []
    for rate, gradient in zip(RATES, GRADIENTS, strict=True):
        optimizer.step(torch.tensor(gradient), rate)
        places.append(variable.detach().numpy().copy())
    return np.array(places)


@pytest.mark.parametrize("momentum", [0.0, 0.5, 0.9])
def test_sgd_follows_its_recurrence(momentum):
    place, velocity, places = 0, 0, []
    for rate, gradient in zip(RATES, GRADIENTS, strict=True):
        velocity = momentum * velocity + gradient
        place = place - rate * velocity
        places.append(place)
    np.testing.assert_allclose(path_of(OptimizerSettings(momentum=momentum)), places, rtol=1e-12)


@pytest.mark.parametrize("beta", [0.5, 0.9])
def test_adam_follows_its_recurrence(beta):
    place, first, second, places = 0, 0, 0, []
    for count, (rate, gradient) in enumerate(zip(RATES, GRADIENTS, strict=True), start=1):
        first = beta * first + (1 - beta) * gradient
        second = 0.999 * second + 0.001 * gradient**2
        size = np.sqrt(second / (1 - 0.999**count)) + 1e-8
        place = place - rate * first / (1 - beta**count) / size
        places.append(place)
    np.testing.assert_allclose(path_of(OptimizerSettings(name="adam", momentum=beta)), places, rtol=1e-9)


@pytest.mark.parametrize("settings", [{}, {"momentum": 0}, {"name": "adam"}], ids=["sgd", "no momentum", "adam"])
@over("steps", [0, 3])
def test_the_state_of_some_rows_is_put_back_among_the_rows_of_others(settings, steps):
    """Rows 2, 3 and then 0, 1 of one variable go on as rows 0 to 3 of another, which so far saw none of them."""

    def moved(variable, optimizer, gradients):
        for gradient in gradients:
            optimizer.step(torch.tensor(gradient), 0.1)
        return variable.detach()

    made = [torch.zeros(4, 3, dtype=torch.float64, requires_grad=True) for _ in range(2)]
    (whole, first), (other, second) = ((v, optimizer_of(v, OptimizerSettings(**settings))) for v in made)
    before = moved(whole, first, GRADIENTS[:steps]).clone()
    states = [first.state_of(slice(2, 4)), first.state_of(slice(0, 2))]
    with torch.no_grad():
        other.copy_(before.roll(2, 0))
    second.restore(states)
    expected = moved(whole, first, GRADIENTS[steps:])
    assert torch.equal(moved(other, second, np.roll(GRADIENTS[steps:], 2, axis=1)), expected.roll(2, 0))


def rates(steps, at, **schedule):
    settings = OptimizerSettings(lr=2.0, schedule=Schedule(**schedule))
    return [learning_rate(settings, step, steps) for step in at]


def test_the_constant_schedule_keeps_the_rate():
    assert rates(100, [0, 1, 50, 99]) == [2.0] * 4


def test_the_cosine_schedule_falls_from_the_rate_to_its_final_fraction():
    assert rates(100, [0, 50, 100], name="cosine") == pytest.approx([2, 1, 0], abs=1e-15)
    assert rates(100, [0, 50, 100], name="cosine", final=0.5) == pytest.approx([2, 1.5, 1])
    assert rates(100, [25], name="cosine") == pytest.approx([1 + sqrt(0.5)])
    falling = rates(100, range(100), name="cosine", final=0.1)
    assert all(later < earlier for earlier, later in pairwise(falling))
    assert falling[-1] > 0.2


def test_the_step_schedule_multiplies_after_every_so_many_steps():
    assert rates(9, range(9), name="step", every=3, factor=0.5) == [2, 2, 2, 1, 1, 1, 0.5, 0.5, 0.5]


@pytest.mark.parametrize("schedule", [{}, {"name": "cosine", "final": 0.2}, {"name": "step", "every": 2}])
def test_the_engine_uses_the_rate_that_its_trace_tells(schedule):
    """Without momentum and with the edge term alone, a step is the rate times that term's gradient."""
    settings = build(
        FirstOrderSettings,
        {
            "steps": 7,
            "samples": 5,
            "trace_every": 1,
            "optimizer": {"lr": 0.3, "momentum": 0, "schedule": schedule},
            "losses": {"chamfer": 0, "laplacian": 0, "consistency": 0},
        },
    )
    source = icosahedron()
    engine = FirstOrder([Problem(source, cube())], settings, torch.device("cpu"), torch.float64)
    ends = np.array(sorted({tuple(sorted((f[k], f[k - 1]))) for f in source.faces.tolist() for k in range(3)}))
    for step in range(7):
        before = engine.mesh(0).verts
        engine.step()
        gradient = np.zeros_like(before)
        along = 2 * (before[ends[:, 0]] - before[ends[:, 1]]) / len(ends)
        np.add.at(gradient, ends[:, 0], along)
        np.add.at(gradient, ends[:, 1], -along)
        used = -((engine.mesh(0).verts - before) * gradient).sum() / (gradient**2).sum()
        assert used == pytest.approx(engine.traces[0].rows[step][-1], rel=1e-9)
    decay = {"cosine": lambda k: 0.2 + 0.8 * (1 + cos(pi * k / 7)) / 2, "step": lambda k: 0.5 ** (k // 2)}
    factor = decay.get(schedule.get("name"), lambda _: 1)
    assert [row[-1] for row in engine.traces[0].rows] == pytest.approx([0.3 * factor(k) for k in range(7)])
