import io
import itertools
import json
import shutil
import warnings
from contextlib import suppress

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from meshfit.cli.console import show_warnings
from meshfit.cli.early_warnings import EarlyWarnings
from meshfit.config.loading import load_experiment
from meshfit.errors import MeshfitWarning, StoreError
from meshfit.experiment.plan import plan
from meshfit.experiment.running import batch_runner, trial_runner
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.storage.checkpoint import read_checkpoint, write_checkpoint
from meshfit.experiment.storage.frame import frame_of
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.storage.targets import read_target
from meshfit.experiment.trial_status import Outcome, Progress, TrialStatus
from meshfit.fitting import loop as run
from meshfit.fitting.callbacks import Interrupted
from meshfit.measuring.measure import measure
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.trial_meshes import read_normalised
from tests.cli import invoke
from tests.small import ellipsoid, experiment

pytestmark = pytest.mark.usefixtures("without_shape_checks")

IN_TARGET_FRAME = {"frame": "target", "radius": None, "centre": None}
FILES = ["config.yaml", "result.json", "result.ply", "source.ply", "times.csv", "trace.csv", "trial.log"]


def prepared(folder, **changes):
    (trial,) = plan([experiment(folder, **changes)])
    store = RunDirectory(folder / "runs")
    return trial, store, store.folder(trial)


def run_trial(trial, store, on_progress, **options):
    (outcome,) = run_batch([trial], store, lambda _, progress: on_progress(progress), **options)
    return outcome


def visible(folder):
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


def test_a_complete_trial_leaves_its_files_and_nothing_else(tmp_path):
    trial, store, folder = prepared(tmp_path)
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    assert visible(folder) == FILES
    result = store.result(trial)
    assert result["hausdorff"].keys() >= {"forward", "backward", "symmetric", "samples"}
    assert result["distance"].keys() >= {"mean", "rms"}
    assert result["seconds"].keys() == {"prepare", "fit", "measure"}
    assert result["peak_memory_mb"] is None or 50 < result["peak_memory_mb"] < 100_000
    assert (result["target"], result["scheme"], result["seed"]) == ("ellipsoid", "loop", 0)
    assert {"python", "meshfit", "torch", "pymeshlab"} <= result["versions"].keys()


def test_a_difference_in_topology_is_warned_of_in_words(tmp_path):
    """An open target has no genus: its boundary loops and its Euler number are named."""
    closed = load_mesh(ellipsoid(tmp_path, "closed.ply"))
    save_mesh(Mesh(closed.verts, closed.faces[1:]), tmp_path / "open.ply")
    with pytest.warns(MeshfitWarning, match="the surface is open"):
        trial, store, _ = prepared(tmp_path, targets=[str(tmp_path / "open.ply")])
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    difference, shortfall = store.result(trial)["warnings"][-2:]
    assert difference == (
        "source and target differ in topology (1 piece, closed, genus 0; 1 piece, open, 1 boundary loop, "
        "Euler number 1); the fit keeps that of the source"
    )
    assert shortfall == "topology not matched: the target has 1 opening (0 in the result)"


def test_warnings_of_loading_are_printed_while_trials_run_once_per_target_and_source(tmp_path, capsys):
    closed = load_mesh(ellipsoid(tmp_path, "closed.ply"))
    save_mesh(Mesh(closed.verts, closed.faces[1:]), tmp_path / "open.ply")
    changes = {"targets": [str(tmp_path / "open.ply")], "seeds": [0, 1], "source": {"centre": [9.0, 0.0, 0.0]}}
    with pytest.warns(MeshfitWarning):
        trials = plan([experiment(tmp_path, **changes)])
    store = RunDirectory(tmp_path / "runs")
    early = EarlyWarnings(trials, store, clock=itertools.count().__next__)
    printed = []

    def on_progress(index, progress):
        running = {index: progress, 1 - index: Progress(TrialStatus.WAITING)}
        early.update(running, {})
        if progress.step.done == 1:  # all is said before the second step
            printed.append(capsys.readouterr().err)

    with show_warnings():
        for index, trial in enumerate(trials):
            run_batch([trial], store, lambda _, progress, index=index: on_progress(index, progress))
        early.update({}, dict.fromkeys(range(2), Outcome(TrialStatus.COMPLETE)))
    first, second = printed
    for text in ("do not overlap", "differ in topology", "the target is open (1 opening)", "the surface is open"):
        assert first.count(text) == 1, text
    assert second == capsys.readouterr().err == ""
    assert all("do not overlap" in (store.folder(trial) / "trial.log").read_text("utf-8") for trial in trials)


