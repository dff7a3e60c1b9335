"""Snapshots: taken at the steps in their names, without effect on results, and the same after an interruption."""

import numpy as np
import pytest

import meshfit
from meshfit.errors import ConfigError
from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.running.worker import pack_inputs, pack_outputs, store_outputs, unpack_inputs
from meshfit.experiment.storage.checkpoint import SNAPSHOTS, snapshots_in
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.fitting.callbacks import Interrupted
from meshfit.mesh.attributes import Attributes
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.solids import cube, octahedron, quad_cube
from tests.fits import fit
from tests.small import experiment
from tests.unit.test_trial_runner import prepared, run_trial

pytestmark = pytest.mark.usefixtures("without_shape_checks", "fewer_target_points")

FIRST = {"steps": 20}
SECOND = {"method": "gauss-newton", "verts": 200, "coarse_steps": 6, "tries": 1, "level_steps": 4, "last_steps": 2}
ENGINES = {"first-order": FIRST, "gauss-newton": SECOND}


def test_snapshots_and_the_last_good_mesh_are_shapes_alone():
    heat = Attributes(vertex={"heat": np.arange(8.0)})
    for source, scheme in ((cube(), "loop"), (quad_cube(), "catmull-clark")):
        taken, dressed = {}, source.with_attributes(heat)
        options = {"steps": 2, "samples": 100, "scheme": scheme, "device": "cpu"}
        result = meshfit.fit(dressed, octahedron(), snapshots=1, on_snapshot=taken.__setitem__, **options)
        assert result.mesh.attributes
        assert taken
        with pytest.raises(meshfit.Diverged) as caught:
            meshfit.fit(dressed, octahedron(), optimizer={"lr": 1e30}, **options | {"steps": 9})
        for mesh in (caught.value.last_good, *taken.values()):
            assert isinstance(mesh, type(source))
            assert not mesh.attributes


def quietly(_progress):
    pass


def stopping_at(step):
    def on_progress(progress):
        if progress.step.done == step:
            raise Interrupted

    return on_progress


def bytes_of(folder):
    return {step: path.read_bytes() for step, path in snapshots_in(folder).items()}


def taken(folder, every, engine="first-order", **changes):
    """A trial with its snapshots, made undisturbed."""
    trial, store, place = prepared(folder, fit=ENGINES[engine] | {"snapshots": every}, **changes)
    assert run_trial(trial, store, quietly).status is TrialStatus.COMPLETE
    return trial, store, place


FEWER = ["first-order", pytest.param("gauss-newton", marks=pytest.mark.slow)]


@pytest.mark.parametrize("engine", FEWER)
def test_snapshots_move_no_number_and_no_identity(tmp_path, engine):
    plain, store, place = prepared(tmp_path, fit=ENGINES[engine])
    run_trial(plain, store, quietly)
    assert not (place / SNAPSHOTS).exists()
    before = {name: (place / name).read_bytes() for name in ("result.ply", "trace.csv", "config.yaml")}
    trial, _, _ = prepared(tmp_path, fit=ENGINES[engine] | {"snapshots": 4})
    assert (trial.identity, trial.folder, trial.plain_settings) == (plain.identity, plain.folder, plain.plain_settings)
    run_trial(trial, store, quietly, force=True)
    assert list(snapshots_in(place)) == list(range(4, trial.settings.fit.steps + 1, 4))
    assert {name: (place / name).read_bytes() for name in before} == before


@pytest.mark.parametrize("engine", ENGINES)
def test_a_snapshot_is_the_surface_after_so_many_steps(tmp_path, engine):
    trial, _, place = taken(tmp_path, 5, engine)
    last = max(snapshots_in(place))
    assert len({load_mesh(path).verts.tobytes() for path in snapshots_in(place).values()}) == len(snapshots_in(place))
    if last == trial.settings.fit.steps:
        assert bytes_of(place)[last] == (place / "result.ply").read_bytes()


