import importlib
import json

import numpy as np
import pytest

from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.solids import icosahedron
from tests.cli import answered, invoke, refused

png = pytest.importorskip("PIL.Image", reason="pictures need pyvista, matplotlib and pillow")
pytest.importorskip("pyvista")
pytest.importorskip("matplotlib")


OWN = Frame((0.0, 0.0, 0.0), 1.0)


SMALL = ("--size", 150)


def pixels(path):
    return np.asarray(png.open(path).convert("L"), dtype=float)


def panels(path, count):
    return np.split(pixels(path), count, axis=1)


def colourful(path):
    image = np.asarray(png.open(path).convert("RGB"), dtype=float)
    return ((image.max(axis=2) - image.min(axis=2)) > 60).mean()


def write_trial(folder, target="bone", frame=OWN, **settings):
    settings = {"targets": [target], "write_frame": "normalised", "normalise": "tutorial"} | settings
    result = {"scheme": "loop", "target_title": "bone", "settings": settings}
    place = {"centre": list(frame.centre), "scale": frame.scale}
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(json.dumps(result | {"frame": place}))
    for name in ("source.ply", "result.ply"):
        save_mesh(icosahedron(), folder / name)
    return folder


def test_meshes_are_drawn_side_by_side(tmp_path):
    assert answered("render", "bone", "Cow=cow", "-o", tmp_path / "two.png") == f"wrote {tmp_path / 'two.png'}\n"
    for panel in panels(tmp_path / "two.png", 2):
        drawn = (panel < 250).mean()
        assert 0.03 < drawn < 0.8
        assert panel[:, 0].min() > 250


def test_edges_make_a_picture_darker(tmp_path):
    for name, options in (("plain", []), ("edges", ["--edges"])):
        assert invoke("render", "bone", "-o", tmp_path / f"{name}.png", *options, *SMALL).code == 0
    assert pixels(tmp_path / "edges.png").mean() < pixels(tmp_path / "plain.png").mean() - 1


def test_a_trial_is_drawn_as_source_result_and_target(tmp_path):
    write_trial(tmp_path)
    answered("render", tmp_path, "-o", tmp_path / "three.png")
    source, fitted, target = panels(tmp_path / "three.png", 3)
    assert (source < 250).mean() == pytest.approx((fitted < 250).mean(), rel=0.05)
    assert (target < 250).any()
    assert colourful(tmp_path / "three.png") == 0


@pytest.mark.slow
def test_a_trial_looks_the_same_in_whichever_frame_it_was_written(tmp_path):
    frame = Frame((1.0, -2.0, 3.0), 2.5)
    save_mesh(frame.restore(Mesh(icosahedron().verts * [1.0, 0.8, 0.5], icosahedron().faces)), tmp_path / "target.ply")
    own, other = (write_trial(tmp_path / name, str(tmp_path / "target.ply"), frame) for name in ("own", "other"))
    write_trial(other, str(tmp_path / "target.ply"), frame, write_frame="target")
    for name in ("source.ply", "result.ply"):
        save_mesh(frame.restore(icosahedron()), other / name)
    for folder in (own, other):
        answered("render", folder, "-o", tmp_path / f"{folder.name}.png", "--against", tmp_path / "target.ply")
    assert np.abs(pixels(tmp_path / "own.png") - pixels(tmp_path / "other.png")).mean() < 0.1


def test_against_a_target_meshes_get_the_colours_of_their_distances(tmp_path):
    save_mesh(icosahedron(), tmp_path / "ball.ply")
    save_mesh(Mesh(1.3 * icosahedron().verts, icosahedron().faces), tmp_path / "large.ply")
    picture = tmp_path / "x.png"
    answered("render", tmp_path / "large.ply", "-o", picture)
    assert colourful(picture) == 0
    answered("render", tmp_path / "ball.ply", tmp_path / "large.ply", "-o", picture, "--against", tmp_path / "ball.ply")
    image = np.asarray(png.open(picture).convert("RGB"), dtype=float)
    near, far = (half[200:320, 200:320].mean(axis=(0, 1)) for half in np.split(image, 2, axis=1))
    assert near.sum() > far.sum() + 100  # from light, where there is no distance, to dark
    assert colourful(picture) > 0.1


@pytest.mark.slow
def test_of_a_trial_only_the_result_is_coloured(tmp_path):
    write_trial(tmp_path)
    answered("render", tmp_path, "-o", tmp_path / "three.png", "--against", "bone")
    image = np.asarray(png.open(tmp_path / "three.png").convert("RGB"), dtype=float)[:520]
    spread = [(part.max(axis=2) - part.min(axis=2)).max() for part in np.split(image, 3, axis=1)]
    assert spread[1] > 60 > max(spread[0], spread[2])


