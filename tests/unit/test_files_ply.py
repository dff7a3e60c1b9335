"""PLY files in the variants that programs and scanners write: headers, columns, strips, other elements, damage."""

import struct
from itertools import chain

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.ply import read_ply, read_ply_property
from tests.loops import over

VERTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
STRIP = [0, 1, 3, 2, 0]  # the last three of the faces
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"
VERTEX = f"element vertex 4\n{XYZ}"
HEADER = f"ply\nformat ascii 1.0\n{VERTEX}element face 4\n{LIST}end_header\n"
POINTS = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
ROWS = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
TEXT = HEADER + POINTS + ROWS
ORDERS = {"<": "binary_little_endian", ">": "binary_big_endian"}


def packed(order, code, rows):
    return b"".join(struct.pack(f"{order}B{len(row)}{code}", len(row), *row) for row in rows)


def binary(order="<", points=VERTS, faces=FACES):
    head = HEADER.replace("ascii", ORDERS[order]).encode()
    return head + np.asarray(points, order + "f4").tobytes() + packed(order, "i", faces)


def is_tetrahedron(soup, verts=VERTS):
    faces = np.split(soup.corners, np.cumsum(soup.sizes)[:-1])
    turned = sorted(np.roll(face, -int(np.argmin(face))).tolist() for face in faces)
    return np.array_equal(soup.verts, verts) and turned == sorted(
        np.roll(f, -int(np.argmin(f))).tolist() for f in FACES
    )


NORMALS = "".join(f"property float {name}\n" for name in ("nx", "ny", "nz"))
VARIANTS = {
    "plain": TEXT,
    "the last line named in comments": TEXT.replace(
        "1.0\n", "1.0\ncomment the end_header line follows\nobj_info end_header\n"
    ),
    "blanks after the last line": TEXT.replace("end_header\n", "end_header \t\n"),
    "comments anywhere": TEXT.replace("\n", "\ncomment x\n", 8),
    "byte order mark": "\ufeff" + TEXT,
    "format after the elements": TEXT.replace("format ascii 1.0\n", "").replace("end_h", "format ascii 1.0\nend_h"),
    "CR": TEXT.replace("\n", "\r"),
    "CRLF": TEXT.replace("\n", "\r\n"),
    "faces before vertices": f"ply\nformat ascii 1.0\nelement face 4\n{LIST}{VERTEX}end_header\n{ROWS}{POINTS}",
    "all on one line": HEADER + (POINTS + ROWS).replace("\n", " "),
    "one number per line": HEADER + (POINTS + ROWS).replace(" ", "\n"),
    "indices as floats": HEADER
    + POINTS
    + ROWS.replace(" 0 ", " 0.0 ").replace(" 2 ", " 2.0 ").replace("3 ", "3.0 ", 1),
    "blank lines at the end": TEXT + "\n \n\t\n\0\x1a",
    "float as index type": TEXT.replace("uchar int", "uchar float"),
    "int64 as index type": TEXT.replace("uchar int", "uint64 int64"),
    "normals not finite": HEADER.replace(XYZ, XYZ + NORMALS)
    + POINTS.replace("\n", " -nan(ind) 1.#QNAN -1.#IND00\n")
    + ROWS,
    "floats in uchar": HEADER.replace(XYZ, XYZ + "property uchar red\n") + POINTS.replace("\n", " 0.5\n") + ROWS,
    "words that are no numbers": HEADER.replace(XYZ, XYZ + "property uchar red\n")
    + POINTS.replace("\n", " #ff0 \n")
    + ROWS,
    "lists of words": HEADER.replace(LIST, LIST + "property list uchar float texcoord\n")
    + POINTS
    + ROWS.replace("\n", " 2 1,5 x\n").replace(" 2 1,5 x\n", " 0\n", 1),
    "two properties of one name": HEADER.replace(XYZ, XYZ + "property uchar a\n" * 2)
    + POINTS.replace("\n", " 1 2\n")
    + ROWS,
    "no rows of another element": TEXT.replace("element face", "element edge 0\nproperty int a\nelement face"),
    "an element without properties": TEXT.replace("element face", "element nothing 9\nelement face"),
    "vertex_index": TEXT.replace("vertex_indices", "vertex_index"),
    "camera": TEXT.replace("end_header", "element camera 1\nproperty float view\nend_header") + "7.5\n",
}


