"""Single meshes on the command line: what works, and what is refused in one line with exit code 2."""

import json
import re

import numpy as np
import pytest

from meshfit.mesh.io.files import FORMATS, encode_mesh, load_mesh, load_polygons, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron, quad_cube
from meshfit.subdivision.refine import subdivide
from tests.cli import invoke, refused

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(octahedron(), tmp_path / "solid.ply")
    return tmp_path


@pytest.mark.parametrize("suffix", FORMATS)
def test_subdivide_reads_and_writes_every_format(folder, suffix):
    save_mesh(octahedron(), folder / f"in{suffix}")
    ran = invoke("subdivide", f"in{suffix}", f"out{suffix}", "--levels", 2)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out == f"out{suffix}: 8 faces → 128 faces, 66 vertices\n"
    found = load_mesh(folder / f"out{suffix}")
    expected = subdivide(load_mesh(folder / f"in{suffix}"), "loop", 2)
    assert (found.num_verts, found.num_faces) == (66, 128)
    order = [np.lexsort(np.round(mesh.verts, 5).T) for mesh in (found, expected)]
    assert np.allclose(found.verts[order[0]], expected.verts[order[1]], atol=1e-6)


def test_subdivide_takes_the_schemes_parameters(folder):
    assert invoke("subdivide", "solid.ply", "a.ply", "-s", "interp-loop", "--alpha", "0.5", "-n", "1").code == 0
    assert invoke("subdivide", "solid.ply", "b.ply", "-s", "interp-loop:alpha=0.5").code == 0
    assert (folder / "a.ply").read_bytes() == (folder / "b.ply").read_bytes()
    assert np.array_equal(load_mesh("a.ply").verts, subdivide(octahedron(), "interp-loop", 1, alpha=0.5).verts)


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_subdivide_takes_polygons_and_writes_polygons_where_the_scheme_does(folder, suffix):
    save_mesh(quad_cube(), folder / f"in{suffix}")
    ran = invoke("subdivide", f"in{suffix}", f"out{suffix}", "-s", "catmull-clark", "-n", 2)
    assert (ran.code, ran.err, ran.out) == (0, "", f"out{suffix}: 6 faces → 96 faces, 98 vertices\n")
    found, expected = load_polygons(folder / f"out{suffix}"), subdivide(quad_cube(), "catmull-clark", 2)
    assert np.array_equal(found.verts, expected.verts)
    assert np.array_equal(found.corners, expected.corners)
    assert invoke("subdivide", f"in{suffix}", "out.stl", "-s", "doo-sabin").code == 0
    assert load_mesh("out.stl").num_faces == 8 + 2 * (6 + 12)
    ran = invoke("subdivide", f"in{suffix}", f"out{suffix}")
    assert ran.out == f"out{suffix}: 12 faces → 48 faces, 26 vertices\n"


def test_level_0_only_converts(folder):
    assert invoke("subdivide", "solid.ply", "a.off", "-n", "0").code == 0
    assert np.array_equal(load_mesh("a.off").verts, octahedron().verts)


def test_what_was_mended_is_told_on_stderr_and_the_work_is_done(folder):
    (folder / "in.obj").write_text(OBJ + "f 1 2 4\nv 9 9 9\n")
    ran = invoke("subdivide", "in.obj", "out.ply")
    assert ran.code == 0
    assert ran.err == "warning: in.obj: dropped 1 duplicate face; dropped 1 unreferenced vertex\n"
    assert load_mesh("out.ply").num_faces == 16


BAD_SUBDIVISIONS = {
    ("solid.ply", "out.ply", "-s", "ternary"): "error: this scheme needs quads: face 0 has 3 corners; catmull-clark, ",
    ("solid.ply", "out.ply", "-s", "kobbelt", "--alpha", "1"): "error: scheme 'kobbelt' has no parameter 'alpha'",
    ("gone.obj", "out.ply"): "error: gone.obj: no such file",
    (".", "out.ply"): "error: .: expected a file, got a directory; did you mean 'solid.ply'?",
    ("buny", "out.ply"): "error: 'buny' is neither a target nor a file: did you mean 'bunny'? allowed: bunny, ",
    ("solid.ply", "out.xyz"): "error: out.xyz: unknown mesh format '.xyz'; allowed: .obj, .ply, ",
    ("solid.ply", "out"): "error: out: no suffix to tell the mesh format; allowed: .obj, ",
    ("solid.ply", "gone/out.ply"): "error: gone/out.ply: cannot be written: there is no folder gone; create it",
    ("solid.ply", "out.ply", "-n", "-1"): "error: Invalid value for '--levels'",
    ("solid.ply", "out.ply", "-n", "11"): "error: Invalid value for '--levels'",
    ("solid.ply", "out.ply", "-n", "two"): "error: Invalid value for '--levels'",
    ("solid.ply", "out.ply", "-s", "lop"): "error: 'lop' is not a scheme: did you mean 'loop'?",
    ("solid.ply", "out.ply", "--alpha", "1"): "error: scheme 'loop' has no parameter 'alpha': allowed: weights",
    ("solid.ply", "out.ply", "-s", "interp-loop", "--alpha", "2"): "error: interp-loop: alpha=2.0 is not allowed: ",
    ("solid.ply", "out.ply", "-s", "interp-loop", "--alpha", "x"): "error: --alpha: expected a number, a file",
    ("solid.ply", "out.ply", "--weights", "best"): "error: loop: weights=best is not allowed: ",
}


