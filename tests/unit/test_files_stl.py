"""STL files, text and binary, as programs write them, and cut short or damaged."""

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.stl import read_stl, write_stl
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from tests.loops import over

VERTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
TETRAHEDRON = Mesh(VERTS, FACES)
BINARY = write_stl(TETRAHEDRON)


def facet(face, move=0.0, normal="0 0 0"):
    rows = "".join("   vertex {} {} {}\n".format(*(VERTS[v] + [move, 0, 0])) for v in face)
    return f" facet normal {normal}\n  outer loop\n{rows}  endloop\n endfacet\n"


FACETS = "".join(facet(face) for face in FACES)
TEXT = f"solid A\n{FACETS}endsolid A\n"
SECOND = "".join(facet(face, 5.0) for face in FACES)


def is_tetrahedron(soup):
    return np.array_equal(soup.verts[soup.corners].reshape(-1, 3, 3), VERTS[FACES])


VARIANTS = {
    "plain": TEXT,
    "blanks before": " \n\t" + TEXT,
    "byte order mark": "\ufeff" + TEXT,
    "CRLF": TEXT.replace("\n", "\r\n"),
    "CR": TEXT.replace("\n", "\r"),
    "capitals": TEXT.upper(),
    "no name": TEXT.replace(" A", ""),
    "no endsolid": TEXT.replace("endsolid A\n", ""),
    "end solid": TEXT.replace("endsolid", "end solid").replace("endloop", "end loop").replace("endfacet", "end  facet"),
    "no endfacet": TEXT.replace(" endfacet\n", ""),
    "no endloop": TEXT.replace("  endloop\n", ""),
    "no solid": FACETS,
    "a name of keywords": TEXT.replace(" A", " vertex endloop facet normal"),
    "a name of keywords once": TEXT.replace("d A", "d solid endsolid outer loop vertex 0 0 0 facet", 1),
    "a name with accents": TEXT.replace(" A", " pièce № 1"),
    "all on one line": TEXT.replace("endsolid A", "").replace("\n", " "),
    "all on one line with its end": TEXT.replace("\n", " "),
    "one word per line": "solid A\n" + FACETS.replace(" ", "\n") + "endsolid A",
    "an empty solid before": "solid\nendsolid\n" + TEXT,
    "two solids": f"solid A\n{facet(FACES[0])}endsolid A\nsolid B\n{''.join(map(facet, FACES[1:]))}endsolid B\n",
    "facets after the last endsolid": f"solid A\n{facet(FACES[0])}endsolid A\n{''.join(map(facet, FACES[1:]))}",
    "normals not finite": TEXT.replace("normal 0 0 0", "normal -nan(ind) 1.#QNAN nan"),
    "no normals": TEXT.replace("facet normal 0 0 0", "facet"),
    "normals of two numbers": TEXT.replace("normal 0 0 0", "normal 0 0", 1),
    "exponents": TEXT.replace("1.0", "+1.E+00"),
    "zero bytes after": TEXT + "\0" * 40,
}


@over("name", VARIANTS)
def test_all_ways_of_writing_a_text_are_read_alike(name):
    assert is_tetrahedron(read_stl(VARIANTS[name].encode()))


@over("last", ["endsolid B\n", ""])
def test_every_facet_of_every_solid_counts(tmp_path, last):
    (tmp_path / "a.stl").write_text(f"{TEXT}solid B\n{SECOND}{last}")
    with pytest.warns(MeshfitWarning, match="2 separate components"):
        mesh = load_mesh(tmp_path / "a.stl")
    assert (mesh.num_verts, mesh.num_faces) == (8, 8)


@over("names", ["endsolid A\n", ""])
def test_a_text_cut_anywhere_is_refused_or_ends_with_a_whole_facet(names):
    content = f"solid A\n{FACETS}{names}"
    ends = [len("solid A\n") + len("".join(facet(face) for face in FACES[:count])) for count in range(5)]
    for length in range(10, len(content)):
        try:
            whole = len(read_stl(content[:length].encode()).verts) // 3
        except MeshError:
            continue
        assert ends[whole] - len(" endfacet\n") - 1 <= length
        assert whole == 4 or length < ends[whole] + len(" facet")


