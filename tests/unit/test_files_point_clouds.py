"""Point clouds: every way of writing them gives the same points, and a surface is not made of them."""

import re
import struct
import subprocess

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.faceless import POINTS_REMEDY
from meshfit.mesh.io.files import POINT_FORMATS, encode_mesh, load_mesh
from meshfit.mesh.io.point_clouds import load_points
from meshfit.mesh.solids import octahedron
from tests.loops import over

POINTS = np.array([[0.5, -1, 2], [3, 4.25, 5], [6, 7, -8e-3], [9, 1e2, 11]])
ROWS = [" ".join(map(repr, row)) for row in POINTS.tolist()]
TEXT = "\n".join(ROWS) + "\n"


def columns(*values):
    return "\n".join(f"{row} {' '.join(map(str, values))}" for row in ROWS) + "\n"


def las(points=POINTS, minor=2, scale=(0.001, 0.01, 0.5), offset=(-5.0, 100.0, 7.0), length=20, form=0, count=None):
    """A LAS file whose integers times the scale plus the offset are near the points."""
    head = 227 if minor < 4 else 375
    header = bytearray(head)
    header[:4], header[24:26] = b"LASF", bytes([1, minor])
    count = len(points) if count is None else count
    struct.pack_into("<HIIBHI", header, 94, head, head, 0, form, length, count)
    struct.pack_into("<6d", header, 131, *scale, *offset)
    if minor == 4:
        struct.pack_into("<IQ", header, 107, 0, 0)
        struct.pack_into("<Q", header, 247, count)
    integers = np.round((points - offset) / scale).astype("<i4")
    return bytes(header) + b"".join(row.tobytes() + bytes(length - 12) for row in integers)


def pcd(form, body, fields="x y z", sizes="4 4 4", kinds="F F F", counts="1 1 1", points=4):
    head = f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\n"
    head += f"COUNT {counts}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {form}\n"
    return head.encode() + (body if isinstance(body, bytes) else body.encode())


def records(dtype):
    rows = np.zeros(4, dtype)
    for axis, column in zip("xyz", POINTS.T, strict=True):
        rows[axis] = column
    return rows


SHUFFLED = np.dtype([("intensity", "<u2"), ("z", "<f8"), ("normal", "<f4", 3), ("x", "<f4"), ("y", "<f4")])
LAYOUT = {"fields": "intensity z normal x y", "sizes": "2 8 4 4 4", "kinds": "U F F F F", "counts": "1 1 3 1 1"}


def lzf(data):
    """Return data as LZF literals, but for a last run of zeros, which copies itself."""
    body = data.rstrip(b"\0")
    zeros = len(data) - len(body)
    pieces = [body[start : start + 32] for start in range(0, len(body), 32)]
    packed = b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)
    if zeros > 3:
        packed += (
            bytes([0, 0]) + bytes([(7 << 5), zeros - 1 - 9, 0]) if zeros - 1 >= 9 else bytes([zeros - 1]) + bytes(zeros)
        )
    elif zeros:
        packed += bytes([zeros - 1]) + bytes(zeros)
    return struct.pack("<II", len(packed), len(data)) + packed


def columns_of(rows):
    return b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in rows.dtype.names)


VARIANTS = {
    "plain.xyz": TEXT,
    "no last line end.xyz": TEXT.rstrip(),
    "windows.xyz": "\ufeff" + TEXT.replace("\n", "\r\n"),
    "old lines.asc": TEXT.replace("\n", "\r"),
    "tabs.txt": TEXT.replace(" ", "\t  "),
    "commas.csv": TEXT.replace(" ", ","),
    "commas and blanks.txt": TEXT.replace(" ", ", "),
    "semicolons.csv": TEXT.replace(" ", ";"),
    "comments.xyz": "# a b\n//X Y Z\n\n" + TEXT.replace("\n", " # 1 2\n"),
    "a count.xyz": "4\n" + TEXT,
    "normals.xyzn": columns(0, 0, 1),
    "colours.xyzrgb": columns(255, 0, 7),
    "words that nobody reads.txt": columns("nan", "-", "a"),
    "names.csv": "X;Y;Z;R\n" + columns(255).replace(" ", ";"),
    "names in another order.csv": '"id","z","y","x"\n'
    + "".join(f"{number},{z!r},{y!r},{x!r}\n" for number, (x, y, z) in enumerate(POINTS.tolist())),
    "plain.pts": TEXT,
    "intensity and colours.pts": "4\n" + columns(-1203, 10, 20, 30),
    "two blocks.pts": f"1\n{ROWS[0]}\n3\n" + "\n".join(ROWS[1:]),
    "text.pcd": pcd("ascii", TEXT),
    "binary.pcd": pcd("binary", POINTS.astype("<f4").tobytes()),
    "columns.pcd": pcd("binary", records(SHUFFLED).tobytes(), **LAYOUT),
    "text columns.pcd": pcd("ascii", "".join(f"1 {z!r} 0 0 1 {x!r} {y!r}\n" for x, y, z in POINTS.tolist()), **LAYOUT),
    "compressed.pcd": pcd("binary_compressed", lzf(columns_of(records(SHUFFLED))), **LAYOUT),
}


