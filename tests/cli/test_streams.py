"""Meshes through pipes, standard input and standard output, in processes of their own where a stream matters."""

import gzip
import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from meshfit.cli.main import main
from meshfit.errors import MeshError
from meshfit.mesh.io.files import FORMATS, READABLE_FORMATS, load_mesh, save_mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.cli import invoke, refused
from tests.cli.processes import ENVIRONMENT
from tests.loops import over
from tests.runs import complete

OBJ = b"v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n" + b"".join(
    b"f %d %d %d\n" % tuple(face + 1) for face in octahedron().faces
)
NAMES, WRITTEN = ([suffix[1:] for suffix in formats] for formats in (READABLE_FORMATS, FORMATS))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.obj").write_bytes(OBJ)
    return tmp_path


@pytest.fixture
def pipe():
    """A function that returns the path of an anonymous pipe with some content, as a shell's `<(…)` does."""
    ends = []

    def opened(content):
        read, write = os.pipe()
        os.write(write, content)
        os.close(write)
        ends.append(read)
        return f"/dev/fd/{read}"

    yield opened
    for end in ends:
        os.close(end)


def run(*arguments, content=b""):
    """Run a command in a process of its own with some content on standard input."""
    command = [sys.executable, "-m", "meshfit", *map(str, arguments)]
    return subprocess.run(command, input=content, env=ENVIRONMENT, capture_output=True, check=False, timeout=120)


def test_a_mesh_from_standard_input_to_standard_output(folder):
    """The bytes on stdout are those of a file, and messages go to stderr."""
    done = run("subdivide", "-", "-", "--format", "obj", "--output-format", "ply", content=gzip.compress(OBJ))
    assert (done.returncode, done.stderr.decode()) == (0, "standard output: 8 faces → 32 faces, 18 vertices\n")
    assert invoke("subdivide", "in.obj", "out.ply").code == 0
    assert done.stdout == (folder / "out.ply").read_bytes()
    assert np.array_equal(load_mesh("out.ply").verts, subdivide(octahedron(), "loop", 1).verts)


def test_standard_input_by_its_path_without_a_format(folder):
    done = run("measure", "/dev/stdin", "in.obj", content=OBJ)
    assert (done.returncode, done.stdout) == (2, b"")
    message = f"error: /dev/stdin: there is no suffix to tell the format; give --format {'|'.join(NAMES)}|xyz|"
    assert done.stderr.decode().startswith(message)


def test_pipes_are_read_with_a_format(folder, pipe):
    for content in (OBJ, gzip.compress(OBJ)):
        ran = invoke("subdivide", pipe(content), "out.off", "--format", "OBJ", "-n", 0)
        assert (ran.code, ran.err, ran.out) == (0, "", "out.off: 8 faces → 8 faces, 6 vertices\n")
    ran = invoke("measure", "in.obj", pipe(OBJ), "--format", "obj", "--samples", 100, "--json")
    assert (ran.code, ran.err) == (0, "")
    path = pipe(OBJ)
    assert refused("subdivide", path, "out.off") == (
        f"error: {path}: there is no suffix to tell the format; give --format {'|'.join(NAMES)}"
    )
    path = pipe(b"ply\nformat ascii 1.0\n")
    message = f"error: {path}: its content looks like PLY, not OBJ; give --format ply"
    assert refused("subdivide", path, "out.off", "--format", "obj") == message


def test_a_named_pipe_with_a_suffix_is_read_as_its_file_would_be(folder):
    os.mkfifo("in.stream.obj")
    writer = threading.Thread(target=(folder / "in.stream.obj").write_bytes, args=(OBJ,))
    writer.start()
    ran = invoke("subdivide", "in.stream.obj", "out.off")
    writer.join()
    assert (ran.code, ran.err, ran.out) == (0, "", "out.off: 8 faces → 32 faces, 18 vertices\n")


def test_values_for_each_vertex_come_from_the_bytes_that_were_read(folder, pipe):
    """`--alpha attribute:NAME` reads the same file again, and a pipe cannot be read twice."""
    rows = "".join(f"{x} {y} {z} 1\n" for x, y, z in octahedron().verts)
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in octahedron().faces)
    header = "ply\nformat ascii 1.0\nelement vertex 6\n" + "".join(f"property double {name}\n" for name in "xyza")
    ply = f"{header}element face 8\nproperty list uchar int vertex_indices\nend_header\n{rows}{faces}".encode()
    options = ["-s", "interp-loop", "--alpha", "attribute:a"]
    assert invoke("subdivide", pipe(ply), "piped.ply", "--format", "ply", *options).code == 0
    (folder / "in.ply.gz").write_bytes(gzip.compress(ply))
    assert invoke("subdivide", "in.ply.gz", "packed.ply", *options).code == 0
    assert invoke("subdivide", "in.obj", "plain.ply", "-s", "interp-loop").code == 0
    expected = load_mesh("plain.ply").verts
    assert np.array_equal(load_mesh("piped.ply").verts, expected)
    assert np.array_equal(load_mesh("packed.ply").verts, expected)


