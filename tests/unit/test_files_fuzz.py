"""Damaged files give a valid mesh or a MeshError, without a hang or a huge allocation."""

import random
import signal
import tracemalloc

import numpy as np
import pytest

from meshfit.mesh.io.files import FORMATS, encode_mesh, load_mesh
from meshfit.mesh.solids import octahedron
from tests.damaged import read_or_refused
from tests.loops import over

CASES = 150
SECONDS = 20
MEGABYTE = 2**20
ASCII_PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3
"""
FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 %d\nvertex 0 1 0\nendloop\nendfacet\n"
VALID = {suffix: encode_mesh(octahedron(), suffix) for suffix in FORMATS} | {
    "ascii.ply": ASCII_PLY,
    "ascii.stl": b"solid a\n" + FACET % 0 + FACET % 1 + b"endsolid a\n",
}


class HangError(BaseException):
    """Not an Exception, so that nothing on the way takes it for a damaged file."""


@pytest.fixture(autouse=True)
def _no_hang():
    def stop(*_):
        raise HangError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def damaged(content, rng):
    at, length = rng.randrange(len(content)), rng.randrange(1, 9)
    piece = rng.choice(
        [rng.randbytes(length), b"9" * length, b"-1", b"nan", b"\n", b" ", b"\xff" * 4, b"\x00" * 4, b""]
    )
    return rng.choice(
        [
            lambda: content[:at],
            lambda: content[:at] + piece + content[at:],
            lambda: content[:at] + piece + content[at + length :],
            lambda: content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :],
            lambda: content[:at] + content[at : at + 40] * 3 + content[at + 40 :],
        ]
    )()


@pytest.mark.parametrize("name", VALID)
def test_a_damaged_file_is_refused_or_gives_a_sane_mesh(tmp_path, name):
    rng = random.Random(name)
    path = tmp_path / f"a{name}"
    refused = 0
    for _ in range(CASES):
        content = VALID[name]
        for _ in range(rng.randrange(1, 4)):
            content = damaged(content, rng) or b"\0"
        path.write_bytes(content)
        mesh = read_or_refused(load_mesh, path)
        if mesh is None:
            refused += 1
            continue
        assert np.isfinite(mesh.verts).all()
        assert mesh.num_faces > 0
        assert np.array_equal(np.unique(mesh.faces), np.arange(mesh.num_verts))
    assert refused > 0


GIANTS = {
    "binary verts.ply": VALID[".ply"].replace(b"vertex 6", b"vertex 1000000000"),
    "binary faces.ply": VALID[".ply"].replace(b"face 8", b"face 1000000000"),
    "ascii verts.ply": ASCII_PLY.replace(b"vertex 4", b"vertex 1000000000"),
    "ascii faces.ply": ASCII_PLY.replace(b"face 4", b"face 1000000000"),
    "ascii corners.ply": ASCII_PLY.replace(b"uchar", b"uint").replace(b"3 2 0 3", b"4000000000 2 0 3"),
    "no properties.ply": ASCII_PLY.replace(b"element face", b"element empty 9999999999\nelement face"),
    "binary corners.ply": VALID[".ply"].replace(b"list uchar", b"list uint"),
    "off verts.off": VALID[".off"].replace(b"6 8 0", b"1000000000 8 0"),
    "off faces.off": VALID[".off"].replace(b"6 8 0", b"6 1000000000 0"),
    "off corners.off": VALID[".off"].replace(b"\n3 ", b"\n1000000000 "),
    "obj corner.obj": VALID[".obj"] + b"f 1 2 1000000000000000\n",
    "obj huge corner.obj": VALID[".obj"] + b"f 1 2 " + b"9" * 30 + b"\n",
    "faces.stl": VALID[".stl"][:80] + (10**9).to_bytes(4, "little") + VALID[".stl"][84:],
}


@over("name", GIANTS)
def test_what_a_file_announces_is_not_allocated_before_it_is_there(tmp_path, name):
    (tmp_path / name).write_bytes(GIANTS[name])
    tracemalloc.start()
    mesh = read_or_refused(load_mesh, tmp_path / name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * MEGABYTE
    assert (mesh is None) == (name != "no properties.ply")


@pytest.mark.parametrize("name", VALID)
def test_the_undamaged_files_are_good(tmp_path, name):
    path = tmp_path / f"a{name}"
    path.write_bytes(VALID[name])
    assert read_or_refused(load_mesh, path) is not None
