import base64
import gzip
import json
import re
import struct

import pytest

from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.solids import icosahedron
from tests.cli import answered, invoke, refused
from tests.cli.test_render import UPRIGHT
from tests.runs import complete

pytest.importorskip("jinja2", reason="pages need the extra `report`")
pytest.importorskip("pyvista")


def scenes(path):
    """The heads of the scenes of a page, as its script reads them."""
    found = re.findall(r'<script type="text/plain" id="data-[^"]*">([^<]*)</script>', path.read_text())
    contents = [gzip.decompress(base64.b64decode(text)) for text in found]
    return [json.loads(content[4 : 4 + struct.unpack("<I", content[:4])[0]]) for content in contents]


def test_meshes_share_a_scene_and_have_colours_of_their_distances(tmp_path):
    ball, page = icosahedron(), tmp_path / "view.html"
    save_mesh(ball, tmp_path / "a.ply")
    assert "wrote" in answered("view", tmp_path / "a.ply", f"Other={tmp_path / 'a.ply'}", "-o", page)
    (scene,) = scenes(page)
    assert [sorted(mesh["arrays"]) for mesh in scene["meshes"]] == [["faces", "verts"]] * 2
    assert "<b>Other</b>" in page.read_text()
    assert "src=" not in page.read_text()
    answered("view", tmp_path / "a.ply", "bone", "cow", "-o", page)
    assert [len(scene["meshes"]) for scene in scenes(page)] == [1, 1, 1]  # each named target has a view of its own
    answered("view", tmp_path / "a.ply", "-o", page, "--against", tmp_path / "a.ply")
    ((mesh,),) = (scene["meshes"] for scene in scenes(page))
    assert "values" in mesh["arrays"]


def test_a_run_directory_shows_the_target_and_each_result(tmp_path):
    for scheme in ("loop", "interp-loop"):
        folder = complete(tmp_path / "run", "bone", scheme)
        for name in ("source.ply", "result.ply"):
            save_mesh(icosahedron(), folder / name)
    answered("view", tmp_path / "run", "-o", tmp_path / "view.html")
    (scene,) = scenes(tmp_path / "view.html")
    assert len(scene["meshes"]) == 3


def test_without_an_output_the_page_is_opened(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    monkeypatch.setattr("tempfile.mkdtemp", lambda **_: str(tmp_path))
    answered("view", "bone")
    assert opened == [(tmp_path / "view.html").as_uri()]


def test_what_cannot_be_shown_is_refused(tmp_path):
    assert "no such file" in refused("view", "nothing.obj", "-o", tmp_path / "x.html")
    assert "no folder" in refused("view", "bone", "-o", tmp_path / "missing" / "x.html")


def test_a_mesh_that_stands_along_z_is_shown_upright_and_this_is_said(tmp_path):
    save_mesh(UPRIGHT, tmp_path / "z.ply")
    ran = invoke("view", tmp_path / "z.ply", "-o", tmp_path / "x.html")
    assert "z up, guessed by the base: z" in ran.err
    (scene,) = scenes(tmp_path / "x.html")
    assert max(map(abs, scene["axes"][1])) == scene["axes"][1][2]
    ran = invoke("view", tmp_path / "z.ply", "-o", tmp_path / "x.html", "--up", "y")
    assert "guessed" not in ran.err