def test_creases_come_from_a_pipe_too(folder, pipe):
    ran = invoke("subdivide", "in.obj", "out.ply", "--creases", pipe(b"0 2\n"))
    assert (ran.code, ran.out) == (0, "out.ply: 8 faces → 32 faces, 18 vertices; 1 sharp edge, 0 corners\n")


def test_where_a_file_is_read_more_than_once_a_pipe_is_refused(folder, pipe):
    once = "can be read only once; save"
    for settings in (["targets=[{}]"], ["targets=[in.obj]", "source.mesh={}"]):
        for path, name in ((pipe(OBJ), "a pipe"), ("'-'", "standard input")):
            changes = [word for setting in settings for word in ("--set", setting.format(path))]
            message = refused("run", "quickstart", "--dry-run", *changes)
            assert f"{name} {once}" in message
            assert "source.mesh: " in message or len(settings) == 1
    path = pipe(OBJ)
    assert refused("render", path, "-o", "out.png").startswith(f"error: {path}: a pipe {once}")


@over("out", ["-", "/dev/stdout"])
def test_standard_output_needs_a_format(folder, out):
    message = f"standard output: there is no suffix to tell the format; give --output-format {'|'.join(WRITTEN)}"
    assert refused("subdivide", "in.obj", out) == f"error: {message}"


def test_formats_that_are_not_there(folder):
    allowed = f"unknown mesh format 'fbx'; allowed: {', '.join(NAMES)}"
    assert refused("subdivide", "in.obj", "out.ply", "--format", "fbx") == f"error: {allowed}"
    allowed = f"unknown mesh format 'fbx'; allowed: {', '.join(WRITTEN)}"
    assert refused("subdivide", "in.obj", "-", "--output-format", "fbx") == f"error: {allowed}"
    curves = "error: unknown curve format 'stl'; allowed: obj, ply"
    assert refused("subdivide", "in.obj", "out.ply", "-s", "four-point", "--format", "stl") == curves
    assert refused("measure", "-", "-", "--format", "obj") == (
        "error: standard input can be only one of RESULT and TARGET"
    )


def test_a_format_serves_a_file_whose_suffix_is_missing_or_wrong(folder):
    for name in ("scan.dat", "scan", "scan.ply"):
        (folder / name).write_bytes(OBJ)
        message = refused("subdivide", name, "out.off").replace(", not PLY", "")
        assert message.endswith("looks like OBJ; rename it to 'scan.obj', or give --format obj")
        assert invoke("subdivide", name, "out.off", "--format", "obj").code == 0
    assert invoke("subdivide", "in.obj", "out", "--output-format", "off").code == 0
    assert (folder / "out").read_bytes() == (folder / "out.off").read_bytes()
    assert refused("subdivide", "in.obj", "out.ply.gz", "--output-format", "off") == (
        "error: out.ply.gz: its suffix names PLY, but the format to write is OFF; end the name in .off"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux only")
def test_standard_output_that_cannot_be_written(folder, monkeypatch):
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "meshfit", "subdivide", "in.obj", "-", "--output-format", "obj"]
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, env=ENVIRONMENT, check=False
        )
    full_disk = "No space left on device; free some space, and run the same command again"
    assert (done.returncode, done.stderr.decode()) == (2, f"error: standard output: cannot be written: {full_disk}\n")
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(MeshError, match=r"^standard output: it is closed; give the path of a file$"):
        save_mesh(octahedron(), "-", file_format="obj")


def test_standard_input_that_cannot_be_read(monkeypatch):
    for stream, message in (
        (None, "it is closed; pipe a mesh file into the command, or give a path"),
        (mock.Mock(**{"buffer.isatty.return_value": True}), "it is a terminal; pipe a mesh file into the command"),
        (mock.Mock(**{"buffer.isatty.return_value": False, "buffer.read.return_value": b""}), "the file is empty"),
    ):
        monkeypatch.setattr(sys, "stdin", stream)
        with pytest.raises(MeshError, match=f"^standard input: {message}"):
            load_mesh("-", file_format="obj")


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1"])
def test_streams_that_lack_characters_get_others(encoding, tmp_path, monkeypatch):
    """As a redirection on Windows does; the result of hours of fits is not lost for a mark below a table."""
    folder = complete(tmp_path / "runs", seed=0)
    record = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    text = json.dumps(record | {"target_title": "Šárka’s bunny 兔", "shortfalls": ["off the target: by 3 %"]})
    (folder / "result.json").write_text(text, encoding="utf-8")
    raw = [io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", raw[0])
    monkeypatch.setattr(sys, "stderr", raw[1])
    for name in ("rich", "md", "json"):
        monkeypatch.setattr(sys, "argv", ["meshfit", "table", str(tmp_path / "runs"), "-f", name])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 0
    raw[0].flush()
    printed = raw[0].buffer.getvalue().decode(encoding, "replace")  # the md and json of ASCII streams are UTF-8
    assert "rka's bunny ?" in printed.replace("\u2019", "'").replace("\n", " ")
    assert "falls short of its target" in printed