def test_a_source_in_the_frame_of_the_target_keeps_its_place_and_size(tmp_path):
    """A head in millimetres that another program has aligned: it starts where it is, and so does its result."""
    target = load_mesh(ellipsoid(tmp_path, "target.ply"))
    head = target.with_verts(target.verts * 105 + [300.0, -40.0, 1200.0])
    save_mesh(head, tmp_path / "head.ply")
    template = head.with_verts(head.verts + np.array([2.0, 0.0, 1.0]))
    save_mesh(template, tmp_path / "template.ply")
    source = {"mesh": str(tmp_path / "template.ply"), "levels": 0} | IN_TARGET_FRAME
    trial, store, folder = prepared(tmp_path, targets=[str(tmp_path / "head.ply")], source=source)
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    np.testing.assert_allclose(load_mesh(folder / "source.ply").verts, template.verts, atol=1e-9)
    assert not [text for text in store.result(trial)["warnings"] if "source.align" in text]


def test_floaters_are_warned_of_and_left_out_of_the_frame_the_fit_and_the_measurement(tmp_path):
    whole = load_mesh(ellipsoid(tmp_path, "whole.ply"))
    far = whole.verts * 0.02 + [7.0, 0.0, 0.0]
    faces = np.concatenate([whole.faces, whole.faces + whole.num_verts])
    save_mesh(Mesh(np.concatenate([whole.verts, far]), faces), tmp_path / "scan.ply")
    results = []
    for name, keep in (("scan.ply", None), ("scan.ply", "largest"), ("whole.ply", None)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshfitWarning)
            trial, store, folder = prepared(tmp_path, targets=[str(tmp_path / name)], target={"keep": keep})
        assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
        results.append((store.result(trial), folder))
    (everything, _), (kept, folder), (clean, _) = results
    (floaters,) = [text for text in everything["warnings"] if "small piece" in text]
    assert "scan.ply: 1 small piece far off the others (0.04 % of the area" in floaters
    assert "target.keep: largest" in floaters
    assert not any("small piece" in text for text in kept["warnings"])
    assert kept["frame"]["scale"] == clean["frame"]["scale"]
    assert kept["hausdorff"] == clean["hausdorff"]
    assert read_target(folder, kept).num_verts == whole.num_verts


def test_an_alignment_is_in_the_log_the_result_and_what_is_shown(tmp_path):
    """The ellipsoid turned by 60 degrees about z; a half turn more would serve as well, and is warned of."""
    target = load_mesh(ellipsoid(tmp_path, "target.ply"))
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 3])
    save_mesh(target.with_verts(2.0 * turn.apply(np.array(target.verts))), tmp_path / "turned.ply")
    source = {"mesh": str(tmp_path / "turned.ply"), "levels": 0, "align": "icp"}
    trial, store, folder = prepared(tmp_path, targets=[str(tmp_path / "target.ply")], source=source)
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    result = store.result(trial)
    align = result["source"]["align"]
    assert (align["method"], align["turn_degrees"]) == ("icp", pytest.approx(60, abs=0.5))
    assert align["other_turn_degrees"] == pytest.approx(180, abs=1)
    line = f"turned by {align['turn_degrees']:.3g}°, scaled by {align['scale']:.4g}"
    assert f"source.align: icp: the source is {line}" in (folder / "trial.log").read_text(encoding="utf-8")
    (doubt,) = [text for text in result["warnings"] if "another pose" in text]
    assert doubt.startswith("source.align: icp: another pose, turned from this one by 180°, lies about as well")
    assert line in invoke("show", folder).out


def test_a_trial_that_another_process_is_running_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(batch_runner, "_LOCK_SECONDS", 0.01)
    trial, store, folder = prepared(tmp_path)
    seen = []

    def stop(progress):
        seen.append(progress.status)
        raise Interrupted

    with store.lock(trial):
        assert run_trial(trial, store, stop).status is TrialStatus.INTERRUPTED
        assert seen == [TrialStatus.WAITING]
        assert visible(folder) == []
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE


