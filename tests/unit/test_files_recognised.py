"""Files whose content is not what their name says: recognised by their first bytes, with what to do."""

import time
from itertools import product

import numpy as np
import pytest

from meshfit.errors import FormatError, MeshError
from meshfit.mesh.io.files import FORMATS, encode_mesh, load_curves, load_mesh, load_polygons, save_mesh
from meshfit.mesh.io.recognition import format_name, guess, kind_of_suffix, recognise
from meshfit.mesh.solids import octahedron
from tests.cli import invoke, refused
from tests.loops import over

SOLID = octahedron()
CONTENT = {suffix: encode_mesh(SOLID, suffix) for suffix, form in FORMATS.items() if form.write is not None}
FACET = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
CORNERS = ["".join("vertex {} {} {}\n".format(*vert) for vert in face) for face in SOLID.verts[SOLID.faces]]
TEXTS = {
    ".stl": f"solid a\n{''.join(map(FACET.format, CORNERS))}endsolid a\n",
    ".ply": "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 8\nproperty list uchar int vertex_indices\nend_header\n"
    + "".join("{} {} {}\n".format(*vert) for vert in SOLID.verts)
    + "".join("3 {} {} {}\n".format(*face) for face in SOLID.faces),
    ".obj": "\ufeff# made by hand\n\nmtllib a.mtl\no a\n"
    + "".join("v {} {} {}\n".format(*vert) for vert in SOLID.verts)
    + "".join("f {} {} {}\n".format(*(face + 1)) for face in SOLID.faces),
}
OTHERS = {
    "an HTML page": (b"\n<!DOCTYPE html>\n<html><body>404</body></html>\n", "download the file itself"),
    "a Git LFS pointer": (
        b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12\n",
        "fetch the mesh with `git lfs pull`",
    ),
    "the error message of a server": (
        b"<?xml version='1.0'?>\n<Error><Code>NoSuchKey</Code></Error>",
        "download the file again",
    ),
    "JSON": (b'{"message": "Not Found"}', "give a mesh file"),
    "FBX": (b"Kaydara FBX Binary  \x00\x1a\x00" + bytes(80), "export it as OBJ, PLY or GLB"),
    "a Blender file": (b"BLENDER-v300" + bytes(80), "export it as OBJ, PLY or GLB"),
    "STEP": (b"ISO-10303-21;\nHEADER;\n", "export a mesh of it, as STL, OBJ or PLY"),
    "a 7z archive": (b"7z\xbc\xaf\x27\x1c\x00\x04", "unpack it first"),
    "text in UTF-16": (TEXTS[".obj"].encode("utf-16"), "save it as UTF-8"),
    "a PNG image": (b"\x89PNG\r\n\x1a\n" + bytes(80), ""),
    "a PDF document": (b"%PDF-1.4\n", ""),
}


def refusal(path, load=load_mesh, **options):
    with pytest.raises(MeshError) as error:
        load(path, **options)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: "), error.value


def contents():
    return [*CONTENT.items(), *((suffix, text.encode()) for suffix, text in TEXTS.items())]


@over("suffix", [*FORMATS, ".dat", ""])
def test_a_format_under_the_suffix_of_another_is_recognised(tmp_path, suffix):
    path = tmp_path / f"Scan.v2{suffix}" if suffix else tmp_path / "scan"
    for own, content in contents():
        path.write_bytes(content)
        if own == suffix or {own, suffix} == {".glb", ".gltf"}:  # one reader takes both
            assert load_mesh(path).num_faces == 8
            continue
        rename = f"its content looks like {format_name(own)}; rename it to '{'Scan.v2' if suffix else 'scan'}{own}'"
        for load in (load_mesh, load_polygons):
            message, error = refusal(path, load)
            assert message.replace(f", not {format_name(suffix)}", "").endswith(rename)
            assert isinstance(error, FormatError)
            assert error.file_format == own[1:]
        assert load_mesh(path, file_format=own[1:].upper()).num_faces == 8


