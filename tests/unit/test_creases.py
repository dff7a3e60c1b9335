"""Creases given by edges or by a file with the vertex numbers of a mesh file, and their refusals."""

from math import inf, nan

import numpy as np
import pytest

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.io.files import load_mesh_with_vertex_map, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, octahedron
from meshfit.mesh.topology import NONE, Topology
from meshfit.subdivision.creases import Creases, creases_by_angle, read_creases
from meshfit.subdivision.limit import loop_limit, loop_limit_normals
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import SCHEMES, resolve
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open

SOLID = Topology.of(octahedron())
SAME = VertexMap(np.arange(6))


def read(tmp_path, text: str, numbering=SAME, **given) -> Creases:
    path = tmp_path / "creases.txt"
    path.write_text(text, encoding="utf-8")
    return read_creases(path, SOLID, numbering, **given)


def listed(creases: Creases) -> dict[tuple[int, int], float]:
    return {(int(a), int(b)): float(s) for (a, b), s in zip(SOLID.edges, creases.sharpness, strict=True) if s}


def test_a_file_lists_edges_with_sharpness_or_without_and_corners(tmp_path):
    text = "# a comment\n0 2\n4 1 1.5   # another\n\n 3\n5 0 inf\n2 0\n2 4 0\n"
    creases = read(tmp_path, text)
    assert listed(creases) == {(0, 2): inf, (1, 4): 1.5, (0, 5): inf}
    assert np.flatnonzero(creases.corners).tolist() == [3]
    assert listed(read(tmp_path, text, sharpness=2)) == {(0, 2): 2, (1, 4): 1.5, (0, 5): inf}


def test_a_file_may_list_corners_only(tmp_path):
    creases = read(tmp_path, "1\r\n2\r\n")
    assert not creases.sharpness.any()
    assert creases.corners.sum() == 2


def test_numbers_are_those_of_the_mesh_file(tmp_path):
    creases = read(tmp_path, "7 3\n9\n", numbering=VertexMap(np.array([NONE, 5, 4, 0, 1, 2, 3, 2, NONE, 1])))
    assert listed(creases) == {(0, 2): inf}
    assert np.flatnonzero(creases.corners).tolist() == [1]


BAD_LINES = {
    "a b": "line 1: found 'a b'; expected a crease 'a b' or 'a b sharpness', or a corner 'a'",
    "0 2\n0 2 1 4": "line 2: found '0 2 1 4'; expected a crease",
    "0.5 2": "line 1: found '0.5 2'",
    "0 2 soft": "line 1: found '0 2 soft'",
    "0 2 -1": "line 1: sharpness -1 is not allowed: expected 0 or more, or inf",
    "0 2 nan": "line 1: sharpness nan is not allowed",
    "# only\n\n0 6": r"line 3: vertex 6: the mesh file has vertices 0 to 5",
    "-1 0": "line 1: vertex -1: the mesh file",
    "6": "line 1: vertex 6",
    "0 1": "line 1: the mesh has no edge between vertices 0 and 1",
    "2 2": "line 1: the mesh has no edge between vertices 2 and 2",
    "0 2 1\n2 0 2": r"line 2: edge \(2, 0\) is a duplicate, listed before with sharpness 1",
    "": "no creases or corners in it",
    "# nothing\n": "no creases or corners in it",
}


@pytest.mark.parametrize("text", BAD_LINES)
def test_lines_that_are_refused(tmp_path, text):
    with pytest.raises(MeshError, match=rf"creases\.txt[:,] ?.*{BAD_LINES[text]}"):
        read(tmp_path, text)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(MeshError, match=r"gone\.txt: no such file"):
        read_creases(tmp_path / "gone.txt", SOLID, SAME)
    with pytest.raises(MeshError, match="expected a file, got a directory"):
        read_creases(tmp_path, SOLID, SAME)
    (tmp_path / "binary").write_bytes(bytes(range(128, 256)))
    with pytest.raises(MeshError, match="not a text file in UTF-8"):
        read_creases(tmp_path / "binary", SOLID, SAME)


def test_a_vertex_that_was_dropped_is_named(tmp_path):
    with pytest.raises(MeshError, match="line 1: vertex 3 was dropped when the mesh was read"):
        read(tmp_path, "3 0", numbering=VertexMap(np.array([0, 1, 2, NONE, 3, 4, 5])))