@pytest.mark.parametrize("name", ["open", "triangle", "flat", "tiny"])
def test_meshes_of_any_kind_are_drawn(tmp_path, name):
    ball = icosahedron()
    mesh = {
        "open": Mesh(ball.verts, ball.faces[:12]),
        "triangle": Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
        "flat": Mesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 2, 1], [0, 3, 2]]),
        "tiny": Mesh(1e-6 * ball.verts + 1.0, ball.faces),
    }[name]
    save_mesh(mesh, tmp_path / "mesh.ply")
    picture = tmp_path / "x.png"
    ran = invoke("render", tmp_path / "mesh.ply", "-o", picture, "--against", tmp_path / "mesh.ply", *SMALL)
    assert ran.code == 0
    assert (pixels(picture)[:150] < 240).mean() > 0.03


def test_what_cannot_be_drawn_is_refused(tmp_path):
    assert "no such file" in refused("render", "nothing.obj", "-o", tmp_path / "x.png")
    expected = f"error: {tmp_path}: expected a mesh file or the folder of a complete trial, got another"
    assert refused("render", tmp_path, "-o", tmp_path / "x.png") == expected
    assert "no such file" in refused("render", "bone", "-o", tmp_path / "x.png", "--against", "nothing.obj")
    assert "x.png" in refused("render", "bone", "-o", tmp_path / "missing" / "x.png")
    assert ".jpeg" in refused("render", "bone", "-o", tmp_path / "x.jpeg")
    (tmp_path / "folder.png").mkdir()
    assert "folder.png" in refused("render", "bone", "-o", tmp_path / "folder.png")
    (tmp_path / "trial").mkdir()
    (tmp_path / "trial" / "result.json").write_text("{}")
    assert "frame" in refused("render", tmp_path / "trial", "-o", tmp_path / "x.png")


def test_distances_in_different_units_share_no_scale(tmp_path):
    trials = [write_trial(tmp_path / how, normalise=how) for how in ("tutorial", "box")]
    assert "share a scale" in refused("render", *trials, "-o", tmp_path / "x.png", "--against", "bone")


@pytest.mark.parametrize("library", ["pyvista", "matplotlib"])
def test_without_a_library_the_extra_is_named(tmp_path, monkeypatch, library):
    there = importlib.import_module

    def missing(name, package=None):
        if name.partition(".")[0] == library:
            raise ImportError(name)
        return there(name, package)

    monkeypatch.setattr(importlib, "import_module", missing)
    message = refused("render", "bone", "-o", tmp_path / "x.png")
    assert f"{library}, which is not installed: pip install 'meshfit[report]'" in message


def pyramid(*turn):
    base = [[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [0.3, 2, 0.2]]
    faces = [[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]]
    return Mesh(np.array(base, float) @ np.array(turn, float) if turn else np.array(base, float), faces)


UPRIGHT = pyramid([1, 0, 0], [0, 0, 1], [0, -1, 0])


def test_a_mesh_that_stands_along_z_is_shown_upright_and_this_is_said(tmp_path):
    save_mesh(pyramid(), tmp_path / "y.ply")
    save_mesh(UPRIGHT, tmp_path / "z.ply")
    for name in ("y", "z"):
        ran = invoke("render", f"a={tmp_path / name}.ply", "-o", tmp_path / f"{name}.png", "--size", 120)
        assert ("z up" in ran.err) == (name == "z")
    answered("render", f"a={tmp_path}/z.ply", "-o", tmp_path / "lying.png", "--size", 120, "--up", "y")
    standing, guessed, lying = (pixels(tmp_path / f"{name}.png") for name in ("y", "z", "lying"))
    assert np.abs(standing - guessed).mean() < 0.1
    assert np.abs(standing - lying).mean() > 5


@pytest.mark.slow
def test_pictures_wrap_and_have_their_size_view_and_background(tmp_path):
    meshes, picture = ["bone"] * 5, tmp_path / "x.png"
    answered("render", *meshes, "-o", picture, "--size", "90x60")
    assert pixels(picture).shape[1] == 3 * 90  # in two lines, rather than four and one
    answered("render", *meshes, "-o", picture, "--size", "90x60", "--columns", 2, "--background", "black")
    assert pixels(picture).shape[1] == 2 * 90
    assert pixels(picture)[0].max() < 5
    answered("render", "bone", "-o", picture, "--size", 90, "--background", "transparent", "--view", "front")
    with png.open(picture) as image:
        assert np.asarray(image.convert("RGBA"))[0, :, 3].max() == 0
    for view in ("front", "0,0"):
        answered("render", "bone", "-o", tmp_path / f"{view}.png", "--size", 90, "--view", view)
    assert (tmp_path / "front.png").read_bytes() == (tmp_path / "0,0.png").read_bytes()


def test_wrong_sizes_views_and_backgrounds_are_refused(tmp_path):
    for option, value in (
        ("--size", "0"),
        ("--size", "9e9"),
        ("--view", "askew"),
        ("--view", "1,2,3"),
        ("--view", "0,95"),
    ):
        assert value in refused("render", "bone", "-o", tmp_path / "x.png", option, value)
    assert "blueish" in refused("render", "bone", "-o", tmp_path / "x.png", "--background", "blueish")
