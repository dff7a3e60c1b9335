import importlib

import numpy as np
import pytest

from meshfit.errors import ConfigError
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.report.figures.camera import camera_of
from meshfit.report.figures.colours import DISTANCES, MISSING, ramp, rgb
from meshfit.report.figures.drawing import draw

pytest.importorskip("pyvista")

SIZE = (90, 60)
BALL = icosahedron()
CAMERA = camera_of(BALL)
TRIANGLE = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def opacity(mesh, **how):
    return draw(mesh, camera_of(mesh), size=SIZE, background=None, **how)[:, :, 3]


def hue(colour):
    """A colour without its brightness, which light and shade change."""
    return np.asarray(colour, dtype=float)[..., :3] / np.linalg.norm(
        np.asarray(colour, dtype=float)[..., :3], axis=-1, keepdims=True
    )


def test_the_same_mesh_gives_the_same_picture_with_the_mesh_on_its_background():
    image = draw(BALL, CAMERA, size=SIZE, background="#ff0000")
    assert (image.shape, image.dtype) == ((60, 90, 4), np.uint8)
    assert (image == draw(BALL, CAMERA, size=SIZE, background="#ff0000")).all()
    assert (image[[0, -1]] == [255, 0, 0, 255]).all()
    assert image[30, 45, 2] > 100


def test_a_transparent_picture_covers_what_the_camera_projects():
    covered = opacity(BALL) > 127
    rows, columns = np.nonzero(covered)
    seen = CAMERA.project(BALL.verts) * 30
    assert columns.min() - 45 == pytest.approx(seen[:, 0].min(), abs=1.5)
    assert columns.max() + 1 - 45 == pytest.approx(seen[:, 0].max(), abs=1.5)
    assert 30 - rows.min() == pytest.approx(seen[:, 1].max(), abs=1.5)
    assert 30 - rows.max() - 1 == pytest.approx(seen[:, 1].min(), abs=1.5)


@pytest.mark.parametrize("faces", [[[0, 1, 2]], [[0, 2, 1]]], ids=["from the front", "from the back"])
def test_both_sides_of_an_open_mesh_are_lit_alike(faces):
    image = draw(Mesh(TRIANGLE.verts, faces), camera_of(TRIANGLE), size=SIZE, background=None)
    assert image[image[:, :, 3] == 255][:, :3].min() > 60


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_unit_of_a_mesh_does_not_matter(size):
    assert opacity(Mesh(size * BALL.verts, BALL.faces)).mean() == pytest.approx(opacity(BALL).mean(), rel=0.01)


def test_values_are_shown_in_the_colours_of_distances():
    for place in (0.0, 0.5, 1.0):
        image = draw(BALL, CAMERA, size=SIZE, values=np.full(12, 3 * place), limits=(0.0, 3.0), background=None)
        inside = image[image[:, :, 3] == 255]
        wanted = rgb(ramp(257)[round(256 * place)])
        assert np.abs(hue(inside) - hue(wanted)).max() < 0.06
    missing = draw(BALL, CAMERA, size=SIZE, values=np.full(12, np.nan), background=None)
    assert np.abs(hue(missing[30, 45]) - hue(rgb(MISSING))).max() < 0.02


def test_a_ramp_goes_through_its_colours_and_gets_darker_all_along():
    assert ramp(len(DISTANCES)) == list(DISTANCES)
    light = [rgb(colour) @ np.array([0.2126, 0.7152, 0.0722]) for colour in ramp()]
    assert (np.diff(light) < 0).all()


def test_a_mesh_without_faces_leaves_the_background():
    assert (draw(Mesh([[0, 0, 0]], []), CAMERA, size=SIZE) == 255).all()


def test_edges_darken():
    plain, edged = draw(BALL, CAMERA, size=SIZE), draw(BALL, CAMERA, size=SIZE, edges=True)
    assert edged.mean() < plain.mean() - 1


def test_without_pyvista_the_extra_is_named(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ConfigError, match=r"pip install 'meshfit\[report\]'"):
        draw(BALL, CAMERA)
