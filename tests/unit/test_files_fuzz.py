"""Damaged files give a valid mesh or a MeshError, without a hang or a huge allocation."""

import functools
import random
import signal
import struct
import tracemalloc

import numpy as np
import pytest

from meshfit.mesh.io import obj, off, ply_elements, stl
from meshfit.mesh.io.files import FORMATS, POINT_FORMATS, READABLE_FORMATS, encode_mesh, load_mesh
from meshfit.mesh.solids import octahedron
from tests import scenes
from tests.damaged import damaged, read_or_refused, soup_or_refused
from tests.loops import over

MUTATIONS, MANY_MUTATIONS, LOADED = 1_000, 20_000, 60
SECONDS = 2
MEGABYTE = 2**20
POINTS = b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = b"3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
XYZ = b"property float x\nproperty float y\nproperty float z\n"
ASCII_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 4\n" + XYZ + b"element face 4\nproperty list uchar int vertex_indices\n"
    b"end_header\n" + POINTS + FACES
)  # fmt: skip
TEXTURED_PLY = ASCII_PLY.replace(XYZ, XYZ + b"property uchar red\nproperty uchar green\nproperty uchar blue\n").replace(
    b"end_header", b"property list uchar float texcoord\nproperty int texnumber\ncomment TextureFile a.png\nend_header"
).replace(POINTS, POINTS.replace(b"\n", b" 9 8 7\n")).replace(
    FACES, FACES.replace(b"\n", b" 6 0 0 1 0 1 1 0\n")
)  # fmt: skip
PLY_HEAD = b"ply\r\nformat %s 1.0\r\ncomment end_header\r\nelement vertex 3\r\n%sproperty uchar a\r\n"
STRIPS = b"element face 1\r\nproperty list uchar int vertex_index\r\nproperty list uchar short x\r\n" \
    b"element tristrips 2\r\nproperty list int int vertex_indices\r\nelement edge 1\r\nproperty int vertex1\r\n" \
    b"property int vertex2\r\nelement polyline 1\r\nproperty list ushort uint indices\r\nend_header\r\n"  # fmt: skip
BINARY_PLY = PLY_HEAD.replace(b"%s", b"binary_big_endian", 1).replace(b"%s", XYZ) + STRIPS + struct.pack(
    ">" + "fffB" * 3 + "B3iB2h" + "i7ii3i" + "2i" + "H2I",
    *(0, 0, 0, 1, 1, 0, 0, 2, 0, 1, 0, 3), *(3, 0, 1, 2, 2, 7, 7), *(7, 0, 1, 2, 0, -1, 1, 2, 3, 2, 1, 0), *(0, 1),
    *(2, 0, 1),
)  # fmt: skip
FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 %d\nvertex 0 1 0\nendloop\nendfacet\n"
OBJ = (
    b"# C:\\a\\\nmtllib a.mtl\ng a\nusemtl b\nv 0 0 0 1 0 0\nv 1 0 0 1\nv 0 1 0\nv 0 0 1 # x\nvt 0 0\nvn 0 0 1\n"
    b"f 1/1/1 3/1/1 2/1/1\nf -4 \\\n -3 -1\nfo 2//1 3//1 4//1\nf 3 1 4\nl 1 2\np 1\nsurf 0 1 0 1 1 2\n"
)
VTK = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n%sPOLYGONS 4 16\n%s" % (POINTS, FACES)
VTP = (
    b'<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian">\n<PolyData>\n'
    b'<Piece NumberOfPoints="4" NumberOfPolys="2">\n<Points><DataArray type="Float32" NumberOfComponents="3" '
    b'format="ascii">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points>\n<Polys><DataArray type="Int32" Name="connectivity" '
    b'format="ascii">0 2 1 0 1 3</DataArray><DataArray type="Int32" Name="offsets" format="ascii">3 6</DataArray>'
    b"</Polys>\n</Piece>\n</PolyData>\n</VTKFile>\n"
)
PCD = (
    b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
    b"POINTS 4\nDATA ascii\n" + POINTS
)
VALID = {suffix: encode_mesh(octahedron(), suffix) for suffix in FORMATS} | {
    "ascii.ply": ASCII_PLY,
    "textured.ply": TEXTURED_PLY,
    "strips.ply": BINARY_PLY,
    "ascii.stl": b"solid a\n" + FACET % 0 + FACET % 1 + b"endsolid a\n",
    "odd.stl": b"solid facet\r\n" + (FACET % 0).upper() + b"end solid\rsolid b\r" + FACET.replace(b"normal 0", b"") % 1,
    "odd.obj": OBJ,
    "odd.off": b"COFF4 4\n# x\n" + POINTS.replace(b"\n", b" 1 0 0 1\n") + FACES.replace(b"\n", b" 0.5 0.5 0.5\n"),
    "words.off": b"OFF 4\n4\n0\n" + POINTS.replace(b" ", b"\n") + FACES.replace(b"\n", b" "),
    "text.vtk": VTK,
    "text.vtp": VTP,
    "text.vtu": VTP.replace(b"PolyData", b"UnstructuredGrid").replace(b"Polys", b"Cells").replace(
        b"</Cells>", b'<DataArray type="UInt8" Name="types" format="ascii">5 5</DataArray></Cells>'
    ),
}  # fmt: skip
SEEDS = VALID | {
    "a.xyz": POINTS,
    "a.pts": b"4\n" + POINTS,
    "a.csv": b"x,y,z\n" + POINTS.replace(b" ", b","),
    "a.pcd": PCD,
    "a.las": scenes.las(),
    "a.dae": scenes.DAE,
    "a.3mf": scenes.threemf(),
    "scene.glb": scenes.glb(),
}