def test_the_figures_are_those_of_the_files(tmp_path):
    trial, store, folder = prepared(tmp_path)
    run_trial(trial, store, lambda _: None)
    result = store.result(trial)
    assert result["frame"]["written"] == "target"
    scale = result["frame"]["scale"]
    found = measure(load_mesh(folder / "result.ply"), load_mesh(trial.target), trial.settings.measure).to_dict()
    assert found["hausdorff"]["symmetric"] / scale == pytest.approx(result["hausdorff"]["symmetric"], rel=1e-5)
    assert found["quality"]["faces"] == result["quality"]["faces"]


def test_the_frame_of_the_files_moves_no_number_and_no_identity(tmp_path):
    trial, store, folder = prepared(tmp_path)
    other, _, elsewhere = prepared(tmp_path, write_frame="normalised")
    assert (other.identity, elsewhere) == (trial.identity, folder)
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    in_target_frame, first = load_mesh(folder / "result.ply"), store.result(trial)
    assert store.is_complete(other)
    run_trial(other, store, lambda _: None, force=True)
    second = store.result(trial)
    assert (first["frame"].pop("written"), second["frame"].pop("written")) == ("target", "normalised")
    for group in ("hausdorff", "distance", "frame", "settings"):
        assert first[group] == second[group]
    frame = frame_of(first)
    np.testing.assert_array_equal(frame.restore(load_mesh(folder / "result.ply")).verts, in_target_frame.verts)


def test_a_target_far_from_the_origin_is_fitted_as_one_at_the_origin(tmp_path):
    offset = np.array([2.0**20, -(2.0**21), 2.0**20])
    near = load_mesh(ellipsoid(tmp_path))
    # Coordinates with few digits, which the offset does not round.
    near = Mesh(np.round(near.verts * 2**20) / 2**20, near.faces)
    results = []
    for name, mesh in (("near.ply", near), ("far.ply", Mesh(near.verts + offset, near.faces))):
        save_mesh(mesh, tmp_path / name)
        trial, store, folder = prepared(tmp_path, targets=[str(tmp_path / name)])
        run_trial(trial, store, lambda _: None)
        result = load_mesh(folder / "result.ply")
        results.append((store.result(trial), result.verts, read_normalised(folder / "result.ply", store.result(trial))))
    (at_origin, verts, normalised), (far, moved, also_normalised) = results
    np.testing.assert_allclose(moved - offset, verts, atol=1e-6)
    np.testing.assert_allclose(also_normalised.verts, normalised.verts, atol=1e-6)
    assert far["hausdorff"]["symmetric"] == pytest.approx(at_origin["hausdorff"]["symmetric"], rel=1e-5)


def test_a_resumed_trial_keeps_the_frame_of_its_first_files(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"snapshots": 5})
    run_trial(trial, store, lambda _: None)
    whole = {name: (folder / name).read_bytes() for name in ("source.ply", "result.ply", "snapshots/step-000005.ply")}
    stopped = RunDirectory(tmp_path / "stopped")

    def stop_at_seven(progress):
        if progress.step.done == 7:
            raise Interrupted

    run_trial(trial, stopped, stop_at_seven)
    other, _, _ = prepared(tmp_path, fit={"snapshots": 5}, write_frame="normalised")
    run_trial(other, stopped, lambda _: None)
    assert stopped.result(trial)["frame"]["written"] == "target"
    assert {name: (stopped.folder(trial) / name).read_bytes() for name in whole} == whole


def test_the_written_config_runs_the_same_trial_again(tmp_path):
    trial, store, folder = prepared(tmp_path, schemes=["interp-loop:alpha=0.5"])
    run_trial(trial, store, lambda _: None)
    (again,) = plan([load_experiment(str(folder / "config.yaml"))])
    assert again.identity == trial.identity


def test_a_complete_trial_is_left_alone_unless_forced(tmp_path):
    trial, store, folder = prepared(tmp_path)
    run_trial(trial, store, lambda _: None)
    before = (folder / "result.json").read_bytes()
    ply = (folder / "result.ply").read_bytes()
    run_trial(trial, store, lambda _: None)
    assert (folder / "result.json").read_bytes() == before
    run_trial(trial, store, lambda _: None, force=True)
    assert (folder / "result.json").read_bytes() != before
    assert (folder / "result.ply").read_bytes() == ply


