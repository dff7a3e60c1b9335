import json

import numpy as np
import pytest

from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.camera import MARGIN
from meshfit.report.figures.render import cameras_of, collect_meshes
from meshfit.report.tables.heads import FRAMES

BALL = icosahedron()
LARGE = Mesh(3.0 * BALL.verts, BALL.faces)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(BALL, tmp_path / "ball.ply")
    save_mesh(LARGE, tmp_path / "large.ply")
    for name in ("one", "two"):
        settings = {"targets": ["bone"], "write_frame": "normalised", "normalise": "tutorial"}
        facts = {"scheme": name, "target_title": "bone", "settings": settings}
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(json.dumps(facts | {"frame": {"centre": [0, 0, 0], "scale": 1}}))
        save_mesh(BALL, tmp_path / name / "source.ply")
        save_mesh(LARGE if name == "two" else BALL, tmp_path / name / "result.ply")
    return tmp_path


def test_all_meshes_of_a_target_have_its_camera_and_are_in_the_picture(folder):
    row, label = collect_meshes(["one", "Second=two"])
    assert [one.title for one in row] == [
        "source, one", "result, one", "bone", "source, Second", "result, Second", "bone",
    ]  # fmt: skip
    assert label == ""
    cameras = cameras_of(row)
    assert len(set(cameras)) == 1
    reach = max(np.abs(cameras[0].project(one.mesh.verts)[:, :2]).max() for one in row)
    assert reach == pytest.approx(1 - MARGIN)


def test_files_share_the_first_ones_view_and_named_targets_have_their_own(folder):
    row, _ = collect_meshes(["ball.ply", "bone", "large.ply", "cow"])
    first, bone, second, cow = cameras_of(row)
    assert first == second
    assert len({first, bone, cow}) == 3


def test_against_a_target_all_are_seen_from_its_side_and_measured(folder):
    row, label = collect_meshes(["ball.ply", "bone"], "cow")
    assert len(set(cameras_of(row))) == 1
    assert label == f"distance to cow, in {FRAMES['tutorial']}"
    assert all(one.against is row[0].viewed_like for one in row)
    row, label = collect_meshes(["ball.ply"], "large.ply")
    assert label == "distance to large, in the unit of the target's file"
    row, _ = collect_meshes(["one"], "bone")
    assert [one.against is not None for one in row] == [False, True, False]
