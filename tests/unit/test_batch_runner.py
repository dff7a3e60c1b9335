"""Trials run as one batch: each ends as it would alone, and none makes another fail."""

import pytest

from meshfit.experiment.plan import plan
from meshfit.experiment.running import batch_runner as trial
from meshfit.experiment.running import trial_runner
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.fitting.callbacks import Interrupted
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from tests.small import experiment

pytestmark = pytest.mark.usefixtures("without_shape_checks")

FILES = ("result.ply", "trace.csv", "source.ply")


def planned(folder):
    save_mesh(cube(), folder / "cube.ply")
    targets = [*experiment(folder).settings.targets, str(folder / "cube.ply")]
    return plan([experiment(folder, targets=targets, schemes=["loop", "sqrt3"], seeds=[0, 1])])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("meshes")


@pytest.fixture(scope="module")
def trials(folder):
    return planned(folder)


def quiet(_place, _progress):
    return None


def contents(store, trials):
    return [[(store.folder(trial) / name).read_bytes() for name in FILES] for trial in trials]


def phases(outcomes):
    return [outcome.status for outcome in outcomes]


@pytest.fixture(scope="module")
def alone(folder, trials):
    store = RunDirectory(folder / "alone")
    for one in trials:
        assert phases(run_batch([one], store, quiet)) == [TrialStatus.COMPLETE]
    return store


def test_a_batch_leaves_what_its_trials_leave_alone(tmp_path, trials, alone):
    store = RunDirectory(tmp_path / "together")
    assert phases(run_batch(trials, store, quiet)) == [TrialStatus.COMPLETE] * 8
    assert contents(store, trials) == contents(alone, trials)
    assert [store.result(one)["hausdorff"] for one in trials] == [alone.result(one)["hausdorff"] for one in trials]
    # Every member has an equal share of the fit.
    assert len({store.result(one)["seconds"]["fit"] for one in trials}) == 1


def test_threads_change_no_byte(tmp_path, trials, alone):
    store = RunDirectory(tmp_path / "threads")
    run_batch(trials, store, quiet, threads=3)
    assert contents(store, trials) == contents(alone, trials)


def test_complete_trials_of_a_batch_are_left(tmp_path, trials):
    store = RunDirectory(tmp_path / "runs")
    run_batch(trials[:3], store, quiet)
    before = [(store.folder(one) / "result.json").stat().st_mtime_ns for one in trials[:3]]
    told = []
    assert phases(run_batch(trials, store, lambda place, _: told.append(place))) == [TrialStatus.COMPLETE] * 8
    assert [(store.folder(one) / "result.json").stat().st_mtime_ns for one in trials[:3]] == before
    assert set(told) == {3, 4, 5, 6, 7}


def test_a_batch_that_is_interrupted_goes_on_to_the_same_bytes(tmp_path, trials, alone):
    store = RunDirectory(tmp_path / "runs")

    def stop_at_nine(place, progress):
        if place == 5 and progress.step.done == 9:
            raise Interrupted

    assert phases(run_batch(trials, store, stop_at_nine)) == [TrialStatus.INTERRUPTED] * 8
    assert all((store.folder(one) / "checkpoint.pt").is_file() for one in trials)
    (store.folder(trials[2]) / "checkpoint.pt").unlink()  # one of them starts over
    steps = []
    run_batch(trials, store, lambda place, progress: steps.append((place, progress.step.done)))
    assert {done for place, done in steps if place == 2 and done} == set(range(1, 21))
    assert {done for place, done in steps if place == 3 and done} == set(range(10, 21))
    assert contents(store, trials) == contents(alone, trials)


def test_a_target_that_cannot_be_loaded_fails_alone(tmp_path, alone):
    trials = planned(tmp_path)
    (tmp_path / "cube.ply").write_bytes(b"ply\nnonsense")
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_batch(trials, store, quiet)
    good, bad = trials[:4], trials[4:]
    assert phases(outcomes) == [TrialStatus.COMPLETE] * 4 + [TrialStatus.FAILED] * 4
    assert all("cube.ply" in outcome.message for outcome in outcomes[4:])
    assert all(store.failure(one)["kind"] == "input" for one in bad)
    assert contents(store, good) == contents(alone, good)


@pytest.mark.slow
def test_a_batch_that_fails_as_a_whole_is_run_one_by_one(tmp_path, trials, alone, monkeypatch):
    real, sizes = trial.fit_batch, []

    def fit_batch(problems, *args, **options):
        sizes.append(len(problems))
        if len(problems) > 1 or problems[0].seed == 1:
            raise RuntimeError("out of memory\nand more")
        return real(problems, *args, **options)

    monkeypatch.setattr(trial, "fit_batch", fit_batch)
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_batch(trials, store, quiet)
    assert sizes == [8] + [1] * 8
    assert phases(outcomes) == [TrialStatus.COMPLETE, TrialStatus.FAILED] * 4
    assert "out of memory" in outcomes[1].message
    assert contents(store, trials[::2]) == contents(alone, trials[::2])


def test_a_member_whose_measurement_fails_is_recorded_and_the_others_complete(tmp_path, trials, monkeypatch):
    real = trial_runner.measure

    def measure(result, *args, **options):
        if len(result.verts) == trials_verts:
            raise RuntimeError("no figure")
        return real(result, *args, **options)

    store = RunDirectory(tmp_path / "probe")
    run_batch(trials[2:3], store, quiet)
    trials_verts = store.result(trials[2])["quality"]["verts"]
    monkeypatch.setattr(trial_runner, "measure", measure)
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_batch(trials, store, quiet)
    assert phases(outcomes) == [TrialStatus.COMPLETE, TrialStatus.COMPLETE, TrialStatus.FAILED, TrialStatus.FAILED] * 2
    assert store.failure(trials[2])["kind"] == "error"


def test_a_member_that_diverges_is_recorded_and_the_others_complete(tmp_path, trials, alone):
    save_mesh(Mesh(1e30 * cube().verts, cube().faces), tmp_path / "far.ply")
    wild = plan([experiment(tmp_path, targets=[str(tmp_path / "far.ply")], normalise="none")])
    store = RunDirectory(tmp_path / "runs")
    outcomes = run_batch([*trials[:2], *wild, *trials[2:]], store, quiet)
    assert outcomes[2].status is TrialStatus.FAILED
    assert store.failure(wild[0])["term"] == "chamfer"
    assert contents(store, trials) == contents(alone, trials)