@over("name", VARIANTS)
def test_all_ways_of_writing_a_text_are_read_alike(name):
    assert is_tetrahedron(read_ply(VARIANTS[name].encode()))


@over("line_end", [b"\n", b"\r\n", b"\r"])
@over("first_byte", [0x0A, 0x0D, 0x20, 0x09])
@over("order", ORDERS)
def test_a_binary_body_may_begin_with_the_byte_of_a_line_end(order, first_byte, line_end):
    content = bytearray(binary(order))
    start = content.index(b"end_header\n") + len(b"end_header\n")
    content[start] = first_byte
    head, body = bytes(content[:start]), bytes(content[start:])
    verts = np.frombuffer(body, order + "f4", 12).reshape(4, 3)
    assert is_tetrahedron(read_ply(head.replace(b"\n", line_end) + body), verts)


@over("blank", [b" ", b"\t ", b"\r"])
def test_blanks_after_end_header_of_a_binary_file(blank):
    assert is_tetrahedron(read_ply(binary().replace(b"end_header", b"end_header" + blank)))


@over("order", ORDERS)
def test_binary_columns_that_nobody_wants_are_passed_over(order):
    extra = "property double q\nproperty list uchar short w\nproperty uchar a\n"
    head = f"ply\nformat {ORDERS[order]} 1.0\nelement vertex 4\n{extra}{XYZ}element face 4\n{LIST}{extra}end_header\n"
    trash = [struct.pack(f"{order}dB{n}hB", np.nan, n, *range(n), 7) for n in (0, 3, 1, 200)]
    points = b"".join(t + p.astype(order + "f4").tobytes() for t, p in zip(trash, VERTS, strict=True))
    rows = b"".join(packed(order, "i", [face]) + t for face, t in zip(FACES, trash, strict=True))
    assert is_tetrahedron(read_ply(head.encode() + points + rows))


def test_polygons_of_mixed_sizes_in_text_and_binary():
    faces = [[0, 1, 2, 3], [3, 2, 1], [0, 1, 2, 3, 0, 1], [1, 2, 3]]
    text = HEADER + POINTS + "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    for content in (binary(faces=faces), binary(">", faces=faces), text.encode()):
        soup = read_ply(content)
        assert soup.sizes.tolist() == [4, 3, 6, 3]
        assert soup.corners.tolist() == list(chain(*faces))


def strips(order, rows, faces=(), kind="int", code="i"):
    """A file of strips, with faces before them, as text or binary."""
    head = f"ply\nformat {ORDERS.get(order, 'ascii')} 1.0\n{VERTEX}"
    head += f"element face {len(faces)}\n{LIST}" if faces else ""
    head += f"element tristrips {len(rows)}\nproperty list int {kind} vertex_indices\nend_header\n"
    if not order:
        texts = [f"{len(row)} {' '.join(map(str, row))}\n" for row in [*faces, *rows]]
        return (head + POINTS + "".join(texts)).encode()
    body = b"".join(struct.pack(f"{order}i{len(row)}{code}", len(row), *row) for row in rows)
    return head.encode() + VERTS.astype(order + "f4").tobytes() + packed(order, "i", faces) + body


@over("order", ["", *ORDERS])
@over(
    ("rows", "faces"),
    [
        ([STRIP], [FACES[0]]),
        ([[*STRIP, -1, 0, 2, 1]], []),
        ([[-1, -1, *STRIP, -1, -1, 2, 1, 0, -1]], []),
        ([STRIP, [0, 2, 1]], []),
        ([[0, 1, 3, 2], [0, 2, 1]], [FACES[3]]),
        ([[*STRIP, 0, 0, 2, 1]], []),  # joined by triangles without area
        ([[1, 1, 0, 3], [1, 2, 3, 0], [], [2, 1, 0]], []),
        ([[0, 1, 3, 2, -1, 3, 2, 0, 1, -1, 3]], []),  # a strip of one vertex has no triangle
    ],
)
def test_triangle_strips(order, rows, faces):
    assert is_tetrahedron(read_ply(strips(order, rows, faces)))


