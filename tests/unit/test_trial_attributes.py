"""Attributes of the meshes of a trial: stored beside them, given back by `save`, and named where they cannot be."""

import io
import zipfile

import numpy as np
import pytest

from meshfit.errors import MeshfitWarning
from meshfit.experiment.source import build_source
from meshfit.experiment.storage.attributes import encode_attributes, with_attributes
from meshfit.experiment.storage.targets import read_written_mesh
from meshfit.experiment.trial_status import TrialStatus
from meshfit.mesh.attributes import Attributes, Image, Material
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.cli import invoke
from tests.unit.test_trial_runner import prepared, run_trial

pytestmark = pytest.mark.usefixtures("without_shape_checks")


def png() -> bytes:
    from PIL import Image as Picture

    content = io.BytesIO()
    Picture.new("RGB", (2, 2), (200, 40, 40)).save(content, "PNG")
    return content.getvalue()


def template() -> Mesh:
    """A small ball with a texture cut along a meridian, two materials and a skin."""
    mesh = subdivide(octahedron(), "midpoint", 1)
    x, y, z = mesh.verts[mesh.faces.reshape(-1)].T
    u = np.arctan2(y, x) / (2 * np.pi) + 0.5
    wraps = np.ptp(u.reshape(-1, 3), axis=1).repeat(3) > 0.5
    u = np.float32(u + (wraps & (u < 0.5)))
    high = (mesh.verts[mesh.faces][:, :, 2].mean(axis=1) > 0).astype(np.int64)
    materials = (Material("low", (0.1, 0.2, 0.3, 1.0)), Material("high", texture=Image("spots.png", png())))
    attributes = Attributes(
        face={"material": high}, corner={"uv": np.stack([u, np.float32(z)], axis=1)}, materials=materials
    )
    return mesh.with_attributes(attributes)


@pytest.fixture
def fitted(tmp_path, monkeypatch):
    """A trial from a template in a GLB file, its folder and its result."""
    monkeypatch.chdir(tmp_path)
    save_mesh(template(), "template.glb")
    source = {"mesh": str(tmp_path / "template.glb"), "levels": 1}
    trial, store, folder = prepared(tmp_path, fit={"steps": 2}, source=source)
    assert run_trial(trial, store, lambda _: None).status is TrialStatus.COMPLETE
    return trial, store.result(trial), folder


def test_a_result_is_saved_with_texture_and_materials(fitted, tmp_path):
    trial, result, folder = fitted
    source = build_source(trial.settings.source, "loop")
    dressed = with_attributes(read_written_mesh(folder / "result.ply"), folder / "result.ply", result)
    for name, rows in source.attributes.corner.items():
        assert dressed.attributes.corner[name].tobytes() == rows.tobytes()
    for what in ("result", "source"):
        ran = invoke("save", folder, "-o", "x.glb", "--what", what)
        assert (ran.code, ran.err) == (0, "")
        found = load_mesh("x.glb").attributes
        assert [material.name for material in found.materials] == ["low", "high"]
        assert found.materials[1].texture.content == template().attributes.materials[1].texture.content
        assert np.bincount(found.face["material"]).tolist() == [64, 64]
        assert len(np.unique(found.corner["uv"], axis=0)) == len(np.unique(source.attributes.corner["uv"], axis=0))


def test_a_source_that_is_gone_or_changed_is_named(fitted, tmp_path):
    _, result, folder = fitted
    path = tmp_path / "template.glb"
    save_mesh(octahedron(), path)
    ran = invoke("save", folder, "-o", "x.ply")
    assert ran.code == 0
    assert f"left out the materials of result.ply: {path} has changed since the fit" in " ".join(ran.err.split())
    path.unlink()
    with pytest.warns(MeshfitWarning, match="left out the materials of result.ply: .*template.glb"):
        mesh = with_attributes(read_written_mesh(folder / "result.ply"), folder / "result.ply", result)
    assert set(mesh.attributes.corner) == {"uv"}
    assert not mesh.attributes.face


def test_a_damaged_file_is_named_and_the_shape_is_kept(fitted):
    _, result, folder = fitted
    file = folder / "result.attributes.npz"
    for content in (b"", file.read_bytes()[:200], b"no archive"):
        file.write_bytes(content)
        with pytest.warns(MeshfitWarning, match=r"damaged; the attributes of result.ply are left out"):
            mesh = with_attributes(read_written_mesh(folder / "result.ply"), folder / "result.ply", result)
        assert not mesh.attributes


def test_the_same_attributes_are_the_same_bytes_without_a_time():
    content = encode_attributes(template().attributes)
    assert content == encode_attributes(template().attributes)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_a_decimated_source_keeps_what_it_carries(fitted):
    trial, _, _ = fitted
    settings = trial.settings.source.model_copy(update={"decimate": 20, "levels": 0})
    mesh = build_source(settings, "loop")
    assert mesh.num_faces <= 20
    uv = mesh.attributes.corner["uv"].reshape(-1, 3, 2)
    away = np.abs(uv[:, :, 1] - mesh.verts[mesh.faces][:, :, 2])  # less than that of a face; beyond a seam, at the seam
    assert np.median(away) < 0.01
    assert away.max() < 1.0
    assert set(np.unique(mesh.attributes.face["material"])) == {0, 1}