@over("name", VARIANTS)
def test_all_ways_of_writing_points_give_the_same(tmp_path, name):
    content = VARIANTS[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    found = load_points(tmp_path / name)
    assert found.dtype == np.float64
    assert np.allclose(found, POINTS, atol=0 if name.endswith(("xyz", "pts", "csv")) else 1e-6)
    with pytest.raises(MeshError) as caught:
        load_mesh(tmp_path / name)
    expected = f"{tmp_path / name}: expected a surface, got a cloud of 4 points and no faces; {POINTS_REMEDY}"
    assert str(caught.value) == expected


@over("minor", [0, 2, 4])
@over("length", [20, 26, 34])
def test_las_has_a_scale_and_an_offset(tmp_path, minor, length):
    (tmp_path / "a.las").write_bytes(las(minor=minor, length=length))
    found = load_points(tmp_path / "a.las")
    assert (np.abs(found - POINTS) <= np.array([0.001, 0.01, 0.5]) / 2 + 1e-12).all()
    with pytest.raises(MeshError, match="a cloud of 4 points"):
        load_mesh(tmp_path / "a.las")


@over("form", [0, 3, 6])
def test_las_and_laz_as_laspy_writes_them(tmp_path, form):
    laspy = pytest.importorskip("laspy")
    rng = np.random.default_rng(form)
    points = rng.normal(size=(1000, 3)) * 50
    cloud = laspy.create(point_format=form, file_version="1.4" if form == 6 else "1.2")
    cloud.header.scales, cloud.header.offsets = [0.001] * 3, [10, 20, 30]
    cloud.x, cloud.y, cloud.z = points.T
    cloud.write(str(tmp_path / "a.las"))
    assert np.allclose(load_points(tmp_path / "a.las"), points, atol=0.0006)
    pytest.importorskip("lazrs")
    cloud.write(str(tmp_path / "a.laz"))
    assert np.array_equal(load_points(tmp_path / "a.laz"), load_points(tmp_path / "a.las"))


@pytest.mark.parametrize(("code", "message"), [(-9, "was killed; perhaps"), (-6, "its compressed points are damaged")])
def test_a_decoder_that_is_killed_is_not_taken_for_damage(tmp_path, monkeypatch, code, message):
    def killed(*_, **__):
        raise subprocess.CalledProcessError(code, "decoder")

    monkeypatch.setattr("importlib.util.find_spec", lambda _: True)
    monkeypatch.setattr("subprocess.run", killed)
    (tmp_path / "a.laz").write_bytes(las(form=0x80).replace(bytes(16), b"laszip encoded\0\0", 1))
    with pytest.raises(MeshError, match=message):
        load_points(tmp_path / "a.laz")


def test_laz_without_a_decoder_is_counted_and_the_remedy_named(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "a.laz").write_bytes(las(form=0x80).replace(bytes(16), b"laszip encoded\0\0", 1))
    with pytest.raises(MeshError, match=re.escape("LAZ needs a decoder: pip install 'meshfit[las]', or convert")):
        load_points(tmp_path / "a.laz")
    with pytest.raises(MeshError, match="a cloud of 4 points"):
        load_mesh(tmp_path / "a.laz")


@over("suffix", [".ply", ".obj", ".stl", ".off", ".glb"])
def test_the_vertices_of_a_mesh_are_points(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(encode_mesh(octahedron(), suffix))
    found = load_points(tmp_path / f"a{suffix}")
    assert np.array_equal(np.unique(found, axis=0), np.unique(octahedron().verts, axis=0))


def test_pixels_without_a_point_are_left_out(tmp_path):
    (tmp_path / "a.pcd").write_text(pcd("ascii", TEXT.replace(ROWS[1], "nan nan nan")).decode())
    with pytest.warns(MeshfitWarning, match=r"a\.pcd: left out 1 point with a coordinate that is not finite"):
        assert np.array_equal(load_points(tmp_path / "a.pcd"), POINTS[[0, 2, 3]])


FAULTS = {
    "a word.xyz": (TEXT.replace("4.25", "four"), "line 2: expected numbers, got '3.0 four 5.0'"),
    "a title.xyz": ("Scan of Monday\n" + TEXT, "line 1: expected numbers, or columns named x, y and z, got 'Scan of M"),
    "atoms.xyz": ("1\nwater\nO 0 0 0\n", "line 2: expected a number of points, got 'water'"),
    "two columns.xyz": ("1 2\n3 4\n", "line 1: expected 3 columns or more, got 2"),
    "other columns.xyz": (TEXT + "1 2 3 4\n", "line 5: expected 3 columns, as before, got 4"),
    "cut.xyz": (TEXT[:-9], "line 4: expected 3 columns, as before, got 2"),
    "one number.xyz": (TEXT + "7\n", "line 5: expected 3 coordinates or more, got '7'"),
    "decimal commas.xyz": (TEXT.replace(".", ","), "line 1: expected commas between columns or none, got '0,5 -1,0"),
    "decimal commas.csv": (TEXT.replace(" ", ";").replace(".", ","), "write decimal points, not commas"),
    "wrong count.pts": ("5\n" + TEXT, "line 1 announces 5 points, but 4 follow"),
    "wrong block.pts": ("4\n" + TEXT + "2\n" + ROWS[0], "line 6 announces 2 points, but 1 follow"),
    "comments.xyz": ("# nothing\n", "no points in it"),
    "binary.xyz": (b"\x01\x00\x02", "expected text in UTF-8, got other data"),
    "other.las": (b"LASX" + bytes(300), "expected 'LASF' and a header of 227 bytes"),
    "cut.las": (las()[:-1], "cut short: its header announces 4 points, but the file has 3"),
    "many.las": (las(count=2**32 - 1), "cut short: its header announces 4294967295 points"),
    "many.laz": (las(count=2**32 - 1, form=0x80), "announces 4294967295 points, far more than"),
    "scale.las": (las()[:131] + bytes(8) + las()[139:], "expected a scale and an offset that are finite"),
    "no record.laz": (las(form=0x80), "its points are compressed, but no record says how"),
    "no header.pcd": (b"VERSION .7\nFIELDS x y z\n", "expected a header that ends with a line 'DATA ascii'"),
    "no y.pcd": (pcd("ascii", TEXT, fields="x w z"), "expected FIELDS x, y and z, one of each"),
    "lengths.pcd": (pcd("ascii", TEXT, sizes="4 4"), "FIELDS, TYPE, SIZE and COUNT of different lengths"),
    "few.pcd": (pcd("ascii", TEXT, points=5), "expected 5 points of 3 numbers, got 12 numbers"),
    "cut.pcd": (pcd("binary", bytes(47)), "cut short: its header announces 4 points, but the file has 3"),
    "lzf.pcd": (pcd("binary_compressed", struct.pack("<II", 2, 48) + b"\xff\xff"), "compressed points are damaged"),
}  # fmt: skip


@over("name", FAULTS)
def test_the_fault_is_named(tmp_path, name):
    content, expected = FAULTS[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MeshError) as caught:
        load_points(tmp_path / name)
    kind = name.rpartition(".")[2].upper()
    assert str(caught.value).startswith(f"{tmp_path / name}: cannot be read as {kind}: ")
    assert expected in str(caught.value)


def test_the_suffixes_of_point_clouds_are_not_among_those_of_meshes(tmp_path):
    (tmp_path / "a.foo").write_bytes(b"\x01")
    with pytest.raises(MeshError) as caught:
        load_mesh(tmp_path / "a.foo")
    assert not any(suffix in str(caught.value).partition("allowed")[2] for suffix in POINT_FORMATS)
