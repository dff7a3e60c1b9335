import importlib
import json

import numpy as np
import pytest

from meshfit.mesh.files import save_mesh
from meshfit.mesh.solids import icosahedron
from tests.cli import invoke, refused

png = pytest.importorskip("PIL.Image", reason="pictures need pyvista, which brings pillow")
pytest.importorskip("pyvista")


def pixels(path):
    return np.asarray(png.open(path).convert("L"), dtype=float)


def panels(path, count):
    return np.split(pixels(path), count, axis=1)


def test_meshes_are_drawn_side_by_side(tmp_path):
    ran = invoke("render", "bone", "Cow=cow", "-o", tmp_path / "two.png")
    assert (ran.code, ran.err) == (0, "")
    for panel in panels(tmp_path / "two.png", 2):
        drawn = (panel < 250).mean()
        assert 0.03 < drawn < 0.8
        assert panel[:, 0].min() > 250


def test_edges_make_a_picture_darker(tmp_path):
    for name, options in (("plain", []), ("edges", ["--edges"])):
        assert invoke("render", "bone", "-o", tmp_path / f"{name}.png", *options).code == 0
    assert pixels(tmp_path / "edges.png").mean() < pixels(tmp_path / "plain.png").mean() - 1


def test_a_trial_is_drawn_as_source_result_and_target(tmp_path):
    settings = {"targets": ["bone"], "write_frame": "normalised"}
    result = {"scheme": "loop", "target_title": "bone", "settings": settings}
    frame = {"centre": [0.0, 0.0, 0.0], "scale": 1.0}
    (tmp_path / "result.json").write_text(json.dumps(result | {"frame": frame}))
    for name in ("source.ply", "result.ply"):
        save_mesh(icosahedron(), tmp_path / name)
    assert invoke("render", tmp_path, "-o", tmp_path / "three.png").code == 0
    source, fitted, target = panels(tmp_path / "three.png", 3)
    assert (source < 250).mean() == pytest.approx((fitted < 250).mean(), rel=0.05)
    assert (target < 250).any()


def test_what_cannot_be_drawn_is_refused(tmp_path):
    assert "no such file" in refused("render", "nothing.obj", "-o", tmp_path / "x.png")
    assert "no such file" in refused("render", tmp_path, "-o", tmp_path / "x.png").lower()
    assert "x.png" in refused("render", "bone", "-o", tmp_path / "missing" / "x.png")


def test_without_pyvista_the_extra_is_named(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    assert "pip install 'meshfit[report]'" in refused("render", "bone", "-o", tmp_path / "x.png")
