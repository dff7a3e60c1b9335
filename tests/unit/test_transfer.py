"""Files of a trial on their way to workers that do not share a folder with this machine."""

import base64
import gzip
import json
import shutil
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest

from meshfit.experiment.plan import plan
from meshfit.experiment.running.worker import pack_inputs, unpack_inputs
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.mesh.attributes import Attributes, Image, Material
from meshfit.mesh.io.files import encode_mesh, load_mesh, load_polygons, save_mesh
from meshfit.mesh.solids import octahedron
from meshfit.mesh.targets import file_sha256, load_target, target_path
from tests.carried import png, require_same, unwrapped_cube
from tests.loops import over
from tests.small import experiment

IMAGE = "images/tëx 1.png"


def write_gltf(folder, name):
    """Write a glTF file whose buffer is a file in a folder beside it."""
    document = json.loads(encode_mesh(octahedron(), ".gltf"))
    (buffer,) = document["buffers"]
    (folder / "buffers").mkdir(parents=True)
    (folder / "buffers" / "a.bin").write_bytes(base64.b64decode(buffer["uri"].partition(",")[2]))
    content = json.dumps(document | {"buffers": [buffer | {"uri": "buffers/a.bin"}]}).encode()
    (folder / name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return folder / name


def write_textured(folder, name):
    """Write a closed mesh whose image is in a folder beside it, under a name with a blank and a letter beyond ASCII."""
    (folder / "images").mkdir(parents=True)
    (folder / IMAGE).write_bytes(png())
    material = Material("painted", texture=Image("image.png", png()))
    cube = unwrapped_cube(triangles=True)
    attributes = Attributes(face={"material": np.zeros(12, int)}, corner=cube.attributes.corner, materials=(material,))
    content = encode_mesh(cube.with_attributes(attributes), Path(name.removesuffix(".gz")).suffix)
    if "obj" in name:
        (folder / "a.mtl").write_text(f"newmtl painted\nmap_Kd {IMAGE}\n")
        content = b"mtllib\ta.mtl\n" + content.replace(b"usemtl ", b"usemtl\t")
    elif "ply" in name:
        content = content.replace(b"\nelement", f"\ncomment TextureFile {IMAGE}\nelement".encode(), 1)
    else:
        content = json.dumps(json.loads(content) | {"images": [{"uri": quote(IMAGE)}]}).encode()
    (folder / name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return folder / name


@pytest.mark.parametrize("name", ["a.gltf", "a.gltf.gz"])
def test_the_buffers_of_a_gltf_file_travel_with_it(tmp_path, name):
    path = write_gltf(tmp_path / "meshes", name)
    (trial,) = plan([experiment(tmp_path, targets=[str(path)], source={"mesh": str(path)})])
    here, there = RunDirectory(tmp_path / "here"), RunDirectory(tmp_path / "there")
    files = pack_inputs(trial, here)
    parts = {f"inputs/{role}/{part}" for role in ("target", "source") for part in (name, "buffers/a.bin")}
    assert files.keys() == parts
    shutil.rmtree(tmp_path / "meshes")
    opened = unpack_inputs(trial, files, there, tmp_path / "inputs")
    copy = opened.current_path(str(path))
    assert np.array_equal(load_target(copy).verts, octahedron().verts)
    assert file_sha256(target_path(copy)) == dict(trial.inputs)["target"]


@over("name", ["a.obj", "a.obj.gz", "a.ply", "a.gltf"])
def test_materials_and_images_of_a_source_travel_with_it(tmp_path, name, monkeypatch, recwarn):
    path = write_textured(tmp_path / "meshes", name)
    read, read_bytes = set(), Path.read_bytes
    with monkeypatch.context() as patched:
        patched.setattr(Path, "read_bytes", lambda self: read.add(self) or read_bytes(self))
        whole = load_polygons(path)
    parts = {path.relative_to(tmp_path / "meshes").as_posix() for path in read} | {name, IMAGE}
    (trial,) = plan([experiment(tmp_path, targets=[str(path)], source={"mesh": str(path)})])
    files = pack_inputs(trial, RunDirectory(tmp_path / "here"))
    assert files.keys() == {f"inputs/source/{part}" for part in parts} | {f"inputs/target/{name}"}
    shutil.rmtree(tmp_path / "meshes")
    opened = unpack_inputs(trial, files, RunDirectory(tmp_path / "there"), tmp_path / "inputs")
    there = load_polygons(tmp_path / "inputs" / "source" / name)
    assert opened.current_path(str(path)).startswith(str(tmp_path / "inputs"))
    require_same(there, whole)
    assert [material.texture.content for material in there.attributes.materials] == [png()]
    assert not recwarn.list


def test_looks_are_no_part_of_what_a_source_is(tmp_path):
    path = write_textured(tmp_path, "a.obj")
    before = file_sha256(path)
    (tmp_path / IMAGE).write_bytes(png((1, 2, 3)))
    assert file_sha256(path) == before


def test_a_changed_buffer_is_another_file(tmp_path):
    path = write_gltf(tmp_path, "a.gltf")
    before = file_sha256(path)
    buffer = tmp_path / "buffers" / "a.bin"
    buffer.write_bytes(buffer.read_bytes()[:-4] + b"\1\0\2\0")
    assert file_sha256(path) != before


def test_compressed_files_keep_both_suffixes(tmp_path):
    save_mesh(octahedron(), tmp_path / "solid.obj.gz")
    (trial,) = plan([experiment(tmp_path, targets=[str(tmp_path / "solid.obj.gz")])])
    files = pack_inputs(trial, RunDirectory(tmp_path / "here"))
    assert files.keys() == {"inputs/target/solid.obj.gz"}
    opened = unpack_inputs(trial, files, RunDirectory(tmp_path / "there"), tmp_path / "inputs")
    assert load_mesh(opened.current_path(trial.target)).num_faces == 8