@pytest.mark.parametrize("engine", FEWER)
def test_a_trial_that_was_stopped_has_the_snapshots_of_one_that_was_not(tmp_path, engine):
    trial, store, place = taken(tmp_path, 3, engine)
    stopped = RunDirectory(tmp_path / "stopped")
    for step in (4, 6, 9):
        assert run_trial(trial, stopped, stopping_at(step)).status is TrialStatus.INTERRUPTED
    # As a kill leaves it: a snapshot of a step that is to come again, and one half written.
    (stopped.folder(trial) / SNAPSHOTS / "step-000012.ply").write_bytes(b"older")
    (stopped.folder(trial) / SNAPSHOTS / ".step-000012.ply.abcdefgh").write_bytes(b"half")
    assert run_trial(trial, stopped, quietly).status is TrialStatus.COMPLETE
    assert bytes_of(stopped.folder(trial)) == bytes_of(place)
    names = [sorted(path.name for path in (one.folder(trial) / SNAPSHOTS).iterdir()) for one in (store, stopped)]
    assert names[0] == names[1]


def test_where_snapshots_are_wanted_otherwise_than_before_a_stopped_trial_starts_over(tmp_path):
    trial, store, place = prepared(tmp_path, fit=FIRST | {"snapshots": 3})
    run_trial(trial, store, stopping_at(7))
    assert list(snapshots_in(place)) == [3, 6]
    other, _, _ = prepared(tmp_path, fit=FIRST | {"snapshots": 5})
    run_trial(other, store, quietly)
    assert list(snapshots_in(place)) == [5, 10, 15, 20]
    assert "starting over" in (place / "trial.log").read_text()


def test_trials_of_a_batch_have_the_snapshots_that_each_has_alone(tmp_path):
    trials = plan([experiment(tmp_path, fit=FIRST | {"snapshots": 8}, seeds=[0, 1])])
    together, alone = RunDirectory(tmp_path / "together"), RunDirectory(tmp_path / "alone")
    run_batch(trials, together, lambda *_: None)
    for trial in trials:
        run_trial(trial, alone, quietly)
        assert bytes_of(together.folder(trial)) == bytes_of(alone.folder(trial))
        assert list(snapshots_in(alone.folder(trial))) == [8, 16]


def test_they_are_written_in_the_frame_of_the_result(tmp_path):
    _, _, place = taken(tmp_path, 20, write_frame="normalised")
    assert bytes_of(place)[20] == (place / "result.ply").read_bytes()


def test_they_travel_to_other_machines_and_back(tmp_path):
    trial, _, place = taken(tmp_path, 5)
    here, there = RunDirectory(tmp_path / "here"), RunDirectory(tmp_path / "there")
    run_trial(trial, here, stopping_at(12))
    there.folder(trial).mkdir(parents=True)
    opened = unpack_inputs(trial, pack_inputs(trial, here), there, tmp_path / "inputs")
    run_trial(opened, there, quietly)
    assert "starting over" not in (there.folder(trial) / "trial.log").read_text()
    (here.folder(trial) / SNAPSHOTS / "step-000007.ply").write_bytes(b"of no use")
    store_outputs(trial, pack_outputs(trial, there), here)
    assert bytes_of(here.folder(trial)) == bytes_of(place)


def test_a_python_caller_gets_them_too():
    seen = []
    result = fit(
        octahedron(),
        octahedron(),
        steps=6,
        samples=20,
        snapshots=2,
        device="cpu",
        on_snapshot=lambda step, mesh: seen.append((step, mesh)),
    )
    assert [step for step, _ in seen] == [2, 4, 6]
    assert seen[-1][1].verts.tobytes() == result.mesh.verts.tobytes()


@pytest.mark.parametrize("key", ["fit.snapshots", "jobs", "sweep"])
def test_what_moves_no_number_cannot_be_swept(tmp_path, key):
    with pytest.raises(ConfigError, match="no effect on results"):
        prepared(tmp_path, sweep={key: [1, 2]})
