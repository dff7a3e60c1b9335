"""Paths that are no file, or cannot be read or written: one line that says what they are and what to do."""

import errno
import os
import socket
from pathlib import Path

import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.files import FORMATS, load_curves, load_mesh, load_polygons, save_mesh
from meshfit.mesh.solids import octahedron
from meshfit.mesh.targets import load_target, target_path
from meshfit.paths import compression_suffix, file_stem, format_suffix, is_folder, path_text, quoted_path
from tests.cli import refused
from tests.loops import over


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(octahedron(), "solid.obj")
    return tmp_path


def dangling(folder):
    Path("link.obj").symlink_to("gone/mesh.obj")
    Path("gane").mkdir()


def loop(folder):
    Path("link.obj").symlink_to("other.obj")
    Path("other.obj").symlink_to("link.obj")


def directory(folder):
    for name in ("a.obj", "a.ply"):
        Path("meshes", name).parent.mkdir(exist_ok=True)
        Path("meshes", name).touch()


def local_socket(folder):
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind("socket.obj")


def nothing(folder):
    pass


def home(folder):
    os.environ["HOME"] = str(folder)


LONG = "a" * 300 + ".obj"
REFUSED = {
    "a dangling link": (
        dangling,
        "link.obj",
        "link.obj: a link to 'gone/mesh.obj', which does not exist; restore that file, or give another path",
    ),
    "a link to itself": (loop, "link.obj", "link.obj: a link that leads back to itself; give the path of the file"),
    "a directory of several meshes": (directory, "meshes", "meshes: expected a file, got a directory"),
    "a directory of one mesh": (nothing, ".", ".: expected a file, got a directory; did you mean 'solid.obj'?"),
    "a directory with a suffix": (
        lambda _: Path("a.obj").mkdir(),
        "a.obj",
        "a.obj: expected a file, got a directory",
    ),
    "a socket": (local_socket, "socket.obj", "socket.obj: expected a file, got a socket"),
    "a device": (nothing, "/dev/zero", "/dev/zero: expected a file, got a device"),
    "a closed pipe": (nothing, "/dev/fd/987", "/dev/fd/987: no such pipe is open"),
    "an empty path": (nothing, "", "'': the path is empty; give the path of a file"),
    "a blank at the end": (nothing, "solid.obj ", "'solid.obj ': no such file; did you mean 'solid.obj'?"),
    "a newline at the end": (nothing, "solid.obj\n", r"'solid.obj\n': no such file; did you mean 'solid.obj'?"),
    "quotes": (nothing, "'solid.obj'", "'solid.obj': no such file; did you mean 'solid.obj'?"),
    "backslashes": (
        lambda folder: save_mesh(octahedron(), (Path("a").mkdir(), Path("a", "b.obj"))[1]),
        r"a\b.obj",
        r"a\b.obj: no such file; did you mean 'a/b.obj'?",
    ),
    "another case": (nothing, "SOLID.OBJ", "SOLID.OBJ: no such file; did you mean 'solid.obj'?"),
    "another suffix": (nothing, "solid.ply", "solid.ply: no such file; did you mean 'solid.obj'?"),
    "a compressed file": (
        lambda folder: Path("solid.obj").rename("scan.obj.gz"),
        "scan.ply",
        "scan.ply: no such file; did you mean 'scan.obj.gz'?",
    ),
    "home": (home, "~/solid.obj", "~/solid.obj: no such file; '~' is not expanded here; give '{}/solid.obj'"),
    "a web address": (
        nothing,
        "https://example.org/solid.obj",
        "https://example.org/solid.obj: a web address; download the file, and give its path",
    ),
    "a file address": (
        nothing,
        "file://{}/solid.obj",
        "file://{}/solid.obj: no such file; did you mean '{}/solid.obj'?",
    ),
    "a long name": (
        nothing,
        LONG,
        f"{LONG}: the name is too long for the file system; rename the file, or give another path",
    ),
    "NUL": (nothing, "a\0.obj", r"'a\x00.obj': no file can have this name; rename it, or give another path"),
    "a lone surrogate": (
        nothing,
        "a\ud800.obj",
        r"'a\ud800.obj': no file can have this name; rename it, or give another path",
    ),
    "bytes that are no text": (nothing, os.fsdecode(b"\xff.obj"), r"'\udcff.obj': no such file in {}"),
    "a file for a folder": (
        nothing,
        "solid.obj/a.obj",
        "solid.obj/a.obj: no such file: solid.obj is a file, not a folder",
    ),
    "no folder": (nothing, "a/b/c.obj", "a/b/c.obj: no such file: there is no folder a/b"),
    "no file": (nothing, "bunny.obj", "bunny.obj: no such file in {}"),
    "no file anywhere": (lambda _: Path("solid.obj").unlink(), "a.obj", "a.obj: no such file in {}"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_wrong_with_a_path_and_what_to_do(folder, monkeypatch, name):
    prepare, text, expected = REFUSED[name]
    monkeypatch.setenv("HOME", os.environ.get("HOME", "/root"))
    prepare(folder)
    text, expected = text.replace("{}", str(folder)), expected.replace("{}", str(folder))
    for load in (load_mesh, load_polygons, load_curves, target_path, load_target):
        with pytest.raises(MeshError) as error:
            load(text)
        assert str(error.value) == expected, load
    if "\0" in text or "\ud800" in text:
        return  # no command line holds these
    commands = [("subdivide", text, "out.ply"), ("measure", text, "bunny"), ("measure", "bone", text)]
    if not is_folder(text):
        commands.append(("render", text, "-o", "out.png"))
    for command in commands:
        assert refused(*command) == f"error: {expected}"


@over(
    ("code", "reason"),
    [
        (errno.EACCES, "Permission denied; change its permissions, or read a copy of your own"),
        (errno.EIO, "Input/output error; copy or download it again"),
        (errno.EMFILE, "Too many open files"),
    ],
)
def test_files_that_the_system_does_not_read(folder, code, reason):
    def read(_):
        raise OSError(code, os.strerror(code))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Path, "read_bytes", read)
        with pytest.raises(MeshError) as error:
            load_mesh("solid.obj")
    assert str(error.value) == f"solid.obj: cannot be read: {reason}"


def test_a_folder_that_may_not_be_entered(folder, monkeypatch):
    def denied(self, **_):
        raise PermissionError(errno.EACCES, "Permission denied", str(self))

    monkeypatch.setattr(Path, "stat", denied)
    with pytest.raises(MeshError) as error:
        load_mesh("private/solid.obj")
    assert str(error.value) == (
        "private/solid.obj: permission denied in folder private; change its permissions, or give another path"
    )


def test_a_file_that_does_not_fit_in_memory(folder, monkeypatch):
    def read(_):
        raise MemoryError

    monkeypatch.setattr(Path, "read_bytes", read)
    with pytest.raises(MeshError, match=r"^solid\.obj: the file needs more memory than is free$"):
        load_mesh("solid.obj")


UNWRITABLE = {
    "": "'': the path is empty; give the path of a file to write",
    ".": ".: cannot be written: it is a directory; give the path of a file",
    "gone/a.ply": "gone/a.ply: cannot be written: there is no folder gone; create it, or choose another place",
    "~/gone/a.ply": "~/gone/a.ply: cannot be written: there is no folder ~/gone; "
    "'~' is not expanded here; give '{}/gone/a.ply'",
    "solid.obj/a.ply": "solid.obj/a.ply: cannot be written: Not a directory; choose another place",
    LONG: f"{LONG}: cannot be written: File name too long; choose a shorter name",
    "out.ply ": f"'out.ply ': unknown mesh format '.ply '; allowed: {', '.join(FORMATS)}",
    "link.obj": "link.obj: cannot be written: a link to 'gone/mesh.obj', whose folder does not exist",
    "a\0.obj": r"'a\x00.obj': no file can have this name; give another one",
}  # fmt: skip


@over("path", UNWRITABLE)
def test_what_is_wrong_with_a_path_to_write(tmp_path, path):
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(tmp_path)
        patched.setenv("HOME", str(tmp_path))
        save_mesh(octahedron(), "solid.obj")
        dangling(tmp_path)
        with pytest.raises(MeshError) as error:
            save_mesh(octahedron(), path)
        expected = UNWRITABLE[path].replace("{}", str(tmp_path))
        assert str(error.value) == expected
        if "\0" not in path:
            message = refused("subdivide", "solid.obj", path)
            assert message.removesuffix(", or give --output-format FORMAT") == f"error: {expected}"
        assert {file.name for file in tmp_path.iterdir()} == {"solid.obj", "link.obj", "gane"}


@over(
    ("path", "stem", "suffix", "packed"),
    [
        ("scan.ply", "scan", ".ply", ""),
        ("a/Scan.PLY.GZ", "Scan", ".ply", ".gz"),
        ("head.scan.obj.xz", "head.scan", ".obj", ".xz"),
        ("head.scan.obj", "head.scan", ".obj", ""),
        ("scan.gz", "scan", "", ".gz"),
        (".gz", ".gz", "", ""),
        (".obj.gz", ".obj", "", ".gz"),
        ("scan", "scan", "", ""),
        ("scan.tar.gz", "scan", ".tar", ".gz"),
    ],
)
def test_suffixes_and_stems(path, stem, suffix, packed):
    for given in (path, Path(path)):
        assert (file_stem(given), format_suffix(given), compression_suffix(given)) == (stem, suffix, packed)


def test_paths_in_messages_are_one_line():
    assert path_text("a b/ü.obj") == "a b/ü.obj"
    assert quoted_path("a b/ü.obj") == "'a b/ü.obj'"
    for text in ("a\n.obj", " a.obj", "a.obj ", "a\x1b[31m.obj", "a\u2028.obj", "a\u202e.obj"):
        assert path_text(text) == quoted_path(text) == repr(text)
        assert path_text(text).isprintable()
    assert len(path_text("a" * 5000)) < 450
