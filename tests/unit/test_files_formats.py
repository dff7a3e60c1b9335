"""Variants of OBJ, OFF, PLY and STL that programs write."""

import struct

import numpy as np
import pytest

from meshfit.errors import MeshfitWarning
from meshfit.mesh.geometry import area_vectors, face_areas
from meshfit.mesh.io.files import FORMATS, READABLE_FORMATS, load_mesh
from meshfit.mesh.topology import Topology
from meshfit.paths import MESH_SUFFIXES, WRITABLE_SUFFIXES
from tests.loops import over

VERTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
OFF = "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
HEADER = (
    "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
)
ROWS = OFF.partition("4 4 6\n")[2]
COLOURS = HEADER.replace("float z\n", "float z\nproperty uchar red\nproperty uchar green\n")
COLOURED = "0 0 0 7 8\n1 0 0 7 8\n0 1 0 7 8\n0 0 1 7 8\n"
FACE_ROWS = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
SOLID = "".join(
    "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n".format(
        "".join("vertex {} {} {}\n".format(*VERTS[v]) for v in face)
    )
    for face in FACES
)
VARIANTS = {
    "obj.obj": OBJ,
    "windows lines.obj": OBJ.replace("\n", "\r\n"),
    "old lines.obj": OBJ.replace("\n", "\r"),
    "tabs.obj": OBJ.replace(" ", "\t"),
    "byte order mark.obj": "\ufeff" + OBJ,
    "comments.obj": "# a\n" + OBJ.replace("f 1 3 2", "f 1 3 2 # b\n\n"),
    "groups.obj": "o a\ng b\ns off\n" + OBJ.replace("f 2", "usemtl c\ng d e\nf 2") + "l 1 2\np 1\n",
    "continued.obj": OBJ.replace("f 1 3 2", "f 1 \\\n3 2"),
    "colours.obj": OBJ.replace("\nv", " 0.5 0.5 0.5\nv"),
    "homogeneous.obj": OBJ.replace("\nv", " 1.0\nv"),
    "backwards.obj": OBJ.replace("f 3 1 4", "f -2 -4 -1"),
    "backwards from the middle.obj": OBJ.replace("v 0 0 1\n", "")
    .replace("f 1 2 4", "f -3 -1 -2\nv 0 0 1\nf 1 2 4", 1)
    .replace("f 1 3 2\n", ""),
    "faces first.obj": "\n".join(sorted(OBJ.split("\n"), key=lambda line: line[:1] != "f")),
    "off.off": OFF,
    "counts on the first line.off": OFF.replace("OFF\n", "OFF "),
    "two counts.off": OFF.replace("4 4 6", "4 4"),
    "comments.off": "# a\n" + OFF.replace("4 4 6\n", "# b\n\n4 4 6 # c\n# d\n").replace("3 0 2 1", "# e\n3 0 2 1"),
    "colours.off": OFF.replace("OFF", "COFF").replace("1 0 0\n", "1 0 0 255 0 0 255\n") + "\n\n",
    "face colours.off": OFF.replace("3 0 2 1", "3 0 2 1 0.1 0.2 0.3"),
    "ascii.ply": HEADER + ROWS,
    "windows lines.ply": (HEADER + ROWS).replace("\n", "\r\n"),
    "vertex_index.ply": HEADER.replace("indices", "index") + ROWS,
    "sized names.ply": HEADER.replace("float", "float64").replace("uchar int", "uint8 int32") + ROWS,
    "colours.ply": COLOURS + COLOURED + FACE_ROWS,
    "other elements.ply": HEADER.replace("element face", "element edge 2\nproperty int a\nproperty int b\nelement face")
    + ROWS.replace("3 0 2 1", "0 1\n1 2\n3 0 2 1", 1),
    "ascii.stl": f"solid a\n{SOLID}endsolid a\n",
}


@over("name", VARIANTS)
@pytest.mark.filterwarnings("ignore:.*colours.* are not read from OFF")
def test_all_ways_of_writing_a_tetrahedron_give_the_same_mesh(tmp_path, name):
    (tmp_path / name).write_text(VARIANTS[name], encoding="utf-8", newline="")
    found = load_mesh(tmp_path / name)
    assert sorted(map(tuple, np.round(found.verts, 12).tolist())) == sorted(map(tuple, VERTS.tolist()))
    expected = sorted(map(sorted, VERTS[FACES].tolist()))
    assert sorted(map(sorted, found.verts[found.faces].tolist())) == expected
    if "stl" not in name:
        assert np.array_equal(found.verts, VERTS)