class HangError(BaseException):
    """Not an Exception, so that nothing on the way takes it for a damaged file."""


def alarm(*_):
    raise HangError


@pytest.fixture(autouse=True)
def _no_hang():
    before = signal.signal(signal.SIGALRM, alarm)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def suffix_of(name):
    return name[name.rindex(".") :]


def reader(name, folder):
    """The reader of bytes of the name's format, attributes too; it looks for other files in an empty folder."""
    form = (READABLE_FORMATS | POINT_FORMATS)[suffix_of(name)]
    options = {"folder": folder} if getattr(form, "folder", False) else {}
    options |= {"attributes": True} if getattr(form, "attributes", False) else {}
    return functools.partial(form.read, **options)


def mutate(name, count, folder):
    """Read so many damaged copies, and return how many were refused."""
    rng, read, refused = random.Random(name), reader(name, folder), 0
    for number in range(count):
        content = damaged(SEEDS[name], rng)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        try:
            refused += soup_or_refused(read, content) is None
        except BaseException as error:
            error.add_note(f"mutation {number} of {name}: {content!r}")
            raise
    return refused


def of_its_format(name):
    """Number of seeds in its format."""
    return sum(suffix_of(other) == suffix_of(name) for other in SEEDS)


@pytest.mark.parametrize("name", SEEDS)
def test_damaged_bytes_are_refused_in_plain_words_or_read(tmp_path, name):
    count = MUTATIONS // of_its_format(name)
    assert 0 < mutate(name, count, tmp_path) < count


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_many_damaged_bytes_are_refused_in_plain_words_or_read(tmp_path, name):
    mutate(name, MANY_MUTATIONS // of_its_format(name), tmp_path)


AT_ONCE = {
    ".obj": (obj, "_read_at_once"),
    ".off": (off, "_read_at_once"),
    ".ply": (ply_elements, "parse_floats"),
    ".stl": (stl, "_regular_text_verts"),
}


@over("name", [name for name in VALID if suffix_of(name) in AT_ONCE and name not in (".stl", ".ply")])
def test_numbers_read_at_once_are_those_that_are_read_one_by_one(monkeypatch, name):
    rng, suffix = random.Random(name), suffix_of(name)
    contents = [VALID[name], *(damaged(VALID[name], rng) for _ in range(150))]
    found = [soup_or_refused(FORMATS[suffix].read, content) for content in contents]
    with monkeypatch.context() as patched:
        patched.setattr(*AT_ONCE[suffix], lambda *_: None)
        for content, at_once in zip(contents, found, strict=True):
            one_by_one = soup_or_refused(FORMATS[suffix].read, content)
            assert (one_by_one is None) == (at_once is None), content
            if at_once is not None:
                for one, other in zip(one_by_one, at_once, strict=True):
                    np.testing.assert_array_equal(one, other, err_msg=repr(content))


@pytest.mark.parametrize("name", VALID)
def test_a_damaged_file_is_refused_or_gives_a_sane_mesh(tmp_path, name):
    rng, path = random.Random(name), tmp_path / f"a{name}"
    for _ in range(LOADED):
        path.write_bytes(damaged(VALID[name], rng))
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        mesh = read_or_refused(load_mesh, path)
        if mesh is not None:
            assert np.isfinite(mesh.verts).all()
            assert mesh.num_faces > 0
            assert np.array_equal(np.unique(mesh.faces), np.arange(mesh.num_verts))


GIANTS = {
    "binary verts.ply": VALID[".ply"].replace(b"vertex 6", b"vertex 1000000000"),
    "binary faces.ply": VALID[".ply"].replace(b"face 8", b"face 1000000000"),
    "ascii verts.ply": ASCII_PLY.replace(b"vertex 4", b"vertex 1000000000"),
    "ascii faces.ply": ASCII_PLY.replace(b"face 4", b"face 1000000000"),
    "ascii corners.ply": ASCII_PLY.replace(b"uchar", b"uint").replace(b"3 2 0 3", b"4000000000 2 0 3"),
    "strips.ply": BINARY_PLY.replace(b"tristrips 2", b"tristrips 999999999"),
    "strip corners.ply": BINARY_PLY.replace(struct.pack(">3i", 7, 0, 1), struct.pack(">3i", 2**31 - 1, 0, 1)),
    "wide corners.ply": ASCII_PLY.replace(b"uchar", b"uint64").replace(b"3 2 0 3", b"18446744073709551615 2 0 3"),
    "off words.off": b"OFF999999999 999999999\n" + POINTS.replace(b" ", b"\n"),
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