@pytest.mark.filterwarnings("ignore::meshfit.errors.MeshfitWarning")
def test_the_numbering_of_a_file_with_a_seam_and_spare_verts(tmp_path):
    """A cube whose faces have verts of their own, with two verts more that no face uses."""
    solid = cube()
    soup = Mesh(
        np.concatenate([[[9, 9, 9]], solid.verts[solid.faces].reshape(-1, 3), [[8, 8, 8]]]),
        1 + np.arange(36).reshape(12, 3),
    )
    save_mesh(soup, tmp_path / "soup.obj")
    mesh, numbering = load_mesh_with_vertex_map(tmp_path / "soup.obj")
    assert (mesh.num_verts, numbering.num_file_verts) == (8, 38)
    assert np.flatnonzero(numbering.first == NONE).tolist() == [0, 37]
    assert np.array_equal(mesh.verts[numbering.first[1:37]], soup.verts[1:37])
    (tmp_path / "creases.txt").write_text("1 2\n")
    topology = Topology.of(mesh)
    creases = read_creases(tmp_path / "creases.txt", topology, numbering)
    ends = mesh.verts[topology.edges[np.isinf(creases.sharpness)]]
    assert ends.shape == (1, 2, 3)
    assert {tuple(end) for end in ends[0]} == {tuple(vert) for vert in soup.verts[1:3]}


@over("name", [name for name in SCHEMES if SCHEMES[name].domain == "triangles"])
def test_schemes_take_creases_or_refuse_them_by_name_of_those_that_do(name):
    mesh = mixed_closed()
    creases = creases_by_angle(mesh, 10)
    if name in ("midpoint", "loop", "interp-loop"):
        assert subdivide(mesh, name, 1, creases=creases).num_verts > mesh.num_verts
        return
    for levels in (0, 1):
        with pytest.raises(SchemeError, match="takes no creases; loop, interp-loop and midpoint do"):
            subdivide(mesh, name, levels, creases=creases)


def test_creases_of_another_mesh():
    creases = creases_by_angle(mixed_closed(), 10)
    with pytest.raises(MeshError, match=r"belong to a mesh of 96 edges and 34 vertices; this mesh has \d+ edges"):
        subdivide(mixed_open(), "loop", creases=creases)


@pytest.mark.parametrize("value", [-1, -1e-9, nan, -inf])
def test_sharpness_out_of_range(value):
    for make in (
        lambda: Creases.of(SOLID, [(0, 2)], value),
        lambda: Creases.of(SOLID, [(0, 2), (0, 3)], [1, value]),
        lambda: creases_by_angle(octahedron(), 30, value),
        lambda: Creases(np.full(SOLID.num_edges, float(value)), np.zeros(6, dtype=bool)),
    ):
        with pytest.raises(SchemeError, match=r"sharpness .* is not allowed: expected 0 or more"):
            make()


def test_sharpness_of_another_number_than_the_edges():
    for given in ([1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]]):
        with pytest.raises(MeshError, match=r"expected one number, or one for each of 2 edges"):
            Creases.of(SOLID, [(0, 2), (0, 3)], np.array(given))


@pytest.mark.parametrize("sharpness", [0.0, 0.5])
def test_boundary_edges_are_sharp_whatever_is_said_of_them(sharpness):
    mesh = mixed_open()
    topology = Topology.of(mesh)
    said = Creases(np.where(topology.boundary_edges, sharpness, 0.0), np.zeros(mesh.num_verts, dtype=bool))
    expected = refine(topology, resolve("loop"), 2).matrix.toarray()
    assert np.array_equal(refine(topology, resolve("loop"), 2, said).matrix.toarray(), expected)
    assert np.array_equal(loop_limit(topology, creases=said).toarray(), loop_limit(topology).toarray())
    assert np.array_equal(loop_limit_normals(mesh, creases=said), loop_limit_normals(mesh))


@pytest.mark.parametrize("degrees", [0, -5, 181, nan, inf])
def test_angles_out_of_range(degrees):
    with pytest.raises(SchemeError, match=r"a crease angle of .* degrees is not allowed: expected more than 0"):
        creases_by_angle(octahedron(), degrees)


@pytest.mark.parametrize(
    ("edges", "corners", "message"),
    [
        ([(0, 1)], (), r"crease \(0, 1\): the mesh has no such edge"),
        ([(0, 6)], (), r"crease \(0, 6\): vertices are numbered 0 to 5"),
        ([(2, 0), (-1, 0)], (), r"crease \(-1, 0\): vertices are numbered"),
        ((), [6], "corner 6: vertices are numbered 0 to 5"),
        ((), [-1], "corner -1"),
    ],
)
def test_edges_and_corners_that_are_not_there(edges, corners, message):
    with pytest.raises(MeshError, match=message):
        Creases.of(SOLID, edges, inf, corners)


def test_a_mesh_of_verts_alone_has_no_creases_to_lay_down():
    lonely = Topology(3, np.empty((0, 3), dtype=np.int64))
    refinement = refine(lonely, resolve("interp-loop"), 2, Creases.of(lonely, corners=[1]))
    assert np.array_equal(refinement.matrix.toarray(), np.eye(3))
    with pytest.raises(MeshError, match="no such edge"):
        Creases.of(lonely, [(0, 1)])


@pytest.mark.parametrize("scale", [1e-150, 1e50])
def test_angles_do_not_depend_on_size(scale):
    solid = cube()
    assert int((creases_by_angle(Mesh(solid.verts * scale, solid.faces), 45).sharpness > 0).sum()) == 12