def test_the_restart_of_an_unsigned_strip():
    assert is_tetrahedron(read_ply(strips("<", [[*STRIP, 2**32 - 1, 0, 2, 1]], kind="uint", code="I")))


@pytest.mark.filterwarnings("ignore:.*inside out")
def test_every_other_triangle_of_a_strip_is_turned_so_that_a_band_is_oriented(tmp_path):
    (tmp_path / "a.ply").write_bytes(strips("", [[0, 1, 2, 3, 0, 1]]))
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.num_faces == 4
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).tolist()
    assert len({tuple(edge) for edge in edges}) == 12
    assert all(edge[::-1] in edges for edge in edges)


OTHERS = {
    "multi_patch": "element multi_patch 1\nproperty list int int vertex_indices\nend_header\n",
    "polyline": "element polyline 1\nproperty uchar red\nproperty list uchar ushort vertex_index\nend_header\n",
}


@over("name", OTHERS)
def test_elements_with_indices_that_are_passed_over_are_named(name):
    row = "3 0 1 2\n" if name == "multi_patch" else "9 3 0 1 2\n"
    with pytest.warns(MeshfitWarning, match=rf"^passed over elements with lists of indices: '{name}'$"):
        soup = read_ply((TEXT.replace("end_header\n", OTHERS[name]) + row).encode())
    assert is_tetrahedron(soup)
    alone = (f"ply\nformat ascii 1.0\n{VERTEX}{OTHERS[name]}" + POINTS + row).encode()
    with pytest.raises(MeshError, match=rf"^its surface is in elements '{name}'; expected 'face' or 'tristrips'$"):
        read_ply(alone)


def test_a_grid_of_scanned_points_has_no_faces(tmp_path):
    grid = f"ply\nformat ascii 1.0\nobj_info num_cols 2\n{VERTEX}element range_grid 4\n{LIST}end_header\n{POINTS}"
    (tmp_path / "a.ply").write_text(grid + "1 0\n1 1\n1 2\n0\n")
    with (
        pytest.warns(MeshfitWarning, match=r"a\.ply: passed over elements with lists of indices: 'range_grid'$"),
        pytest.raises(MeshError, match="expected a surface, got a cloud of 4 points and no faces"),
    ):
        load_mesh(tmp_path / "a.ply")


@over("content", [TEXT.encode() + b"7\nand more\n", binary() + b"7 and more\n"])
def test_bytes_after_the_last_element_are_warned_of(content):
    with pytest.warns(MeshfitWarning, match=r"^passed over 11 bytes after its last element$"):
        assert is_tetrahedron(read_ply(content))