def test_a_format_that_is_given_wrong(tmp_path):
    for (own, content), given in product(contents(), ("ply", ".OBJ")):
        if own != f".{given.lower().removeprefix('.')}":
            path = tmp_path / f"a{own}"
            path.write_bytes(content)
            message, error = refusal(path, file_format=given)
            wrong = given.upper().removeprefix(".")
            assert message == f"its content looks like {format_name(own)}, not {wrong}"
            assert error.file_format == own[1:]


@over("kind", OTHERS)
def test_what_is_no_mesh_is_recognised_under_any_name(tmp_path, kind):
    content, remedy = OTHERS[kind]
    ending = f"; {remedy}" if remedy else ""
    for suffix in CONTENT:
        (tmp_path / f"a{suffix}").write_bytes(content)
        message, _ = refusal(tmp_path / f"a{suffix}")
        assert message == f"its content looks like {kind}, not {format_name(suffix)}{ending}"
    (tmp_path / "a.dat").write_bytes(content)
    message, _ = refusal(tmp_path / "a.dat")
    assert message.startswith(f"unknown mesh format '.dat'; its content looks like {kind}{ending}")
    assert "--format" not in refused("subdivide", tmp_path / "a.dat", tmp_path / "out.ply")


def test_known_formats_that_are_not_read_are_named_by_their_suffix(tmp_path):
    for suffix, kind in {
        ".fbx": "FBX",
        ".BLEND": "a Blender file",
        ".step": "STEP",
        ".stp": "STEP",
        ".iges": "IGES",
        ".usdz": "USD",
        ".abc": "Alembic",
        ".max": "a 3ds Max file",
        ".c4d": "a Cinema 4D file",
        ".3ds": "3DS",
        ".x3d": "X3D",
        ".wrl": "VRML",
        ".mtl": "the materials of an OBJ",
    }.items():
        path = tmp_path / f"a{suffix}"
        path.write_bytes(b"anything")
        message, error = refusal(path)
        assert message == f"{kind} cannot be read; {kind_of_suffix(suffix.lower()).remedy}"
        assert error.file_format is None
        with pytest.raises(FormatError, match=f"{kind} cannot be written; allowed: .obj, "):
            save_mesh(SOLID, path)
        assert path.read_bytes() == b"anything"


def test_no_format_that_is_read_is_called_unreadable():
    """A suffix that is in both tables is read; its name in messages is one."""
    for suffix in FORMATS:
        kind = kind_of_suffix(suffix)
        assert kind is None or kind.name.replace("GLB", "glTF") == format_name(suffix).replace("GLB", "glTF")


def test_zeros_and_nothing(tmp_path):
    for suffix in FORMATS:
        (tmp_path / f"a{suffix}").write_bytes(bytes(3000))
        message, _ = refusal(tmp_path / f"a{suffix}")
        assert message == "the file holds nothing but zeros; copy or download it again"


def test_signatures_do_not_refuse_what_is_of_the_format(tmp_path):
    """The header of a binary STL may hold any text, and comments of text formats too."""
    for header in (b"solid PLY", b"ply to stl", b"\xff\xfebinary", b"OFF", b"v 1 2 3 ", b'{"asset"', b"{}", b"# OBJ"):
        content = header.ljust(80, b" ") + CONTENT[".stl"][80:]
        (tmp_path / "a.stl").write_bytes(content)
        assert load_mesh(tmp_path / "a.stl").num_faces == 8
        assert recognise(content) is None
    for comment in ("ply", "OFF", "solid", "<html>", "{"):
        (tmp_path / "a.obj").write_text(f"# {comment}\n{TEXTS['.obj'][1:]}", encoding="utf-8")
        assert load_mesh(tmp_path / "a.obj").num_faces == 8
    for comment in ("solid", "v 1 2 3", "<html>"):
        (tmp_path / "a.ply").write_text(TEXTS[".ply"].replace("ascii 1.0\n", f"ascii 1.0\ncomment {comment}\n"))
        assert load_mesh(tmp_path / "a.ply").num_faces == 8


