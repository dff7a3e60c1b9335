"""OBJ files: decorations change nothing, whichever way the numbers are read, and faults are named with their line."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.io.obj import read_obj, read_obj_segments
from meshfit.mesh.polygons import PolygonSoup
from tests.loops import over

VERTS = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 1 / 3, -1e-30], [5, 5, 5]]
FACES = [[0, 1, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]]
PLAIN = PolygonSoup.of_rows(VERTS, FACES)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
FACE_LINES = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"

VERTEX_ENDS = ("", " 1.0", " 0.5 0.25 1", " 1 0 0 1", " \t", " # red \\", "# a\\")
CORNERS = ("{0}", "{0}/{1}", "{0}//{1}", "{0}/{1}/{2}", "{0}/", "{0}//", "{0}/{1}/")
OTHERS = (
    "p 1", "g a b", "g", "o C:\\models\\", "s off", "s 1", "usemtl C:\\a\\", "mtllib a b.mtl", "vt 0.5 0.5", "vn 0 0 1",
    "vn nan nan nan", "vp 0.1 0.2", "l 1 2", "l 1/1 2/2 3/3", "# C:\\models\\", "#", "", "  ", "\t", "unknown 7 x",
    "cstype bezier", "foo 1 2 3", "vertex 1 2 3", "deg 3", "7", "vn -1.#IND00 0 0", "g 1,5",
)  # fmt: skip


def same(found, expected=PLAIN):
    return all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


def decorated(rng, uniform):
    """The plain file with all that changes nothing: where uniform, in the same way on each line."""
    choose = rng.choice
    vertex_end, corner = choose(VERTEX_ENDS), choose(CORNERS)
    line_end, before, between = (
        choose(["\n", "\r\n", "\r"]),
        choose(["", "", " ", "\t "]),
        choose([" ", " ", "\t", "  "]),
    )
    backwards, others = rng.random() < 0.3, choose([(), OTHERS[:4], OTHERS])

    def line(keyword, words, end):
        joint = between if uniform or rng.random() < 0.9 else f" \\{choose(['', ' '])}{line_end}"
        return f"{before}{keyword}{between}{joint.join(words)}{end}"

    lines = [line("v", map(repr, vert), vertex_end if uniform else choose(VERTEX_ENDS)) for vert in VERTS]
    for face in FACES:
        form = corner if uniform else choose(CORNERS)
        numbers = [(v - len(VERTS) if backwards else v + 1, rng.randrange(1, 9), rng.randrange(1, 9)) for v in face]
        lines.append(
            line(choose(["f", "f", "fo"]), [form.format(*three) for three in numbers], choose(["", " ", "\t", " # \\"]))
        )
    for _ in range(rng.randrange(6) if others else 0):
        lines.insert(rng.randrange(len(lines) + 1), before + choose(others))
    return (choose(["", "\ufeff"]) + line_end.join(lines) + choose(["", line_end, line_end * 2])).encode()


@settings(max_examples=100, deadline=None)
@given(st.randoms(use_true_random=False), st.booleans())
def test_decorations_change_nothing(rng, uniform):
    content = decorated(rng, uniform)
    assert same(read_obj(content)), content
    found = read_obj(content + b"\nv -nan(ind) 0 0\n")  # which is not read with all others at once
    assert np.isnan(found.verts[-1]).tolist() == [True, False, False]
    assert same(found._replace(verts=found.verts[:-1])), content


def tetrahedron(content):
    """Assert that the content is one, and return nothing."""
    soup = read_obj(content.encode())
    used = soup.verts[soup.corners].reshape(-1, 3, 3)
    expected = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert np.array_equal(used, expected[[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]])


@over(
    "content",
    [
        "# C:\\models\\\n" + OBJ.replace("\n", " 1 0 0\n") + FACE_LINES,
        f"# x\\\n{OBJ}v 5 5 5\np 1\n{FACE_LINES}",
        f"mtllib C:\\models\\\n{OBJ}usemtl a\\\n{FACE_LINES}",
        OBJ.replace("v ", "v\\\n ") + FACE_LINES.replace("f ", "f \\ \n\\\n"),
        OBJ.replace("v ", "v\\\r ").replace("\n", "\r") + FACE_LINES,
        OBJ + FACE_LINES.replace("3 1 4", "3 1 \\\n4\\\n") + "\nv 9 9 9\\",
        FACE_LINES + OBJ,
        OBJ.replace("v 0 0 1\n", "v\f0\v0 1\n") + FACE_LINES,
        OBJ + FACE_LINES.replace("f 1 3 2", "f 1/1/\t3/1/1 2/1/1"),
        OBJ + FACE_LINES + "vn 1.#QNAN 0 0\nvn -1.#IND 0 0\n",
        OBJ.replace("0 0 0", "+0. -.0e5 0E-9") + FACE_LINES.replace("1", "+1").replace("2", "02"),
    ],
)
def test_unusual_ways_of_writing(content):
    tetrahedron(content)


def test_backward_indices_count_from_the_vertices_so_far():
    lines = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 2 2 2\nf -2 -1 1\nf -3/1 4/2 -4/3\n"
    for further in ("", "v nan(ind) 0 0\n"):
        assert read_obj((lines + further).encode()).corners.tolist() == [0, 1, 2, 2, 3, 0, 1, 3, 0]


def test_elements_that_are_passed_over_are_named():
    content = (
        OBJ
        + FACE_LINES
        + "vp 0.1 0.2\ncstype bspline\ndeg 3 3\nsurf 0 1 0 1 1 2 3 4\ncurv 0 1 1 2 \\\n3 4\nend\ncall b.obj\n"
    )
    message = "^passed over free-form geometry and other files: call, curv, surf$"
    for read in (read_obj, read_obj_segments):
        with pytest.warns(MeshfitWarning, match=message):
            read(content.encode())


REFUSED = {
    "line 2: expected three numbers, got '1,0 0 0'": OBJ.replace("v 1 0 0", "v 1,0 0 0") + FACE_LINES,
    "line 2: expected three numbers, got '1_0 0 0'": OBJ.replace("v 1 0 0", "v 1_0 0 0") + FACE_LINES,
    "line 4: expected a vertex of 3 coordinates, got 2": "# a\\\n\nv 0 0 0\nv 1 0 # 0\n" + FACE_LINES,
    "line 5: expected a vertex of 3 coordinates, got 0": OBJ + "v\n" + FACE_LINES,
    "line 7: expected integers, got '1 2.0 4'": OBJ.replace("v 0 0 1", "v 0 \\\n0 1")
    + FACE_LINES.replace("1 2", "1 2.0"),
    "line 6: expected integers, got '1_0 2 4'": OBJ + FACE_LINES.replace("1 2 4", "1_0 2 4"),
    "line 6: expected integers, got '/1 2 4 3'": OBJ + FACE_LINES.replace("1 2 4", "/1 2 4 3"),
    "line 6: expected integers, got '1 / 2 / 4'": OBJ + FACE_LINES.replace("1 2 4", "1 / 2 / 4"),
    "line 6: a face with vertex 0; OBJ counts from 1, or from -1 backwards": OBJ + FACE_LINES.replace("1 2 4", "0 2 4"),
    "line 6: expected a face of 3 or more corners, got 2": OBJ + FACE_LINES.replace("1 2 4", "1 2"),
    "line 6: expected a face of 3 or more corners, got 0": OBJ + FACE_LINES.replace("f 1 2 4", "f"),
    "line 8: a face with vertex 5, but the file has 4 vertices": OBJ + FACE_LINES.replace("3 1 4", "3 1/1 5/9"),
    "line 6: a face with vertex -4, but the file has 3 vertices before it": f"{OBJ[:24]}\n# a\nf -4 1 2\n{OBJ[24:]}",
    "line 6: expected integers of up to 15 digits, got '1 2 9999999999999999'": OBJ
    + FACE_LINES.replace("1 2 4", "1 2 " + "9" * 16),
}


@over("message", REFUSED)
def test_what_is_wrong_is_named_with_its_line(message):
    with pytest.raises(MeshError) as caught:
        read_obj(REFUSED[message].encode())
    assert str(caught.value) == message


@over("spelling", ["nan", "-inf", "1e999", "-nan(ind)", "1.#QNAN", "-1.#IND00"])
def test_coordinates_that_are_not_finite_are_refused_with_their_vertex(tmp_path, spelling):
    (tmp_path / "a.obj").write_text(OBJ.replace("1 0 0", f"1 {spelling} 0") + FACE_LINES)
    with pytest.raises(MeshError, match="vertex 1 has a coordinate that is not finite"):
        load_mesh(tmp_path / "a.obj")


def test_many_lines_are_read_like_few():
    rng = random.Random(0)
    verts = [[rng.gauss(0, 10.0 ** rng.randrange(-9, 9)) for _ in range(3)] for _ in range(3000)]
    faces = [[rng.randrange(3000) for _ in range(rng.randrange(3, 8))] for _ in range(3000)]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in verts] + [
        f"f {' '.join(str(v + 1) for v in face)}" for face in faces
    ]
    assert same(read_obj("\n".join(lines).encode()), PolygonSoup.of_rows(verts, faces))