REFUSED = {
    "its header has two elements 'face'": TEXT.replace("end_h", f"element face 1\n{LIST}end_h") + "3 0 1 2\n",
    "'vertex' has two properties 'x'": HEADER.replace(XYZ, XYZ + "property float x\n")
    + POINTS.replace("\n", " 0\n")
    + ROWS,
    "line 11: more numbers than the header announces": HEADER
    + f"{POINTS}{ROWS} 9".replace("\n", " ").replace(" 3 0 2", "\n3 0 2"),
    "line 11: expected a number, got '1,5'": HEADER + POINTS.replace("0 0 0\n1", "0 0 0\n1,5", 1) + ROWS,
    "line 14: expected a number, got 'x'": HEADER + POINTS + ROWS.replace("3 0 2", "x 0 2"),
    "line 10: expected a number, got '1_0'": HEADER + POINTS.replace("0 0 0", "1_0 0 0") + ROWS,
    "line 14: expected the length of a list, got 3.5": HEADER + POINTS + ROWS.replace("3 0 2", "3.5 0 2"),
    "line 14: expected the length of a list, got nan": HEADER + POINTS + ROWS.replace("3 0 2", "1.#IND 0 2"),
    "'face' has corners that are not vertex indices: 0.5": HEADER + POINTS + ROWS.replace("3 0 2", "3 0.5 2"),
    "'face' has corners that are not vertex indices: inf": HEADER + POINTS + ROWS.replace("3 0 2", "3 inf 2"),
    "face 1: expected a face of 3 or more corners, got 2": HEADER + POINTS + "3 0 2 1\n2 0 1\n3 1 2 3\n3 2 0 3\n",
    "the length of list 'vertex_indices' is of type float; allowed: integer types": TEXT.replace("uchar", "float"),
    "unknown format 'binary'; allowed: ascii, binary_little_endian, binary_big_endian": TEXT.replace("ascii", "binary"),
    "'vertex' has no property 'x'; it has X, y, z": TEXT.replace("float x", "float X"),
    "expected one number per 'vertex', got a list as property 'x'": TEXT.replace(
        "float x", "list uchar float x"
    ).replace(POINTS, "1 0 0 0\n1 1 0 0\n1 0 1 0\n1 0 0 1\n"),
    "expected a list as property 'vertex_indices' of 'face', got one number": TEXT.replace(
        "list uchar int", "int"
    ).replace(ROWS, "3\n3\n3\n3\n"),
    "unexpected line in its header: 'format ascii 1.0'": TEXT.replace("end_h", "format ascii 1.0\nend_h"),
    "unexpected line in its header: 'element face -4'": TEXT.replace("face 4", "face -4"),
    f"unexpected line in its header: 'element face {'9' * 47}'": TEXT.replace("face 4", "face " + "9" * 5000),
    "its header has no 'end_header'": HEADER[:-11] + "\n" + POINTS,
    "it does not start with 'ply'": "plywood\n" + TEXT,
    "the file ends within 'vertex', of which it announces 999999999": TEXT.replace("vertex 4", "vertex 999999999"),
    "'vertex' has no property 'x'; it has none": TEXT.replace(
        "element vertex 4\n", "element vertex 999999999\nelement point 4\n"
    ),
}


MISFITS = {
    "line 10: expected 3 numbers of 'vertex', got 4": HEADER + POINTS.replace("\n", " 7\n") + ROWS,
    "line 10: expected 3 numbers of 'vertex', got 6": HEADER + POINTS.replace("\n", " 3 0 1\n") + ROWS,
    "line 11: expected 4 numbers of 'vertex', got 3": HEADER.replace(XYZ, XYZ + "property float a\n") + POINTS + ROWS,
    "line 13: expected 4 numbers of 'face', got 3": HEADER.replace("vertex 4", "vertex 3")
    + POINTS[:-6]
    + "3 1 1\n"
    + ROWS,
    "line 14: expected 3 numbers of 'vertex', got 4": TEXT.replace("vertex 4", "vertex 5"),
    "line 14: expected 4 numbers of 'face', got 7": HEADER + POINTS + ROWS.replace("\n", " 255 0 0\n"),
    "line 16: expected 5 numbers of 'face', got 4": HEADER + POINTS + ROWS.replace("3 1 2 3", "4 1 2 3"),
}


@over("message", MISFITS)
def test_the_first_line_that_does_not_fit_the_header_is_named(message):
    with pytest.raises(MeshError) as caught:
        read_ply(MISFITS[message].encode())
    assert str(caught.value) == message


@over("message", REFUSED)
def test_what_is_wrong_is_named(message):
    with pytest.raises(MeshError) as caught:
        read_ply(REFUSED[message].encode())
    assert str(caught.value) == message


@over("spelling", ["-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND00", "1.#INF", "nan", "-inf", "1e999"])
def test_coordinates_that_are_not_finite_are_refused_with_their_vertex(tmp_path, spelling):
    (tmp_path / "a.ply").write_text(HEADER + POINTS.replace("1 0 0", f"1 {spelling} 0") + ROWS)
    with pytest.raises(MeshError, match="vertex 1 has a coordinate that is not finite"):
        load_mesh(tmp_path / "a.ply")


def test_a_property_beside_words_that_are_no_numbers():
    content = (
        HEADER.replace(XYZ, XYZ + "property float a\nproperty float b\n") + POINTS.replace("\n", " 0.1 ?\n") + ROWS
    )
    assert read_ply_property(content.encode(), "a").tolist() == [0.1] * 4
    with pytest.raises(MeshError, match=r"^line 12: expected a number, got '\?'$"):
        read_ply_property(content.encode(), "b")