@pytest.mark.parametrize("arguments", BAD_SUBDIVISIONS, ids=" ".join)
def test_subdivide_refuses(folder, arguments):
    assert refused("subdivide", *arguments).startswith(BAD_SUBDIVISIONS[arguments])
    assert [path.name for path in folder.iterdir()] == ["solid.ply"]


SHAPES = {
    "three faces at an edge": (
        OBJ + "v 5 5 5\nf 1 2 5\n",
        r"edge (0, 1) has 3 faces; allowed: 1 or 2 (1 such edge)",
    ),
    "a face turned over": (OBJ.replace("f 1 3 2", "f 1 2 3"), "edge (0, 1) has two faces of opposite orientation"),
    "two cones at one tip": (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv -1 0 0\nv 0 -1 0\nf 1 2 3\nf 1 4 5\n",
        "vertex 0 joins separate fans of faces (1 such vertex)",
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_subdivide_names_the_place_where_a_mesh_is_no_manifold(folder, shape):
    text, message = SHAPES[shape]
    (folder / "in.obj").write_text(text)
    ran = invoke("subdivide", "in.obj", "out.ply", "--repair", "refuse")
    assert (ran.code, ran.out) == (2, "")
    *warned, error = ran.err.splitlines()
    assert all(line.startswith("warning: in.obj: ") for line in warned)
    assert error.startswith(f"error: subdivision needs a manifold mesh: {message}")
    assert not (folder / "out.ply").exists()


BINARY = encode_mesh(octahedron(), ".ply")
BAD_FILES = {
    "empty.ply": (b"", "the file is empty"),
    "blank.obj": (b" \n\t\n", "the file is empty"),
    "garbage.glb": (bytes(range(256)), "cannot be read as GLB: "),
    "garbage.stl": (bytes(range(256)), "cannot be read as STL: "),
    "cut.ply": (BINARY[:-5], "cannot be read as PLY: the file ends within 'face', of which it announces 8"),
    "text.off": (b"hello", "cannot be read as OFF: line 1: expected 'OFF'"),
    "model.fbx": (b"Kaydara FBX", "FBX cannot be read; export it as OBJ, PLY or GLB"),
    "nan.obj": (OBJ.replace("v 1", "v nan").encode(), "vertex 1 has a coordinate that is not finite: [nan, 0.0, 0.0]"),
    "index.obj": (
        OBJ.replace("f 1 2 4", "f 1 2 5").encode(),
        "cannot be read as OBJ: line 6: a face with vertex 5, but the",
    ),
    "flat.obj": (b"v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n", "no face has an area ("),
}


@pytest.mark.parametrize("command", ["subdivide", "measure result", "measure target", "run target", "run source"])
@pytest.mark.parametrize("name", BAD_FILES)
def test_every_command_refuses_a_bad_file_alike(folder, name, command):
    content, message = BAD_FILES[name]
    (folder / name).write_bytes(content)
    arguments = {
        "subdivide": ["subdivide", name, "out.ply"],
        "measure result": ["measure", name, "solid.ply"],
        "measure target": ["measure", "solid.ply", name, "--json"],
        "run target": ["run", "quickstart", "--dry-run", "--set", f"targets=[{name}]"],
        "run source": [
            "run",
            "quickstart",
            "--dry-run",
            "--set",
            f"source.mesh={name}",
            "--set",
            "targets=[solid.ply]",
        ],
    }[command]
    place = folder / name if command.startswith("run") else name
    assert refused(*arguments).startswith(f"error: {place}: {message}")
    assert {path.name for path in folder.iterdir()} == {name, "solid.ply"}


def test_measure_prints_a_table_and_json_of_the_same_figures(folder):
    save_mesh(Mesh(octahedron().verts * 1.25, octahedron().faces), folder / "big.ply")
    ran = invoke("measure", "big.ply", "solid.ply", "--samples", 200)
    assert (ran.code, ran.err) == (0, "")
    assert "big.ply against solid.ply" in ran.out
    found = invoke("measure", "big.ply", "solid.ply", "--samples", 200, "--json")
    assert (found.code, found.err) == (0, "")
    figures = json.loads(found.out)
    assert (figures["result"], figures["target"], figures["normalise"]) == ("big.ply", "solid.ply", "none")
    assert figures["hausdorff"]["symmetric"] == pytest.approx(0.25)
    assert re.search(r"^Hausdorff distance +0\.25$", ran.out, re.MULTILINE)


def test_measure_in_the_targets_frame(folder):
    save_mesh(Mesh(octahedron().verts * 10 + 3, octahedron().faces), folder / "target.ply")
    save_mesh(Mesh(octahedron().verts * 11 + 3, octahedron().faces), folder / "result.ply")
    figures = json.loads(
        invoke("measure", "result.ply", "target.ply", "--samples", 200, "--normalise", "tutorial", "--json").out
    )
    assert figures["hausdorff"]["symmetric"] == pytest.approx(0.1)


@pytest.mark.parametrize("samples", ["99", "0", "-5", "1e3", "many"])
def test_measure_refuses_too_few_samples(folder, samples):
    assert refused("measure", "solid.ply", "solid.ply", "--samples", samples).startswith(
        "error: Invalid value for '--samples'"
    )


def test_measure_refuses_a_frame_that_does_not_exist(folder):
    message = refused("measure", "solid.ply", "solid.ply", "--normalise", "unit")
    assert message.startswith("error: Invalid value for '--normalise'")
    assert "'tutorial', 'box', 'sphere', 'cube', 'none'" in message
