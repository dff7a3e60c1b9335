import json

import numpy as np
import pytest

from meshfit.images.files import load_views
from tests.cli import answered, refused

pytest.importorskip("PIL", reason="images need pillow")


def test_views_of_a_mesh_are_written_as_a_folder(tmp_path):
    out = answered(
        "views", "bone", "-o", tmp_path / "photos", "--count", 3, "--size", 32, "--depth", "png", "--normals"
    )
    assert out.startswith(f"wrote {tmp_path / 'photos'}: 3 views, masks, depth, normals, 32 × 32 pixels\n")
    views = load_views(tmp_path / "photos").views
    assert views.names == ["view-00", "view-01", "view-02"]
    assert views.have_depth
    assert views.have_normals
    for view in views:
        assert 0.02 < view.mask.mean() < 0.9
        assert not view.mask[[0, -1]].any()
        assert np.isfinite(view.depth[view.mask]).all()
    answered("views", "bone", "-o", tmp_path / "others", "--count", 2, "--size", 32, "--kind", "orthographic")
    again = load_views(tmp_path / "others").views
    assert {view.camera.kind for view in again} == {"orthographic"}
    assert not again.have_depth


def test_views_are_refused_without_a_folder_or_a_mesh(tmp_path):
    (tmp_path / "file").write_text("")
    assert "expected a folder, got a file" in refused("views", "bone", "-o", tmp_path / "file")
    (tmp_path / "points.xyz").write_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n")
    assert "points" in refused("views", tmp_path / "points.xyz", "-o", tmp_path / "out")


def test_images_that_are_there_are_replaced_on_request_and_none_are_left(tmp_path):
    folder = tmp_path / "photos"
    answered("views", "bone", "-o", folder, "--count", 4, "--size", 32, "--depth", "npy", "--normals")
    (folder / "images/mine.png").write_text("not in the list")
    before = sorted(folder.rglob("*"))
    message = refused("views", "bone", "-o", folder, "--count", 2, "--size", 32)
    assert "has images already; give another name, or replace them with --force" in message
    assert sorted(folder.rglob("*")) == before
    answered("views", "bone", "-o", folder, "--count", 2, "--size", 32, "--force")
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert left == ["images/mine.png", "images/view-00.png", "images/view-01.png", "transforms.json"]
    changed = json.loads((folder / "transforms.json").read_text())
    changed["frames"][0]["file_path"] = "../kept.png"
    (folder / "transforms.json").write_text(json.dumps(changed))
    (tmp_path / "kept.png").write_text("outside")
    answered("views", "bone", "-o", folder, "--count", 1, "--size", 32, "--force")
    assert (tmp_path / "kept.png").is_file()
    (folder / "transforms.json").write_text("{")
    assert "transforms.json" in refused("views", "bone", "-o", folder, "--count", 1, "--size", 32, "--force")
