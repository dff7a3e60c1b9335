"""Refusals of unusable mesh files: one line with the path and the fault."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.files import FORMATS, READABLE_FORMATS, encode_mesh, load_mesh
from meshfit.mesh.io.recognition import format_name
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from tests.loops import over

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
OFF = "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
) + OFF.partition("4 4 6\n")[2]
BINARY = encode_mesh(octahedron(), ".ply")


def refusal(path):
    """Return the error message of a file, without its path."""
    with pytest.raises(MeshError) as caught:
        load_mesh(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@over("suffix", FORMATS)
def test_a_file_that_is_not_there(tmp_path, suffix):
    assert refusal(tmp_path / f"gone{suffix}") == f"no such file in {tmp_path}"
    assert refusal(tmp_path / "gone" / f"gone{suffix}") == f"no such file: there is no folder {tmp_path / 'gone'}"
    (tmp_path / f"gane{suffix}").touch()
    assert refusal(tmp_path / f"gone{suffix}") == f"no such file; did you mean '{tmp_path / 'gane'}{suffix}'?"


def test_a_directory(tmp_path):
    (tmp_path / "a.obj").mkdir()
    assert refusal(tmp_path / "a.obj") == "expected a file, got a directory"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read(tmp_path):
    written(tmp_path / "a.obj", OBJ).chmod(0)
    assert refusal(tmp_path / "a.obj") == "cannot be read: Permission denied"


@over("content", ["", " \n\t\r\n  "])
@over("suffix", FORMATS)
def test_an_empty_file(tmp_path, suffix, content):
    assert refusal(written(tmp_path / f"a{suffix}", content)) == "the file is empty"


@over("name", ["a.foo", "a.jpg", "a.PLYX", "a.foo.gz"])
def test_a_format_that_is_not_known(tmp_path, name):
    suffix = Path(name.removesuffix(".gz")).suffix
    content = "0.5 is not a mesh" if name.endswith(".gz") else "\x01"
    message = refusal(written(tmp_path / name, content))
    assert message == f"unknown mesh format '{suffix}'; allowed: {', '.join(READABLE_FORMATS)}"


@over("seed", range(4))
@over("suffix", FORMATS)
def test_garbage(tmp_path, suffix, seed):
    garbage = np.random.default_rng(seed).bytes(int(10 ** (seed + 1)))
    assert refusal(written(tmp_path / f"a{suffix}", garbage)).startswith(f"cannot be read as {format_name(suffix)}: ")


@over("suffix", FORMATS)
def test_prose(tmp_path, suffix):
    message = refusal(written(tmp_path / f"a{suffix}", "Dear all,\nplease find the model attached.\n"))
    assert message.startswith(f"cannot be read as {format_name(suffix)}: ")


@over("suffix", [".ply", ".stl", ".glb"])
def test_a_binary_file_cut_anywhere(tmp_path, suffix):
    content = encode_mesh(octahedron(), suffix)
    for length in {1, 40, 85, len(content) // 3, len(content) // 2, len(content) - 7, len(content) - 1}:
        message = refusal(written(tmp_path / f"a{suffix}", content[:length]))
        assert message.startswith(f"cannot be read as {format_name(suffix)}: "), length


FAULTS = {
    "obj: points only": ("a.obj", OBJ[:32], "expected a surface, got a cloud of 4 points and no faces; reconstruct"),
    "obj: faces only": ("a.obj", OBJ[32:], "cannot be read as OBJ: no vertices in it"),
    "obj: too high": ("a.obj", OBJ.replace("f 3 1 4", "f 3 1 9"), "line 8: a face with vertex 9, but the file has 4"),
    "obj: too far back": ("a.obj", OBJ.replace("f 3 1 4", "f 3 1 -9"), "line 8: a face with vertex -9, but the"),
    "obj: zero": ("a.obj", OBJ.replace("f 1 2 4", "f 0 2 4"), "line 6: a face with vertex 0; OBJ counts from 1"),
    "obj: two corners": ("a.obj", OBJ.replace("f 1 2 4", "f 1 2"), "line 6: expected a face of 3 or more corners"),
    "obj: a word": ("a.obj", OBJ.replace("f 1 2 4", "f 1 two 4"), "line 6: expected integers, got '1 two 4'"),
    "obj: two coordinates": ("a.obj", OBJ.replace("v 1 0 0", "v 1 0"), "line 2: expected a vertex of 3 coordinates"),
    "obj: a comma": ("a.obj", OBJ.replace("v 1 0 0", "v 1,5 0 0"), "line 2: expected three numbers, got '1,5 0 0'"),
    "obj: nan": ("a.obj", OBJ.replace("v 1 0 0", "v 1 nan 0"), "vertex 1 has a coordinate that is not finite: [1.0, n"),
    "obj: infinite": ("a.obj", OBJ.replace("v 1 0 0", "v 1 0 1e999"), "vertex 1 has a coordinate that is not finite"),
    "obj: too large": ("a.obj", OBJ.replace("v 1 0 0", "v 1e61 0 0"), "expected coordinates up to 1e+60, got [1e+61"),
    "obj: all degenerate": ("a.obj", OBJ.replace("0 0 1\n", "0.5 0.5 0\n").replace(" 0 1 0", " 2 0 0")
                            .replace("0.5 0.5", "3 0"), "no face has an area ("),
    "off: points only": ("a.off", OFF.partition("3 0 2 1")[0].replace("4 4", "4 0"), "a cloud of 4 points"),
    "off: too high": ("a.off", OFF.replace("3 2 0 3", "3 2 0 4"), "face 3 is [2, 0, 4], but vertices are numbered"),
    "off: negative": ("a.off", OFF.replace("3 2 0 3", "3 2 0 -1"), "face 3 is [2, 0, -1]"),
    "off: fewer than said": ("a.off", OFF.replace("4 4 6", "4 5 6"), "the file ends after 4 of 5 faces"),
    "off: more than said": ("a.off", OFF.replace("4 4 6", "4 3 6"), "line 10: more lines than the header's 4"),
    "off: short face": ("a.off", OFF.replace("3 2 0 3", "4 2 0 3"), "line 10: expected a face of 4 corners, got 3"),
    "off: no counts": ("a.off", "OFF\n", "line 1: expected the numbers of vertices and faces"),
    "off: four dimensions": ("a.off", "4" + OFF, "line 1: expected 'OFF'"),
    "off: nan": ("a.off", OFF.replace("1 0 0\n", "1 nan 0\n", 1), "vertex 1 has a coordinate that is not finite"),
    "ply: too high": ("a.ply", PLY.replace("3 2 0 3", "3 2 0 4"), "face 3 is [2, 0, 4], but vertices are numbered"),
    "ply: negative": ("a.ply", PLY.replace("3 2 0 3", "3 2 0 -1"), "face 3 is [2, 0, -1]"),
    "ply: fewer than said": ("a.ply", PLY.replace("face 4", "face 5"), "ends within 'face', of which it announces 5"),
    "ply: more than said": ("a.ply", PLY.replace("face 4", "face 3"), "announces 3 of 'face', but the file has 4"),
    "ply: no z": ("a.ply", PLY.replace("double z", "double w"), "'vertex' has no property 'z'"),
    "ply: no indices": ("a.ply", PLY.replace("vertex_indices", "corners"), "'face' has no property 'vertex_indices'"),
    "ply: a negative list": ("a.ply", PLY.replace("uchar", "char").replace("3 2 0 3", "-3 2 0 3"), "a list of -3"),
    "ply: unknown type": ("a.ply", PLY.replace("double y", "quad y"), "its header: 'property quad y'"),
    "ply: no format": ("a.ply", PLY.replace("format ascii 1.0\n", ""), "its header has no 'format' line"),
    "ply: points only": ("a.ply", PLY.partition("3 0 2 1")[0].replace("face 4", "face 0"), "a cloud of 4 points"),
    "ply: nan": ("a.ply", PLY.replace("1 0 0\n", "nan 0 0\n", 1), "vertex 1 has a coordinate that is not finite"),
    "ply: more binary faces": ("a.ply", BINARY.replace(b"face 8", b"face 7"), "announces 7 of 'face', but the"),
}  # fmt: skip


@over("fault", FAULTS)
def test_the_fault_is_named(tmp_path, fault):
    name, content, expected = FAULTS[fault]
    assert re.search(re.escape(expected), refusal(written(tmp_path / name, content)))


@over("value", [np.nan, np.inf, -np.inf])
@over("suffix", [".ply", ".obj", ".off"])
def test_coordinates_that_are_not_finite_are_refused_in_every_format(tmp_path, suffix, value):
    verts = np.array(octahedron().verts)
    verts[3, 1] = value
    content = encode_mesh(Mesh(verts, octahedron().faces), suffix)
    assert "a coordinate that is not finite" in refusal(written(tmp_path / f"a{suffix}", content))


@over("value", [np.nan, np.inf, -np.inf])
def test_coordinates_that_are_not_finite_are_refused_in_stl(tmp_path, value):
    content = encode_mesh(octahedron(), ".stl")
    first_coordinate = 84 + 12
    damaged = content[:first_coordinate] + np.float32(value).tobytes() + content[first_coordinate + 4 :]
    assert "vertex 0 has a coordinate that is not finite" in refusal(written(tmp_path / "a.stl", damaged))
