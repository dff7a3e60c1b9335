"""Where trials run: workers that fill the cores, and batches by device."""

import os

import pytest

from meshfit.experiment.plan import plan
from meshfit.experiment.running import device_assignment
from meshfit.experiment.running.device_assignment import assign_devices, available_cores, workers_and_threads
from tests.small import experiment


@pytest.fixture
def trials(tmp_path):
    def make(count=3, **changes):
        return plan([experiment(tmp_path, seeds=list(range(count)), **changes)])

    return make


def numbered(*groups):
    return dict(enumerate(trial for group in groups for trial in group))


def gpus(count):
    return [f"cuda:{i}" for i in range(count)]


@pytest.fixture
def machine(monkeypatch, tmp_path):
    def of(cores, quota=None, memory=1e15):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(cores), raising=False)
        monkeypatch.setattr(os, "sysconf", lambda name: 1 if name == "SC_PAGE_SIZE" else int(memory))
        monkeypatch.setattr(device_assignment, "_CPU_QUOTA", tmp_path / "cpu.max")
        if quota is not None:
            (tmp_path / "cpu.max").write_text(quota)

    return of


def test_on_the_cpu_each_trial_is_by_itself(trials):
    assert assign_devices(numbered(trials(3, device="auto")), gpus(0)) == [("cpu", (0,)), ("cpu", (1,)), ("cpu", (2,))]
    assert assign_devices(numbered(trials(2, device="cpu")), gpus(4)) == [
        ("cpu", (0,)),
        ("cpu", (1,)),
    ]


def test_on_a_gpu_trials_of_the_same_settings_go_together(trials):
    assert assign_devices(numbered(trials(3, device="auto")), gpus(1)) == [("cuda:0", (0, 1, 2))]


def test_trials_of_other_settings_or_precision_are_batches_of_their_own(trials):
    groups = (
        trials(2, device="auto"),
        trials(2, device="auto", fit={"steps": 7}),
        trials(1, device="auto", dtype="float64"),
    )
    assert assign_devices(numbered(*groups), gpus(1)) == [("cuda:0", (0, 1)), ("cuda:0", (2, 3)), ("cuda:0", (4,))]


def test_several_gpus_share_the_trials(trials):
    assert assign_devices(numbered(trials(5, device="auto")), gpus(2)) == [
        ("cuda:0", (0, 1, 2)),
        ("cuda:1", (3, 4)),
    ]


def test_a_gpu_that_is_named_gets_them_all_and_batches_stay_small(trials, monkeypatch):
    named = numbered(trials(150, device="auto"))
    monkeypatch.setattr(device_assignment, "_MAX_BATCH", 64)
    batches = assign_devices(named, gpus(1))
    assert [len(numbers) for _, numbers in batches] == [64, 64, 22]
    assert sorted(i for _, numbers in batches for i in numbers) == list(range(150))


@pytest.mark.parametrize(
    ("cores", "count", "jobs", "expected"),
    [
        (1, 5, None, (1, 1)),
        (2, 5, None, (2, 1)),
        (2, 1, None, (1, 2)),
        (8, 3, None, (3, 2)),
        (8, 5, None, (5, 1)),
        (8, 5, 1, (1, 2)),
        (2, 5, 4, (4, 1)),
        (2, 3, 9, (3, 1)),
    ],
)
def test_cores_are_full_and_none_is_asked_twice(trials, machine, cores, count, jobs, expected):
    machine(cores)
    assert workers_and_threads(trials(count), jobs) == expected


def test_settings_override_the_choice_and_the_option_overrides_settings(trials, machine):
    machine(8)
    assert workers_and_threads(trials(6, jobs=2, threads=3), None) == (2, 3)
    assert workers_and_threads(trials(6, jobs=2, threads=3), 5) == (5, 3)


def test_no_more_workers_than_fit_into_memory(trials, machine):
    machine(64, memory=8e9)
    assert workers_and_threads(trials(40), None)[0] == 10


@pytest.mark.parametrize(
    ("quota", "expected"), [(None, 16), ("max 100000", 16), ("250000 100000", 2), ("50000 100000", 1), ("nonsense", 16)]
)
def test_a_containers_quota_bounds_the_cores(machine, quota, expected):
    machine(16, quota)
    assert available_cores() == expected


def test_jobs_and_threads_are_no_part_of_a_trials_identity(trials):
    assert [trial.identity for trial in trials(2)] == [trial.identity for trial in trials(2, jobs=7, threads=2)]
