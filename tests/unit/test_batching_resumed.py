"""Interrupted batches: all problems are saved, and end at the same bytes in any batch in which they are resumed."""

from functools import cache

import pytest

from meshfit.fitting import batch as fitting
from meshfit.fitting import loop as running
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.problem import Problem
from tests.checkpoints import through_a_file
from tests.ragged import LATE, PROBLEMS, SHAKY, alone, bytes_of

pytestmark = pytest.mark.usefixtures("without_shape_checks", "one_batch")
QUICK = {"samples": 40, "trace_every": 2, "device": "cpu"}


@pytest.fixture
def one_batch(monkeypatch):
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1e18)


def stopping_at(stop):
    def on_step(step):
        if step.done == stop:
            raise Interrupted

    return on_step


def with_callbacks(problem, on_step=None, resume=None, save=None):
    return Problem(problem.source, problem.target, problem.seed, on_step, resume, save)


OPTIMIZERS = {"sgd": {"name": "sgd", "lr": 0.4}, "adam": {"name": "adam", "lr": 0.02}}


def options(optimizer, dtype):
    return QUICK | {"steps": 8, "optimizer": OPTIMIZERS[optimizer], "dtype": dtype}


@cache
def uninterrupted(optimizer, dtype="float32"):
    return [bytes_of(alone(problem, **options(optimizer, dtype))) for problem in PROBLEMS]


def together(problems, optimizer, dtype="float32"):
    return [bytes_of(outcome) for outcome in fit_batch(problems, **options(optimizer, dtype))]


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_problems_that_were_stopped_at_different_steps_go_on_together(optimizer, dtype):
    begun = []
    for problem, stop in zip(PROBLEMS, [3, 0, 3, 5, 0, 8, 3], strict=True):
        saved = []
        if stop:
            with pytest.raises(Interrupted):
                alone(with_callbacks(problem, stopping_at(stop), save=saved.append), **options(optimizer, dtype))
        begun.append(with_callbacks(problem, resume=through_a_file(saved[0]) if saved else None))
    assert together(begun, optimizer, dtype) == uninterrupted(optimizer, dtype)
    assert together(begun[::-1], optimizer, dtype) == uninterrupted(optimizer, dtype)[::-1]


@pytest.mark.parametrize(("optimizer", "interrupting"), [("sgd", 0), ("adam", 3), ("sgd", 6)])
def test_an_interruption_by_one_saves_all(optimizer, interrupting):
    saved = [[] for _ in PROBLEMS]
    problems = [
        with_callbacks(problem, stopping_at(5) if i == interrupting else None, save=saved[i].append)
        for i, problem in enumerate(PROBLEMS)
    ]
    with pytest.raises(Interrupted):
        together(problems, optimizer)
    assert [[checkpoint["done"] for checkpoint in own] for own in saved] == [[5]] * 7
    begun = [with_callbacks(p, resume=through_a_file(own[0])) for p, own in zip(PROBLEMS, saved, strict=True)]
    assert together(begun, optimizer) == uninterrupted(optimizer)


def test_one_that_has_diverged_is_neither_told_of_steps_nor_saved():
    steps, saved = {place: [] for place in range(3)}, {place: [] for place in range(3)}
    problems = [
        with_callbacks(problem, steps[i].append if i < 2 else stopping_at(12), save=saved[i].append)
        for i, problem in enumerate([PROBLEMS[0], LATE[0], PROBLEMS[6]])
    ]
    with pytest.raises(Interrupted):
        fit_batch(problems, **QUICK, **SHAKY)
    assert [step.done for step in steps[0]] == list(range(1, 13))
    assert [step.done for step in steps[1]] == list(range(1, alone(LATE[0], **QUICK, **SHAKY).step))
    assert [len(saved[place]) for place in range(3)] == [1, 0, 1]


def test_every_problem_is_saved_each_time_the_interval_is_over(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(running.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(running, "SECONDS_BETWEEN_CHECKPOINTS", 2.5)
    saved = [[] for _ in range(3)]
    fit_batch([with_callbacks(PROBLEMS[i], save=saved[i].append) for i in range(3)], steps=8, **QUICK)
    assert [[checkpoint["done"] for checkpoint in own] for own in saved] == [[3, 6]] * 3


def test_an_interruption_in_a_later_pack_leaves_checkpoints_of_the_ends_of_earlier_ones(monkeypatch):
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1.0)
    saved = [[] for _ in range(3)]
    problems = [with_callbacks(PROBLEMS[i], stopping_at(5) if i == 1 else None, save=saved[i].append) for i in range(3)]
    with pytest.raises(Interrupted):
        fit_batch(problems, **options("sgd", "float32"))
    assert [[checkpoint["done"] for checkpoint in own] for own in saved] == [[8], [5], []]
    begun = [
        with_callbacks(problem, resume=through_a_file(own[0]) if own else None)
        for problem, own in zip(PROBLEMS, saved, strict=False)
    ]
    assert together(begun, "sgd") == uninterrupted("sgd")[:3]