REFUSED = {
    "expected a loop of 3 vertices, got 2 in facet 1, which begins on line 2": TEXT.replace(
        "   vertex 0.0 0.0 0.0\n", "", 1
    ),
    "expected a loop of 3 vertices, got 4 in facet 4, which begins on line 23": "   vertex 9 9 9\n  endloop".join(
        TEXT.rsplit("  endloop", 1)
    ),
    "expected a loop of 3 vertices, got 2 in facet 2, which begins on line 9": f"solid A\n{facet(FACES[0])}"
    + facet(FACES[1][:2]) + facet([*FACES[2], 0]),
    "the file is cut short inside facet 4, which begins on line 23": TEXT[: TEXT.rindex("  endloop")],
    "line 5: expected three numbers, got '0.0 1,0 0.0'": TEXT.replace("0.0 1.0 0.0", "0.0 1,0 0.0", 1),
    "line 5: expected a vertex of 3 coordinates, got 2": TEXT.replace("0.0 1.0 0.0", "0.0 1.0", 1),
    "line 5: expected a facet, a loop or a vertex, got '7'": TEXT.replace("0.0 1.0 0.0", "0.0 1.0 0.0 7", 1),
    "line 8: expected a facet, a loop or a vertex, got 'colour'": TEXT.replace(" endfacet", " colour 1", 1),
    "line 9: a vertex outside of a facet": f"solid A\n{facet(FACES[0])}   vertex 1 0 0\n{SECOND}",
    "the file is cut short after facet 4": TEXT[: TEXT.rindex("id A")],
    "the file is cut short inside facet 3, which begins on line 16": TEXT[: TEXT.rindex("ndfacet", 0, -60)],
    "line 1: expected a facet, a loop or a vertex, got 'Dear'": "Dear all,\nplease find the model attached." * 9,
}  # fmt: skip


@over("message", REFUSED)
def test_what_is_wrong_with_a_text_is_named(message):
    with pytest.raises(MeshError) as caught:
        read_stl(REFUSED[message].encode())
    assert str(caught.value) == message


def test_a_text_coordinate_that_is_not_finite_is_refused_with_its_vertex(tmp_path):
    for spelling in ("nan", "-inf", "1e999", "-nan(ind)", "1.#QNAN"):
        (tmp_path / "a.stl").write_text(TEXT.replace("vertex 0.0 1.0", f"vertex 0.0 {spelling}", 1))
        with pytest.raises(MeshError, match="vertex 1 has a coordinate that is not finite"):
            load_mesh(tmp_path / "a.stl")


def with_count(content, count):
    return content[:80] + (count % 2**32).to_bytes(4, "little") + content[84:]


@over("header", [b"solid A", b" facet normal 0 0 0 outer loop vertex", b"\xef\xbb\xbfsolid", b""])
def test_a_binary_file_may_have_any_header(header):
    assert is_tetrahedron(read_stl(header.ljust(80, b" ") + BINARY[80:]))
    with pytest.warns(MeshfitWarning, match="passed over 7 bytes"):
        assert is_tetrahedron(read_stl(header.ljust(80, b"\0") + BINARY[80:] + b"trailer"))


@over("count", [0, -1])
def test_a_placeholder_for_the_number_of_facets_is_warned_of(count):
    with pytest.warns(
        MeshfitWarning, match=rf"^its header announces {count % 2**32:,} facet(s)?; read the 4 that are there$"
    ):
        assert is_tetrahedron(read_stl(with_count(BINARY, count)))


@over("trailer", [b"\0" * 7, b"7 bytes", b"x" * 49, b"x" * 51, b"x" * 120])
def test_bytes_after_the_last_facet_are_warned_of_with_both_numbers(trailer):
    expected = rf"^passed over {len(trailer)} bytes? after the last of 4 facets$"
    with pytest.warns(MeshfitWarning, match=expected):
        assert is_tetrahedron(read_stl(BINARY + trailer))


WRONG_COUNTS = {
    "its header announces 5 facets, but the file has 4": with_count(BINARY, 5),
    "its header announces 3 facets, but the file has 4": with_count(BINARY, 3),
    "its header announces 4,294,967,294 facets, but the file has 4": with_count(BINARY, -2),
    "its header announces 4 facets, but the file has 3": BINARY[:-1],
    "its header announces 0 facets, but the file has 4": with_count(BINARY, 0) + b"more",
    "it has 83 bytes, but a binary file begins with 84, a text with 'solid'": BINARY[:83],
}


@over("message", WRONG_COUNTS)
def test_numbers_of_facets_that_differ_are_both_named(message):
    with pytest.raises(MeshError) as caught:
        read_stl(WRONG_COUNTS[message])
    assert str(caught.value) == message


def test_written_normals_are_unit_and_point_outwards():
    mesh = icosahedron()
    flat = Mesh([*mesh.verts, [9.0, 0, 0], [9, 1, 0], [9, 2, 0]], [*mesh.faces, [12, 13, 14]])
    content = write_stl(flat)
    rows = np.frombuffer(content[84:], np.dtype([("floats", "<f4", (4, 3)), ("attributes", "<u2")]))
    assert (len(content), int.from_bytes(content[80:84], "little")) == (84 + 50 * 21, 21)
    assert not content.startswith(b"solid")
    normals, corners = rows["floats"][:, 0], rows["floats"][:, 1:]
    assert np.array_equal(corners, flat.verts[flat.faces].astype(np.float32))
    middle = mesh.verts[mesh.faces].mean(axis=1)
    expected = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, [*expected, [0, 0, 0]], atol=1e-6)
    assert face_areas(flat)[-1] == 0.0
    assert not rows["attributes"].any()
