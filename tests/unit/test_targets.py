"""Named targets: contents, hashes, and errors for missing ones."""

import dataclasses
import shutil
import warnings

import pytest

from meshfit.errors import MeshError
from meshfit.mesh import targets
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.manifold import euler_number, num_components
from meshfit.mesh.solids import cube
from meshfit.mesh.targets import NAMED_TARGETS, file_sha256, load_target, target_path, target_title
from meshfit.mesh.topology import Topology
from tests.loops import over

COUNTS = {
    "bunny": (28088, 56172, 2),
    "mousehead": (6186, 12368, 2),
    "cow": (2904, 5804, 2),
    "bone": (1513, 3022, 2),
    "airplane": (5400, 10796, 2),
}


def test_every_target_is_tested_here():
    assert COUNTS.keys() == NAMED_TARGETS.keys()


@pytest.mark.parametrize("name", COUNTS)
def test_named_targets_load_in_silence_and_are_what_they_were(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = load_target(name)
    topology = Topology.of(mesh)
    assert (mesh.num_verts, mesh.num_faces, euler_number(topology)) == COUNTS[name]
    assert topology.is_watertight
    assert num_components(topology) == 1


@pytest.mark.parametrize("name", COUNTS)
def test_files_of_named_targets_have_the_hash_of_the_table(name):
    assert file_sha256(target_path(name)) == NAMED_TARGETS[name].sha256


def said_of(target):
    with pytest.raises(MeshError) as caught:
        target_path(target)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_another_file_under_a_targets_name_is_refused(monkeypatch, tmp_path):
    save_mesh(cube(), tmp_path / "mousehead.ply")
    monkeypatch.setattr(targets, "bundled_folder", lambda folder: {"data": tmp_path}[folder])
    found, expected = file_sha256(tmp_path / "mousehead.ply")[:12], NAMED_TARGETS["mousehead"].sha256[:12]
    path = tmp_path / "mousehead.ply"
    assert said_of("mousehead") == (
        f"target 'mousehead': {path} is not the expected file (expected sha256 {expected}…, got {found}…)"
    )


def test_a_missing_bundled_file_asks_to_reinstall(monkeypatch, tmp_path):
    monkeypatch.setattr(targets, "bundled_folder", lambda _: tmp_path)
    path = tmp_path / "mousehead.ply"
    assert said_of("mousehead") == (
        f"target 'mousehead': {path} is missing; reinstall meshfit, or give the path of a mesh file"
    )


def test_a_missing_sample_of_the_wheel_names_the_version_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(targets, "_wheel_samples", lambda: tmp_path)
    message = said_of("bunny")
    assert message.startswith(f"target 'bunny': {tmp_path / 'bunny.obj'} is missing; install the pymeshlab version")


def test_without_pymeshlab_its_targets_are_explained(monkeypatch):
    monkeypatch.setattr(targets.importlib.util, "find_spec", lambda _: None)
    assert said_of("cow") == "the named targets come with pymeshlab, which is not installed: pip install pymeshlab"
    assert target_path("mousehead").is_file()


def test_a_slip_of_the_pen_is_answered_with_the_nearest_name():
    assert said_of("buny") == (
        "'buny' is neither a target nor a file: did you mean 'bunny'? allowed: bunny, mousehead, cow, bone, airplane, "
        "or the path of a mesh file"
    )
    assert "did you mean" not in said_of("dragon")


@over("name", ["gone.obj", "gone/bunny"])
def test_what_looks_like_a_path_is_called_a_file(name):
    assert said_of(name).startswith(name)
    assert ": no such file" in said_of(name)


def test_a_directory_is_no_mesh(tmp_path):
    assert said_of(str(tmp_path)) == f"{tmp_path}: expected a file, got a directory"


def test_a_file_is_a_target_too_and_a_name_comes_before_a_file(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    save_mesh(cube(), "mine.off")
    shutil.copy("mine.off", "cow")
    assert load_target("mine.off").num_faces == 12
    assert load_target("cow").num_faces == COUNTS["cow"][1]


def test_titles_are_those_of_the_table_and_stems_of_files():
    assert target_title("mousehead") == "mousehead (stand-in)"
    assert target_title("some/where/head.scan.obj") == "head.scan"


def test_the_table_of_targets_cannot_be_changed_by_accident():
    with pytest.raises(dataclasses.FrozenInstanceError):
        NAMED_TARGETS["bunny"].sha256 = ""


def test_the_hash_of_a_file_that_is_not_there(tmp_path):
    with pytest.raises(MeshError, match="gone: cannot be read: No such file or directory"):
        file_sha256(tmp_path / "gone")