def check_times(folder, result):
    """Check that there is a time for each row of the trace, that times rise, and that they end with the fit."""
    trace, times = (
        [line.split(",") for line in (folder / name).read_text().splitlines()] for name in ("trace.csv", "times.csv")
    )
    assert times[0] == ["step", "seconds"]
    assert [row[0] for row in times] == [row[0] for row in trace]
    seconds = [float(row[1]) for row in times[1:]]
    assert seconds == sorted(seconds)
    assert 0 <= seconds[0] < seconds[-1] <= result["seconds"]["fit"]


@pytest.mark.parametrize("method", ["first-order", "gauss-newton"])
def test_seconds_are_recorded_beside_the_trace_and_go_on_after_an_interruption(tmp_path, monkeypatch, method):
    fit = {"method": method, "trace_every": 1}
    if method == "gauss-newton":
        fit |= {"verts": 100, "levels": 1, "coarse_steps": 4, "tries": 1, "level_steps": 2, "last_steps": 2}
    trial, store, folder = prepared(tmp_path, fit=fit)
    now = [100.0]
    monkeypatch.setattr(run.time, "perf_counter", lambda: now[0])

    def slowly(progress):
        now[0] += 2.0
        if progress.status is TrialStatus.FITTING and progress.step.done == 3 and not stopped:
            stopped.append(now[0])
            raise Interrupted

    stopped = []
    run_trial(trial, store, slowly)
    now[0] += 1000.0  # between two attempts
    run_trial(trial, store, slowly)
    rows = (folder / "times.csv").read_text().splitlines()[1:]
    seconds = np.array([float(row.split(",")[1]) for row in rows])
    assert len(rows) == trial.settings.fit.steps
    assert (np.diff(seconds) == 2.0).all()
    check_times(folder, store.result(trial))


def test_an_interrupted_trial_goes_on_and_ends_in_the_same_bytes(tmp_path):
    trial, store, folder = prepared(tmp_path)
    run_trial(trial, store, lambda _: None)
    whole = {name: (folder / name).read_bytes() for name in ("result.ply", "trace.csv")}
    figures = store.result(trial)["hausdorff"]
    stopping = RunDirectory(tmp_path / "stopped")

    def stop_at_seven(progress):
        if progress.step.done == 7:
            raise Interrupted

    assert run_trial(trial, stopping, stop_at_seven).status is TrialStatus.INTERRUPTED
    assert stopping.result(trial) is None
    assert "checkpoint.pt" in visible(stopping.folder(trial))
    steps = []
    run_trial(trial, stopping, lambda progress: steps.append(progress.step.done))
    assert next(filter(None, steps)) == 8
    check_times(stopping.folder(trial), stopping.result(trial))
    assert {name: (stopping.folder(trial) / name).read_bytes() for name in whole} == whole
    assert stopping.result(trial)["hausdorff"] == figures
    assert visible(stopping.folder(trial)) == FILES


def saved(content):
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def test_a_checkpoint_of_another_trial_is_not_resumed(tmp_path):
    first, second = plan([experiment(tmp_path, seeds=[0, 1])])
    alone, mixed = RunDirectory(tmp_path / "alone"), RunDirectory(tmp_path / "mixed")
    run_trial(first, alone, lambda _: None)

    def stop_at_seven(progress):
        if progress.step.done == 7:
            raise Interrupted

    run_trial(second, mixed, stop_at_seven)
    mixed.folder(first).mkdir()
    shutil.copy(mixed.folder(second) / "checkpoint.pt", mixed.folder(first))
    steps = []
    run_trial(first, mixed, lambda progress: steps.append(progress.step.done))
    assert next(filter(None, steps)) == 1
    for name in ("result.ply", "trace.csv"):
        assert (mixed.folder(first) / name).read_bytes() == (alone.folder(first) / name).read_bytes()
    log = (mixed.folder(first) / "trial.log").read_text()
    assert "starting over: checkpoint.pt is that of another trial\n" in log


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", saved([1, 2]), saved({}), saved({"done": 7}), saved(None)])
def test_a_damaged_checkpoint_is_refused(tmp_path, damage):
    trial, store, folder = prepared(tmp_path)
    folder.mkdir(parents=True)
    assert read_checkpoint(trial, store) is None
    (folder / "checkpoint.pt").write_bytes(damage)
    with pytest.raises(StoreError, match=r"checkpoint\.pt is damaged, or of another version"):
        read_checkpoint(trial, store)


