"""Batches with diverging problems: these stop, each at its own step, without effect on the others."""

import pytest
import torch

from meshfit.fitting import batch as fitting
from meshfit.fitting import first_order
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.problem import Diverged
from tests.loops import over
from tests.ragged import FAR, LATE, OUTSIDE, PROBLEMS, SHAKY, alone, bytes_of

pytestmark = pytest.mark.usefixtures("without_shape_checks", "one_batch")
QUICK = {"samples": 40, "trace_every": 2, "device": "cpu"}


@pytest.fixture
def one_batch(monkeypatch):
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1e18)


def assert_as_alone(problems, **changes):
    """The outcomes of a batch, which are those of each fit alone."""
    outcomes = fit_batch(problems, **QUICK, **changes)
    expected = [bytes_of(alone(problem, **QUICK, **changes)) for problem in problems]
    assert [bytes_of(outcome) for outcome in outcomes] == expected
    return outcomes


@over("place", [0, 2, 4])
@pytest.mark.parametrize(("stopped", "term"), [(FAR, "chamfer"), (OUTSIDE, "vertex position")])
def test_one_that_diverges_is_stopped_and_the_others_are_as_alone(place, stopped, term):
    outcomes = assert_as_alone([*PROBLEMS[:place], stopped, *PROBLEMS[place:4]], steps=5)
    diverged = outcomes.pop(place)
    assert (diverged.step, diverged.term) == (0, term)
    assert not any(isinstance(outcome, Diverged) for outcome in outcomes)


@pytest.mark.parametrize("optimizer", [{"name": "sgd"}, {"name": "adam", "lr": 0.02}], ids=["sgd", "adam"])
def test_of_two_that_are_stopped_together_each_has_its_own_reason(optimizer):
    problems = [PROBLEMS[0], FAR, PROBLEMS[3], OUTSIDE]
    outcomes = assert_as_alone(problems, steps=5, optimizer=optimizer)
    assert [getattr(outcome, "term", None) for outcome in outcomes] == [None, "chamfer", None, "vertex position"]


def test_two_that_diverge_at_different_steps_are_stopped_each_at_its_own():
    problems = [PROBLEMS[0], LATE[1], PROBLEMS[6], LATE[0]]
    fine, second, other, first = assert_as_alone(problems, **SHAKY)
    assert 1 < first.step < second.step < SHAKY["steps"]
    assert {first.term, second.term} == {"vertex position"}
    assert not isinstance(fine, Diverged)
    assert not isinstance(other, Diverged)


def test_all_may_diverge_at_once_or_one_after_the_other():
    assert [outcome.step for outcome in assert_as_alone([FAR, OUTSIDE, FAR], **SHAKY)] == [0, 0, 0]
    steps = [outcome.step for outcome in assert_as_alone([LATE[0], FAR, LATE[1], OUTSIDE], **SHAKY)]
    assert 0 == steps[1] == steps[3] < steps[0] < steps[2]


@pytest.mark.parametrize(("factor", "term"), [(torch.nan, "edge"), (1.0, "gradient of edge")])
def test_a_term_or_a_gradient_that_is_not_finite_stops_its_own_problem_alone(factor, term, monkeypatch):
    """Of the third problem, known by its number of verts, from the fourth step on."""
    calls, stopped = [], PROBLEMS[2].source.num_verts

    def kinked(state):
        if torch.is_grad_enabled():
            calls.append(state)
        moved = (state.verts - state.verts.detach() + 1).split(state.operators.of_vert.sizes)
        late = len(calls) > 3
        return torch.stack([_kink(part) * factor if late and len(part) == stopped else part.sum() for part in moved])

    def _kink(part):
        return (part - 1).square().sum().sqrt()

    monkeypatch.setitem(first_order.TERMS, "edge", kinked)
    problems = [PROBLEMS[i] for i in (0, 5, 2, 6)]
    outcomes = fit_batch(problems, steps=6, **QUICK)
    assert (outcomes[2].step, outcomes[2].term) == (3, term)
    for problem, outcome in zip(problems, outcomes, strict=True):
        calls.clear()
        assert bytes_of(alone(problem, steps=6, **QUICK)) == bytes_of(outcome)
