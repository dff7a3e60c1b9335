"""Curve files: round trips, and refusals in one line."""

import random
import tracemalloc

import numpy as np
import pytest

from meshfit.errors import DomainError, MeshError, MeshfitWarning
from meshfit.mesh.curves import Chains, Curves, require_chains
from meshfit.mesh.io.files import CURVE_FORMATS, encode_curves, load_curves, load_mesh, save_curves, save_mesh
from meshfit.mesh.solids import octahedron
from tests.curve_shapes import SHAPES, many
from tests.damaged import read_or_refused
from tests.loops import over

MEGABYTE = 2**20
SCALES = (1.0, 1e-30, 1e30, 1 / 3)
OBJ = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element edge 2
property int vertex1
property int vertex2
property uchar red
end_header
0 0 0\n1 0 0\n0 1 0\n0 1 255\n1 2 0
"""


def without_unused(curves: Curves) -> Curves:
    used = np.unique(curves.corners)
    return Curves(curves.verts[used], np.searchsorted(used, curves.corners), curves.sizes, curves.closed)


def same(found: Curves, expected: Curves) -> bool:
    return all(
        np.array_equal(getattr(found, name), getattr(expected, name))
        for name in ("verts", "corners", "sizes", "closed")
    )


def loaded(folder, content: bytes, name: str = "a.obj") -> Curves:
    (folder / name).write_bytes(content)
    return load_curves(folder / name)


@over("scale", SCALES)
@pytest.mark.parametrize("suffix", CURVE_FORMATS)
@over("shape", SHAPES)
def test_round_trip_to_the_last_bit(tmp_path, shape, suffix, scale):
    curves = without_unused(SHAPES[shape]())
    curves = Curves(curves.verts * scale * np.pi, curves.corners, curves.sizes, curves.closed)
    save_curves(curves, tmp_path / f"a{suffix}")
    assert same(load_curves(tmp_path / f"a{suffix}"), curves)


@pytest.mark.parametrize("suffix", CURVE_FORMATS)
def test_the_same_curves_give_the_same_bytes(suffix):
    assert encode_curves(many(), suffix) == encode_curves(many(), suffix)


def test_obj_has_a_line_for_each_chain():
    curves = Curves(np.arange(15).reshape(5, 3) / 2, [0, 2, 1, 3, 4], [3, 2], [True, False])
    lines = encode_curves(curves, ".obj").decode().splitlines()
    assert lines == [*(f"v {x!r} {y!r} {z!r}" for x, y, z in curves.verts.tolist()), "l 1 3 2 1", "l 4 5"]


def test_ply_is_binary_little_endian_and_double():
    curves = Curves.through(np.eye(3), closed=True)
    header, body = encode_curves(curves, ".ply").split(b"end_header\n")
    assert header.decode("ascii").splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 3",
        *(f"property double {axis}" for axis in "xyz"),
        "element edge 3",
        "property int vertex1",
        "property int vertex2",
    ]
    assert body == np.eye(3).astype("<f8").tobytes() + np.array([0, 1, 1, 2, 2, 0], "<i4").tobytes()


@over(
    ("lines", "corners", "closed"),
    [
        (b"l 1 2 3 4\n", [[0, 1, 2, 3]], [False]),
        (b"l 1 2 3 4 1\n", [[0, 1, 2, 3]], [True]),
        (b"l 1 2\nl 3 4\nl 3 2\n", [[0, 1, 2, 3]], [False]),
        (b"l 1/7 2/8 3 4\n", [[0, 1, 2, 3]], [False]),
        (b"l -4 -3 -2 -1\n", [[0, 1, 2, 3]], [False]),
        (b"l 1 2 \\\n 3 4 # on\n", [[0, 1, 2, 3]], [False]),
        (b"g one\nl 1 2 1\nusemtl a\nl 3 4\nf 1 2 3\np 1\n", [[0, 1], [2, 3]], [True, False]),
    ],
)
def test_lines_of_obj(tmp_path, lines, corners, closed):
    curves = loaded(tmp_path, OBJ + lines)
    found = np.split(curves.corners, np.cumsum(curves.sizes)[:-1])
    assert [part.tolist() for part in found] == corners
    assert curves.closed.tolist() == closed


def test_text_ply(tmp_path):
    curves = loaded(tmp_path, PLY, "a.ply")
    assert (curves.corners.tolist(), curves.closed.tolist()) == ([0, 1, 2], [False])
    assert np.array_equal(curves.verts, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_verts_of_no_segment_are_dropped_and_told(tmp_path):
    with pytest.warns(MeshfitWarning, match=r"a\.obj: dropped 2 vertices that no curve uses"):
        curves = loaded(tmp_path, OBJ + b"l 2 4\n")
    assert np.array_equal(curves.verts, [[1, 0, 0], [0, 1, 0]])
    assert curves.corners.tolist() == [0, 1]


REFUSED = {
    b"": "the file is empty",
    OBJ: "no curves in it; OBJ holds them as 'l' lines",
    OBJ + b"f 1 2 3\n": "no curves in it; OBJ holds them as 'l' lines",
    OBJ + b"l 1\n": "cannot be read as OBJ: line 5: expected a line of 2 or more vertices, got 1",
    OBJ + b"l 1 2 x\n": "cannot be read as OBJ: line 5: expected integers, got '1 2 x'",
    OBJ + b"l 1 0\n": "cannot be read as OBJ: line 5: a line with vertex 0; OBJ counts from 1",
    OBJ + b"l 1 5\n": "cannot be read as OBJ: line 5: a line with vertex 5, but the file has 4 vertices",
    OBJ + b"l -5 1\n": "cannot be read as OBJ: line 5: a line with vertex -5, but the file has 4 vertices before it",
    OBJ + b"l 1 1 2\n": "segment 0 is [0, 0], from a vertex to itself",
    OBJ + b"l 1 2 3\nl 2 4\n": "the curves branch: vertex 1 has 3 segments, allowed: 1 or 2",
    OBJ + b"v nan 0 0\nl 1 5 2\n": "vertex 4 has a coordinate that is not finite",
    OBJ + b"v 1e99 0 0\nl 1 5 2\n": "expected coordinates up to 1e+60, got [1e+99, 0.0, 0.0] at vertex 4",
    OBJ + b"v 1 0\nl 1 2\n": "cannot be read as OBJ: line 5: expected a vertex of 3 coordinates, got 2",
    OBJ + b"l 1 " + b"9" * 30 + b"\n": "cannot be read as OBJ: ",
}


@over("content", REFUSED)
def test_what_is_wrong_is_said_in_one_line(tmp_path, content):
    with pytest.raises(MeshError) as error:
        loaded(tmp_path, content)
    assert str(error.value).startswith(f"{tmp_path / 'a.obj'}: {REFUSED[content]}")
    assert "\n" not in str(error.value)


PLY_REFUSED = {
    "no property": (PLY.replace(b"vertex2", b"second"), "cannot be read as PLY: 'edge' has no property 'vertex2'"),
    "a part": (
        PLY.replace(b"int vertex", b"float vertex").replace(b"1 2 0", b"1 1.5 0"),
        "cannot be read as PLY: 'edge' has ends that are not vertex indices",
    ),
    "nan": (PLY.replace(b"int vertex", b"float vertex").replace(b"1 2 0", b"1 nan 0"), "cannot be read as PLY: 'edge'"),
    "huge": (PLY.replace(b"1 2 0", b"1 " + b"9" * 30 + b" 0"), "cannot be read as PLY: 'edge' has ends"),
    "outside": (PLY.replace(b"1 2 0", b"1 3 0"), "segment 1 is [1, 3], but vertices are numbered 0 to 2"),
    "cut short": (PLY[:-6], "cannot be read as PLY: the file ends within 'edge', of which it announces 2"),
    "too long": (PLY + b"1 2 0", "cannot be read as PLY: its header announces 2 of 'edge', but the file has 3"),
    "no edges": (PLY.replace(b"edge 2", b"edge 0").replace(b"0 1 255\n1 2 0", b""), "no curves in it; PLY holds"),
    "no verts": (PLY.replace(b"element vertex", b"element point"), "segment 0 is [0, 1], but vertices are numbered"),
}


@over("name", PLY_REFUSED)
def test_what_is_wrong_with_a_ply(tmp_path, name):
    content, message = PLY_REFUSED[name]
    with pytest.raises(MeshError) as error:
        loaded(tmp_path, content, "a.ply")
    assert str(error.value).startswith(f"{tmp_path / 'a.ply'}: {message}")


def test_paths_that_cannot_be_read_or_written(tmp_path):
    curves = Curves.through(np.eye(3))
    with pytest.raises(MeshError, match=r"a\.stl: unknown curve format '\.stl'; allowed: \.obj, \.ply"):
        save_curves(curves, tmp_path / "a.stl")
    (tmp_path / "a").write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    with pytest.raises(MeshError, match="no suffix to tell the curve format"):
        load_curves(tmp_path / "a")
    assert load_curves(tmp_path / "a", file_format="obj").num_segments == 1
    with pytest.raises(MeshError, match=r"gone/a\.ply: cannot be written: there is no folder"):
        save_curves(curves, tmp_path / "gone" / "a.ply")
    save_curves(curves, tmp_path / "curve.obj")
    with pytest.raises(MeshError, match=r"cruve\.obj: no such file; did you mean '.*curve\.obj'"):
        load_curves(tmp_path / "cruve.obj")


def test_a_surface_and_curves_are_not_taken_for_each_other(tmp_path):
    save_mesh(octahedron(), tmp_path / "solid.ply")
    with pytest.raises(DomainError, match="no curves in it; PLY holds them as 'edge' elements"):
        load_curves(tmp_path / "solid.ply")
    save_curves(Curves.through(np.eye(3)), tmp_path / "curve.ply")
    with pytest.raises(DomainError, match="curves of 2 segments and 3 vertices, and no faces"):
        load_mesh(tmp_path / "curve.ply")


VALID = {f"a{suffix}": encode_curves(without_unused(many()), suffix) for suffix in CURVE_FORMATS} | {
    "text.ply": PLY,
    "hand.obj": OBJ + b"l 1 2 3\nl 3 4 1\n",
}


@pytest.mark.parametrize("name", VALID)
def test_a_damaged_file_is_refused_or_gives_sane_curves(tmp_path, name):
    rng = random.Random(name)
    refused = 0
    for _ in range(200):
        content = bytearray(VALID[name])
        for _ in range(rng.randrange(1, 4)):
            at, length = rng.randrange(len(content)), rng.randrange(1, 9)
            piece = rng.choice([rng.randbytes(length), b"9" * length, b"-1", b"nan", b"\n", b" ", b"\xff" * 4, b""])
            content[at : rng.choice([at, at + length, len(content)])] = piece
            content = content or bytearray(b"\0")
        (tmp_path / name).write_bytes(bytes(content))
        curves = read_or_refused(load_curves, tmp_path / name)
        if curves is None:
            refused += 1
            continue
        require_chains(Chains.of(curves), "a test")
        assert np.isfinite(curves.verts).all()
        assert curves.num_segments > 0
        assert np.array_equal(np.sort(curves.corners), np.arange(curves.num_verts))
    assert 0 < refused < 200


@over("announced", [b"edge 1000000000", b"vertex 1000000000"])
@over("name", ["a.ply", "text.ply"])
def test_what_a_file_announces_is_not_allocated_before_it_is_there(tmp_path, name, announced):
    what = announced.split()[0]
    head, _, body = VALID[name].partition(b"element " + what)
    content = head + b"element " + announced + b"\n" + body.partition(b"\n")[2]
    tracemalloc.start()
    with pytest.raises(MeshError, match="the file ends within"):
        loaded(tmp_path, content, name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * MEGABYTE