def binary_ply(order, kinds, faces, verts=VERTS):
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = (
        HEADER.replace("ascii", name)
        .replace("float", kinds[0])
        .replace("face 4", f"face {len(faces)}")
        .replace("vertex 4", f"vertex {len(verts)}")
    )
    rows = b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return head.encode() + verts.astype(order + kinds[1]).tobytes() + rows


@over("kinds", [("float", "f4"), ("double", "f8")])
@over("order", ["<", ">"])
def test_binary_ply_of_either_byte_order(tmp_path, order, kinds):
    (tmp_path / "a.ply").write_bytes(binary_ply(order, kinds, FACES.tolist()))
    found = load_mesh(tmp_path / "a.ply")
    assert np.array_equal(found.verts, VERTS)
    assert np.array_equal(found.faces, FACES)


def test_the_table_of_formats_has_the_suffixes_that_the_command_line_completes():
    assert tuple(READABLE_FORMATS) == MESH_SUFFIXES
    assert tuple(FORMATS) == WRITABLE_SUFFIXES


PENTAGON = [[0.0, 0, 0], [2, 0, 0], [3, 1, 0], [1, 3, 0], [-1, 1, 0]]
HOUSE = [(0, 1, 2, 3, 4), (0, 1, 2), (0, 2, 3, 4)]


@over("polygon", HOUSE)
@over("suffix", [".obj", ".off", ".ply"])
def test_polygons_become_triangles_of_the_same_area(tmp_path, suffix, polygon):
    rows = "\n".join(" ".join(map(str, vert)) for vert in PENTAGON)
    corners = " ".join(map(str, polygon))
    head = HEADER.replace("vertex 4", "vertex 5").replace("face 4", "face 1")
    text = {
        ".obj": "".join("v {} {} {}\n".format(*vert) for vert in PENTAGON)
        + "f "
        + " ".join(str(corner + 1) for corner in polygon),
        ".off": f"OFF\n5 1 0\n{rows}\n{len(polygon)} {corners}\n",
        ".ply": f"{head}{rows}\n{len(polygon)} {corners}\n",
    }[suffix]
    (tmp_path / f"a{suffix}").write_text(text)
    with pytest.warns(MeshfitWarning):
        found = load_mesh(tmp_path / f"a{suffix}")
    assert found.num_faces == len(polygon) - 2
    x, y = np.array(PENTAGON)[list(polygon), :2].T
    shoelace = 0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    assert area_vectors(found).sum(axis=0) == pytest.approx([0, 0, shoelace])
    assert face_areas(found).sum() == pytest.approx(shoelace)


def test_polygons_of_several_sizes_in_one_binary_ply(tmp_path):
    """A pyramid: four triangles about a square."""
    verts = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]])
    sides = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    (tmp_path / "a.ply").write_bytes(binary_ply("<", ("float", "f4"), [*sides, [0, 3, 2, 1]], verts))
    found = load_mesh(tmp_path / "a.ply")
    assert np.array_equal(found.verts, verts)
    assert found.faces[:4].tolist() == sides
    assert sorted(found.faces[4:].reshape(-1).tolist()) in ([0, 0, 1, 2, 2, 3], [0, 1, 1, 2, 3, 3])
    assert Topology.of(found).is_watertight


@pytest.mark.filterwarnings("ignore:.*inside out")
def test_objects_of_one_file_make_one_mesh(tmp_path):
    moved = OBJ.replace("v 0", "v 5").replace("v 1", "v 6")
    second = "".join(
        "f " + " ".join(str(int(word) + 4) for word in line.split()[1:]) + "\n" if line[0] == "f" else line + "\n"
        for line in moved.splitlines()
    )
    (tmp_path / "a.obj").write_text(f"o a\n{OBJ}o b\n{second}")
    (tmp_path / "a.stl").write_text(
        f"solid a\n{SOLID}endsolid a\nsolid b\n{SOLID.replace('x 0', 'x 5').replace('x 1', 'x 6')}endsolid b\n"
    )
    for name in ("a.obj", "a.stl"):
        with pytest.warns(MeshfitWarning, match="2 separate components"):
            found = load_mesh(tmp_path / name)
        assert (found.num_verts, found.num_faces) == (8, 8)
