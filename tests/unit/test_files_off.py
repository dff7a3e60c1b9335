"""OFF files: keywords, counts and numbers on any lines, columns that nobody wants, wrong counts."""

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.io.off import read_off
from meshfit.mesh.polygons import PolygonSoup
from tests.loops import over

VERTS = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 1 / 3, -1e-30]]
FACES = [[0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
PYRAMID = PolygonSoup.of_rows(VERTS, FACES)
POINTS = "".join(" ".join(map(repr, vert)) + "\n" for vert in VERTS)
CORNERS = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in FACES)
OFF = f"OFF\n5 5 8\n{POINTS}{CORNERS}"
KEYWORDS = {
    "OFF": 0,
    "off": 0,
    "": 0,
    "COFF": 4,
    "NOFF": 3,
    "CNOFF": 7,
    "STOFF": 2,
    "STCNOFF": 9,
    "NCOFF": 7,
    "coff": 4,
    " OFF": 0,
    "#a\n\nOFF": 0,
}


def same(found, expected=PYRAMID):
    return all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


def columns(count):
    """Vertices with more numbers after their coordinates."""
    return POINTS.replace("\n", " 0.25" * count + "\n")


@over(
    "counts",
    [
        " 5 5 8\n",
        "5 5 8\n",
        "\n5 5 8\n",
        "\n\n# c\n 5 5 8 # d\n",
        " 5 5\n",
        "\n5 5\n",
        "\n5\n5\n8\n",
        " 5\n5 8\n",
        "\n5 5\n8\n",
    ],
)
@over("keyword", KEYWORDS)
def test_keywords_and_counts_on_any_lines(keyword, counts):
    head = (keyword + counts).encode() if keyword or not counts.startswith("\n#") else counts.encode()
    body = (columns(KEYWORDS[keyword]) + CORNERS).encode()
    for line_end in (b"\n", b"\r\n", b"\r"):
        assert same(read_off((head + body).replace(b"\n", line_end))), head
    words = columns(KEYWORDS[keyword]).replace(" ", "\n") + CORNERS.replace("\n", " ")
    assert same(read_off(head + words.encode())), head


FACE_COLOURS = ["", " 255 0 0", " 0.1 0.2 0.3", " 7", " 1 0 0 0.5", " 0.1 0.2 0.3 1.0 # x"]
BODIES = {
    "blank lines": f"\n{POINTS}\n \t\n{CORNERS}\n\n",
    "leading blanks": "".join(f"  {line}\n" for line in (POINTS + CORNERS).splitlines()),
    "comments": (POINTS + CORNERS).replace("\n", " # 1 2\n# 3 4 5\n"),
    "colours of vertices without a keyword": columns(4) + CORNERS,
    "colours of some vertices": POINTS.replace("0.0 1 0\n", "0.0 1 0 255 0 0 255\n") + CORNERS,
    "two vertices per line": POINTS.replace("\n", "  ", 1) + CORNERS,
    "all on one line": (POINTS + CORNERS).replace("\n", " "),
    "one number per line": (POINTS + CORNERS).replace(" ", "\n"),
    "two faces per line": POINTS + CORNERS.replace("\n", " ", 1),
    "faces over lines": POINTS + CORNERS.replace(" 2 ", "\n2 "),
    "colours after vertices over lines": POINTS.replace(" ", "\n") + CORNERS.replace("\n", " 0.5 0.5 0.5\n"),
    "no line end": (POINTS + CORNERS).rstrip(),
    "end marks of old systems": POINTS + CORNERS + "\x1a\0\0",
} | {f"colours{end}": POINTS + CORNERS.replace("\n", end + "\n") for end in FACE_COLOURS} | {
    f"one colour{end}": POINTS + CORNERS.replace("\n", end + "\n", 1) for end in FACE_COLOURS
}  # fmt: skip


@over("name", BODIES)
@over("head", ["OFF\n5 5 8\n", "OFF5 5 8\n", "\ufeffOFF 5 5\n", "5 5 0\n"])
def test_numbers_on_any_lines(head, name):
    assert same(read_off((head + BODIES[name]).encode()))


REFUSED = {
    "line 1: expected 'OFF' in three dimensions, got '4OFF'": "4" + OFF,
    "line 2: expected 'OFF' in three dimensions, got 'nOFF'": "\nn" + OFF,
    "line 1: expected 'OFF' as text, got 'OFF BINARY'": "OFF BINARY\n" + "\0" * 40,
    "line 1: expected 'OFF', got 'Dear'": "Dear all,\nplease find the model attached.\n",
    "line 1: expected 'OFF', got 'OFFICE'": OFF.replace("OFF", "OFFICE"),
    "line 1: expected the numbers of vertices and faces": "OFF",
    "line 2: expected the numbers of vertices and faces": OFF.replace("5 5 8", "5 -5 8"),
    "line 2: expected integers, got '5 x'": OFF.replace("5 5 8", "5 x 8"),
    "line 2: expected the numbers of vertices, faces and edges, got '8.5'": OFF.replace("5 5 8", "5 5 8.5"),
    "line 13: more lines than the header's 5 vertices and 5 faces": OFF + "3 0 1 2\n",
    "the file ends after 4 of 5 faces": OFF.replace("3 3 0 4\n", ""),
    "the file ends after 5 of 99999 vertices": OFF.replace("5 5 8", "99999 0 0").partition("4 0 3")[0],
    "line 8: expected a face of 9 corners, got 4": OFF.replace("4 0 3 2 1", "9 0 3 2 1"),
    "line 9: expected a face of 3 or more corners, got 2": OFF.replace("3 0 1 4", "2 0 1"),
    "line 9: expected integers, got '0 1.5 4'": OFF.replace("3 0 1 4", "3 0 1.5 4"),
    "line 4: expected three numbers, got '1,5 0 0'": OFF.replace("1 0 0\n", "1,5 0 0\n"),
    "line 4: expected a vertex of 3 coordinates, got 2": OFF.replace("1 0 0\n", "1 0\n"),
}


@over("message", REFUSED)
def test_what_is_wrong_is_named(message):
    with pytest.raises(MeshError) as caught:
        read_off(REFUSED[message].encode())
    assert str(caught.value) == message


@over("spelling", ["nan", "-inf", "-nan(ind)", "1.#QNAN"])
def test_what_is_not_finite_is_left_for_the_check_of_the_mesh(spelling):
    assert not np.isfinite(read_off(OFF.replace("1 0 0\n", f"1 {spelling} 0\n").encode()).verts[1, 1])