def test_a_parser_keeps_its_word_where_the_content_looks_like_its_own(tmp_path):
    for suffix, content, message in (
        (".obj", b"v 0 0 0\nv 1 0\nf 1 2 3\n", "cannot be read as OBJ: line 2: "),
        (".off", b"OFF\n3 1 0\n0 0 0\n", "cannot be read as OFF: "),
        (".stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "cannot be read as STL: "),
        (".obj", b"targets: [a]\n", "cannot be read as OBJ: no vertices in it"),
        (".off", b"4 4 6\n0 0 0\n1 0 0\n", "cannot be read as OFF: "),
    ):
        (tmp_path / f"a{suffix}").write_bytes(content)
        assert refusal(tmp_path / f"a{suffix}")[0].startswith(message)


def test_a_mesh_that_a_browser_saved_as_text(tmp_path):
    for name in ("scan.obj.txt", "scan.txt", "scan.xyz", "scan.csv"):
        (tmp_path / name).write_text(TEXTS[".obj"], encoding="utf-8")
        message, error = refusal(tmp_path / name)
        wrong = name.rpartition(".")[2].upper()
        assert message == f"its content looks like OBJ, not {wrong}; rename it to 'scan.obj'"
        assert error.file_format == "obj"


def test_curves_are_recognised_too(tmp_path):
    (tmp_path / "a.obj").write_bytes(CONTENT[".ply"])
    assert refusal(tmp_path / "a.obj", load_curves)[0] == ("its content looks like PLY, not OBJ; rename it to 'a.ply'")
    (tmp_path / "a.obj").write_bytes(CONTENT[".stl"])
    assert "STL" not in refusal(tmp_path / "a.obj", load_curves)[0]
    (tmp_path / "a.stl").write_bytes(CONTENT[".stl"])
    assert refusal(tmp_path / "a.stl", load_curves)[0] == "unknown curve format '.stl'; allowed: .obj, .ply"


def test_any_content_is_recognised_or_not_in_no_time():
    """Long rows of one character are what makes regular expressions slow."""
    random = np.random.default_rng(0)
    starts = (b"", b"1 1 ", b"v 1 ", b"ply\n", b"<", b"{", b"OFF", b"solid ", b"#\n", b"\xef\xbb\xbf")
    begin = time.perf_counter()
    for start, row in product(starts, (b"1", b" ", b"\n", b"#\n", b"1 ", b"-1.e", b"<html", b"v 1", b",", b"\0")):
        content = start + row * (70_000 // len(row)) + b"x"
        for text in (content, random.bytes(100) + content):
            recognise(text)
            guess(text, len(text))
    assert time.perf_counter() - begin < 5


def test_point_clouds_are_guessed_by_their_first_row():
    for text in (b"1 2 3\n", b"# x y z\n-.5,1e-3,2.\n", b"\n1;2;3;4;5;6\nx", b"+1\t2 \t3\r\n"):
        assert guess(text, len(text)).name == "a point cloud"
    for text in (b"1 2\n", b"1 2 x\n", b"1-2 3 4\n", b"1 2 3", b"1,,2,3\n\0"):
        assert guess(text, len(text)) is None


def test_guesses_need_no_whole_file():
    assert guess(CONTENT[".stl"][:200], len(CONTENT[".stl"])).name == "STL"
    assert guess(b"", 0) is None


def test_the_command_line_tells_both_ways_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.obj").write_bytes(CONTENT[".ply"])
    message = "error: a.obj: its content looks like PLY, not OBJ; rename it to 'a.ply'"
    assert refused("subdivide", "a.obj", "out.ply") == f"{message}, or give --format ply"
    assert refused("measure", "a.obj", "bone") == message
    assert invoke("subdivide", "a.obj", "out.ply", "--format", "ply").code == 0
