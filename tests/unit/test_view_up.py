"""The axis that points up: in a config, in the plan of a run, and in cameras."""

import json

import numpy as np
import pytest

from meshfit.experiment.plan import plan
from meshfit.experiment.storage.plan_file import planned_up, read_plan, update_order, write_plan
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.targets import load_target
from meshfit.report.figures.camera import camera_of, is_turned
from tests.small import ellipsoid, experiment


def test_the_view_is_no_part_of_a_trial_and_follows_the_latest_run(tmp_path):
    store = RunDirectory(tmp_path / "runs")
    trials = plan([experiment(tmp_path, seeds=[0, 1])])
    turned = plan([experiment(tmp_path, seeds=[0, 1], view={"up": "z"})])
    assert [trial.identity for trial in trials] == [trial.identity for trial in turned]
    folder = store.folder(trials[0])
    assert planned_up(folder) == "auto"  # without a plan
    write_plan(trials, store, 1)
    assert planned_up(folder) == "auto"
    update_order(turned[:1], store)
    assert planned_up(folder) == "z"
    assert len(read_plan(tmp_path / "runs" / "small").trials) == 2  # the other one stays planned
    path = tmp_path / "runs" / "small" / "plan.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"view": {"up": "w"}}))
    assert planned_up(folder) == "auto"  # `status` reports the damaged plan


@pytest.mark.parametrize("turn", [("x", (1, 0, 2), (1, -1, 1)), ("z", (0, 2, 1), (1, -1, 1))], ids=lambda turn: turn[0])
def test_a_turned_mesh_looks_the_same_with_its_axis_up(turn):
    axis, order, signs = turn
    mesh = load_target("cow")
    other = Mesh(mesh.verts[:, order] * signs, mesh.faces)
    assert np.linalg.det(np.eye(3)[:, order] * signs) == pytest.approx(1.0)  # a rotation
    upright, turned = camera_of(mesh, "y"), camera_of(other, axis)
    np.testing.assert_allclose(turned.project(other.verts), upright.project(mesh.verts), atol=1e-9)
    assert not is_turned(other, axis)


def test_a_mesh_without_faces_is_not_turned(tmp_path):
    assert not is_turned(Mesh(load_mesh(ellipsoid(tmp_path)).verts, []), "auto")
