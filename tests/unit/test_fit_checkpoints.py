"""Checkpoints: an interrupted fit that is resumed ends at the same bytes."""

import numpy as np
import pytest
import torch

from meshfit.fitting import loop as running
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.loop import run
from meshfit.fitting.problem import Diverged, Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.solids import cube
from meshfit.settings import build
from tests.checkpoints import through_a_file
from tests.fits import fit
from tests.loops import over
from tests.shapes import mixed_closed

STEPS = 8
OPTIMIZERS = {
    "sgd": {"name": "sgd", "lr": 0.5},
    "sgd, no momentum": {"name": "sgd", "momentum": 0.0},
    "adam": {"name": "adam", "lr": 0.01},
    "sgd, cosine": {"name": "sgd", "schedule": {"name": "cosine", "final": 0.1}},
    "adam, step": {"name": "adam", "lr": 0.02, "schedule": {"name": "step", "every": 3}},
}
SETTINGS = {
    name: build(FirstOrderSettings, {"steps": STEPS, "samples": 40, "trace_every": 4, "optimizer": optimizer})
    for name, optimizer in OPTIMIZERS.items()
}
EACH = pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)


def engine(settings, dtype=torch.float32, on_step=None):
    return FirstOrder([Problem(mixed_closed(), cube(), 9, on_step)], settings, torch.device("cpu"), dtype)


def outcome(result):
    return result.mesh.verts.tobytes(), result.trace.to_csv()


def outcome_of(engine):
    (result,) = run(engine).values()
    return outcome(result)


def uninterrupted(settings, dtype=torch.float32):
    return outcome_of(engine(settings, dtype))


@EACH
@over("dtype", [torch.float32, torch.float64])
def test_restored_after_any_step_it_ends_at_the_same_bytes(settings, dtype):
    expected, moving = uninterrupted(settings, dtype), engine(settings, dtype)
    for done in range(STEPS + 1):
        resumed = engine(settings, dtype)
        resumed.restore([through_a_file(moving.checkpoint(0))])
        assert resumed.done == done
        assert outcome_of(resumed) == expected, f"after step {done}"
        if done < STEPS:
            moving.step()


@EACH
def test_a_checkpoint_that_is_held_does_not_change_as_the_fit_goes_on(settings):
    moving = engine(settings)
    for _ in range(3):
        moving.step()
    held = moving.checkpoint(0)
    expected = outcome_of(moving)
    for _ in range(2):  # nor is it used up by the first that goes on from it
        resumed = engine(settings)
        resumed.restore([held])
        assert outcome_of(resumed) == expected


@EACH
@over("stop", [1, 5, STEPS])
def test_a_fit_that_is_interrupted_saves_and_goes_on_from_there(settings, stop):
    saved, seen = [], []

    def interrupt(step):
        seen.append(step.done)
        if step.done == stop:
            raise Interrupted

    options = {"seed": 9, "device": "cpu"}
    with pytest.raises(Interrupted):
        fit(mixed_closed(), cube(), settings, on_step=interrupt, save=saved.append, **options)
    assert [checkpoint["done"] for checkpoint in saved] == [stop]
    result = fit(
        mixed_closed(),
        cube(),
        settings,
        resume=through_a_file(saved[0]),
        on_step=lambda step: seen.append(step.done),
        **options,
    )
    assert outcome(result) == uninterrupted(settings)
    assert seen == list(range(1, STEPS + 1))


def test_an_interruption_without_a_place_to_save_to_is_let_through():
    def interrupt(step):
        raise Interrupted

    with pytest.raises(Interrupted):
        fit(mixed_closed(), cube(), SETTINGS["sgd"], on_step=interrupt, device="cpu")


def test_a_finished_fit_has_no_step_left():
    finished = engine(SETTINGS["adam"])
    expected = outcome_of(finished)
    resumed = engine(SETTINGS["adam"], on_step=pytest.fail)
    resumed.restore([through_a_file(finished.checkpoint(0))])
    assert outcome_of(resumed) == expected


def test_a_checkpoint_is_saved_each_time_the_interval_is_over(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(running.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(running, "SECONDS_BETWEEN_CHECKPOINTS", 2.5)
    saved = []
    fit(mixed_closed(), cube(), SETTINGS["sgd"], seed=9, save=saved.append, device="cpu")
    assert [checkpoint["done"] for checkpoint in saved] == [3, 6]
    for checkpoint in saved:
        result = fit(mixed_closed(), cube(), SETTINGS["sgd"], seed=9, resume=checkpoint, device="cpu")
        assert outcome(result) == uninterrupted(SETTINGS["sgd"])


def test_quick_fits_save_nothing():
    fit(mixed_closed(), cube(), SETTINGS["sgd"], save=pytest.fail, device="cpu")


def test_a_fit_that_diverges_right_after_it_went_on_has_the_last_good_mesh_of_one_that_was_not_stopped():
    settings = build(FirstOrderSettings, {"steps": 9, "samples": 40, "optimizer": {"lr": 3e4}})
    moving, checkpoints = engine(settings), []
    while not moving.failed:
        moving.step()
        checkpoints.append(moving.checkpoint(0))
    whole = moving.failed[0]
    assert (whole.step, whole.term) == (len(checkpoints), "vertex position")
    for checkpoint in checkpoints[-2:]:  # the last from before, and one of the very positions that are out of range
        resumed = engine(settings)
        resumed.restore([through_a_file(checkpoint)])
        (parts,) = run(resumed).values()
        assert isinstance(parts, Diverged)
        np.testing.assert_array_equal(parts.last_good.verts, whole.last_good.verts)
        assert str(parts) == str(whole)
        assert parts.trace == whole.trace
