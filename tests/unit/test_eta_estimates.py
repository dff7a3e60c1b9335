"""Estimates of time: their basis, and their growth with the work."""

import pytest

from meshfit.errors import TrialError
from meshfit.experiment.plan import plan
from meshfit.experiment.running.process_pool import ProcessPool
from meshfit.experiment.status import eta
from meshfit.experiment.status.eta import _work, estimate
from tests.inline import Inline
from tests.small import experiment


def taking(trials, fit, measure=0.5):
    return [(trial, {"seconds": {"fit": fit, "measure": measure}}) for trial in trials]


def test_nothing_to_run_and_other_devices_have_no_estimate(tmp_path):
    assert estimate([], []) is None
    on_gpu = plan([experiment(tmp_path)])
    settings = on_gpu[0].settings.model_copy(update={"device": "cuda"})
    assert estimate([type(on_gpu[0])("small", settings, ())], []) is None


def test_complete_trials_are_the_basis_where_there_are_some(tmp_path):
    trials = plan([experiment(tmp_path, seeds=list(range(10)), jobs=1)])
    found = estimate(trials[4:], taking(trials[:4], fit=2.0))
    assert found.basis == "4 complete trials"
    assert found.workers == 1
    assert found.seconds == pytest.approx(6 * 2.5, abs=4)


def test_twice_the_steps_take_twice_the_fitting_and_half_with_two_workers(tmp_path):
    short = plan([experiment(tmp_path, seeds=list(range(100)))])
    long = plan([experiment(tmp_path, seeds=list(range(100)), fit={"steps": 40})])
    done = taking(short[:1], fit=10.0, measure=0.0)
    one, twice = (estimate(trials[1:], done, jobs=1).seconds for trials in (short, long))
    assert twice / one == pytest.approx(2, rel=0.01)
    assert one / estimate(short[1:], done, jobs=2).seconds == pytest.approx(2, rel=0.01)


def test_work_grows_with_steps_samples_and_verts(tmp_path):
    (base,) = plan([experiment(tmp_path)])
    for change in ({"fit": {"steps": 40}}, {"fit": {"samples": 200}}, {"source": {"levels": 3}}):
        (more,) = plan([experiment(tmp_path, **change)])
        assert _work(more) > 1.3 * _work(base)


def test_without_complete_trials_one_is_probed(tmp_path, monkeypatch):
    monkeypatch.setattr(ProcessPool, "submit", lambda _pool, _device, fn, *arguments: Inline().submit(fn, *arguments))
    trials = plan([experiment(tmp_path, seeds=[0, 1, 2], jobs=1)])
    found = estimate(trials, [])
    assert found.basis == "a probe of 1 trial"
    assert 0 < found.seconds < 60


@pytest.mark.slow
def test_a_long_trial_is_probed_by_its_first_steps(tmp_path):
    trials = plan([experiment(tmp_path, fit={"steps": 1_000_000}, jobs=1)])
    assert estimate(trials, []).seconds > 60


def test_a_probe_that_fails_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(ProcessPool, "submit", lambda _pool, _device, fn, *arguments: Inline().submit(fn, *arguments))
    with pytest.raises(TrialError, match="seed 0: diverged"):
        estimate(plan([experiment(tmp_path, fit={"optimizer": {"lr": 1e30}})]), [])


def test_targets_too_large_to_probe_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(eta, "_MOST_FACES_PROBED", 7)  # one less than those of an octahedron
    monkeypatch.setattr(ProcessPool, "submit", lambda *_: pytest.fail("a trial was probed"))
    trials = plan([experiment(tmp_path, seeds=[0, 1])])
    found = estimate(trials, [])
    assert (found.seconds, found.unknown) == (None, 2)
    assert found.left_out == "2 runs with targets of more than 7 faces not counted: their time is known after the first"
    assert estimate(trials[1:], taking(trials[:1], fit=2.0)).unknown == 0