def test_no_byte_of_a_checkpoint_can_change_what_is_resumed(tmp_path):
    trial, store, folder = prepared(tmp_path)
    folder.mkdir(parents=True)
    content = {
        "done": 7,
        "trace": [(1, 0.1), (2, 1e-300)],
        "mesh": {"verts": torch.arange(6.0).view(2, 3)},
        "tool": None,
    }
    write_checkpoint(trial, store, content)
    whole = (folder / "checkpoint.pt").read_bytes()
    assert repr(read_checkpoint(trial, store)) == repr(content)
    random = np.random.default_rng(0)
    for place in random.choice(len(whole), 60, replace=False):
        damaged = bytearray(whole)
        damaged[place] ^= int(random.integers(1, 256))
        (folder / "checkpoint.pt").write_bytes(damaged)
        with suppress(StoreError):
            assert repr(read_checkpoint(trial, store)) == repr(content)


def test_a_trial_with_a_damaged_checkpoint_starts_over(tmp_path):
    trial, store, folder = prepared(tmp_path)
    folder.mkdir(parents=True)
    (folder / "checkpoint.pt").write_bytes(saved([1, 2]))
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    assert "starting over: checkpoint.pt is damaged" in (folder / "trial.log").read_text()


def test_a_checkpoint_is_never_executed(tmp_path):
    import pickle

    class Payload:
        def __reduce__(self):
            return (open, (str(tmp_path / "executed"), "w"))

    trial, store, folder = prepared(tmp_path)
    folder.mkdir(parents=True)
    (folder / "checkpoint.pt").write_bytes(pickle.dumps(Payload()))
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    assert not (tmp_path / "executed").exists()


def test_a_diverging_trial_is_recorded_with_step_term_and_last_good_mesh(tmp_path):
    trial, store, folder = prepared(tmp_path, fit={"optimizer": {"lr": 1e30}})
    outcome = run_trial(trial, store, lambda _: None)
    record = store.failure(trial)
    assert outcome.status is TrialStatus.FAILED
    assert outcome.message.startswith("diverged: the fit diverged at step")
    assert record["kind"] == "diverged"
    assert record["step"] >= 1
    assert record["term"]
    last_good = load_mesh(folder / record["last_good"])
    assert np.isfinite(last_good.verts).all()
    assert record["frame"]["written"] == "target"
    # The fit computes in single precision and in the normalised frame.
    for verts, is_single in ((frame_of(record).normalise(last_good).verts, True), (last_good.verts, False)):
        assert np.allclose(verts, verts.astype(np.float32), rtol=1e-12, atol=1e-14) == is_single
    assert {"times.csv", "trace.csv"} <= set(visible(folder))
    assert "result.json" not in visible(folder)


def test_an_unforeseen_error_is_recorded_with_its_traceback(tmp_path, monkeypatch):
    trial, store, folder = prepared(tmp_path)

    def broken(*_args, **_options):
        raise RuntimeError("out of luck")

    monkeypatch.setattr(trial_runner, "measure", broken)
    assert run_trial(trial, store, lambda _: None).message == "error: out of luck"
    assert "out of luck" in "".join(store.failure(trial)["traceback"])
    monkeypatch.undo()
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    assert visible(folder) == FILES


def test_a_store_that_cannot_be_written_is_not_a_failure_of_the_trial(tmp_path, monkeypatch):
    trial, store, _ = prepared(tmp_path)

    def full(*_args, **_options):
        raise StoreError("no space left")

    monkeypatch.setattr(RunDirectory, "write", full)
    with pytest.raises(StoreError, match="no space left"):
        run_trial(trial, store, lambda _: None)


def test_checkpoints_are_written_while_the_fit_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "SECONDS_BETWEEN_CHECKPOINTS", 0.0)
    trial, store, folder = prepared(tmp_path)
    seen = []
    run_trial(trial, store, lambda progress: seen.append((folder / "checkpoint.pt").is_file()))
    assert any(seen)
    assert json.loads((folder / "result.json").read_text())["identity"] == trial.identity
