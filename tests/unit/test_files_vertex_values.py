"""Values per vertex of a mesh file, from text files and PLY properties."""

import struct

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.io.files import encode_mesh, load_mesh, load_mesh_with_vertex_map, save_mesh
from meshfit.mesh.io.vertex_values import read_vertex_property, read_vertex_values
from meshfit.mesh.solids import octahedron
from meshfit.mesh.topology import NONE
from tests.loops import over

SAME = VertexMap(np.arange(6))
VALUES = [0.0, 1.0, 0.25, 0.5, 0.125, 1e-3]


def text_file(tmp_path, text: str):
    path = tmp_path / "alpha.txt"
    path.write_text(text, encoding="utf-8")
    return path


def ply_file(tmp_path, kind: str = "ascii", name: str = "alpha", declared: str = "float"):
    """An octahedron with a property between its coordinates."""
    solid, path = octahedron(), tmp_path / "solid.ply"
    head = [
        *("ply", f"format {kind} 1.0", "element vertex 6", "property float x", f"property {declared} {name}"),
        *("property float y", "property float z", "element face 8", "property list uchar int vertex_indices"),
        "end_header",
    ]
    rows = [(x, a, y, z) for (x, y, z), a in zip(solid.verts.tolist(), VALUES, strict=True)]
    if kind == "ascii":
        body = [" ".join(map(repr, row)) for row in rows] + [f"3 {a} {b} {c}" for a, b, c in solid.faces.tolist()]
        path.write_text("\n".join([*head, *body, ""]))
        return path
    order = "<" if "little" in kind else ">"
    data = b"".join(struct.pack(f"{order}4f", *row) for row in rows)
    data += b"".join(struct.pack(f"{order}B3i", 3, *face) for face in solid.faces.tolist())
    path.write_bytes("\n".join([*head, ""]).encode() + data)
    return path


def test_a_number_a_line(tmp_path):
    lines = "# alpha\n" + "\n".join(map(repr, VALUES)) + "  # the last\n\n"
    assert read_vertex_values(text_file(tmp_path, lines), SAME).tolist() == VALUES


def test_they_go_where_the_files_verts_went(tmp_path):
    path = text_file(tmp_path, "0.5\n9\n0.25\n0.5\n1\n")
    assert read_vertex_values(path, VertexMap(np.array([1, NONE, 0, 1, 2]))).tolist() == [0.25, 0.5, 1.0]


@over("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_property_of_a_ply_file(tmp_path, kind):
    path = ply_file(tmp_path, kind)
    mesh, numbering = load_mesh_with_vertex_map(path)
    assert np.array_equal(numbering.first, SAME.first)
    np.testing.assert_allclose(read_vertex_property(path, "alpha", numbering), VALUES, rtol=1e-7)
    np.testing.assert_allclose(mesh.verts, octahedron().verts, atol=1e-7)
    np.testing.assert_allclose(read_vertex_property(path, "y", numbering), octahedron().verts[:, 1], atol=1e-7)


BAD_TEXTS = {
    "0\n1\n": "expected one number for each of the 6 vertices of the mesh file, got 2",
    "": "expected one number for each of the 6 vertices of the mesh file, got 0",
    "0\n" * 7: "expected one number for each of the 6 vertices of the mesh file, got 7",
    "0\n0\nhalf\n": "line 3: expected one number, got 'half'",
    "0\n0,5\n": "line 2: expected one number, got '0,5'",
    "1_0\n": "line 1: expected one number, got '1_0'",
    "0 1 2 3 4 5\n": "line 1: expected one number, got '0 1 2 3 4 5'",
    "0\n0\n0\n0\nnan\n0\n": "vertex 4: expected a number, got nan",
}


@over("text", BAD_TEXTS)
def test_texts_that_are_refused(tmp_path, text):
    with pytest.raises(MeshError, match=rf"alpha\.txt[:,].*{BAD_TEXTS[text]}"):
        read_vertex_values(text_file(tmp_path, text), SAME)


def test_numbers_out_of_range_are_refused_where_a_vertex_has_them(tmp_path):
    path = text_file(tmp_path, "0\n1\n-3\n1.5\n0\n0\n")
    with pytest.raises(MeshError, match=r"alpha\.txt: vertex 3: expected a number from 0 to 1, got 1\.5"):
        read_vertex_values(path, VertexMap(np.array([0, 1, NONE, 2, 3, 4])), (0.0, 1.0))
    with pytest.raises(MeshError, match=r"'x': vertex 1: expected a number from 0 to 1, got -1"):
        read_vertex_property(ply_file(tmp_path), "x", SAME, (0.0, 1.0))


def test_welded_verts_must_agree(tmp_path):
    with pytest.raises(MeshError, match=r"vertices 0 and 2 share a position on a seam, but have 0\.5 and 0\.75"):
        read_vertex_values(text_file(tmp_path, "0.5\n1\n0.75\n"), VertexMap(np.array([0, 1, 0])))


def test_properties_that_are_not_there(tmp_path):
    path = ply_file(tmp_path)
    with pytest.raises(MeshError, match=r"'beta' cannot be read: .* no property 'beta'; .* x, a"):
        read_vertex_property(path, "beta", SAME)
    with pytest.raises(MeshError, match="from a PLY file only; use a text file with one number per line"):
        read_vertex_property(tmp_path / "solid.obj", "alpha", SAME)
    with pytest.raises(MeshError, match="no such file"):
        read_vertex_property(tmp_path / "gone.ply", "alpha", SAME)
    listed = path.read_text().replace("property float alpha", "property list uchar float alpha")
    path.write_text(listed)
    with pytest.raises(MeshError, match="'alpha' cannot be read: "):
        read_vertex_property(path, "alpha", SAME)


@over("suffix", [".ply", ".obj"])
def test_normals_are_written_and_passed_over_by_readers(tmp_path, suffix):
    solid = octahedron()
    normals = np.array([[1 / 3, -2e-17, 1e300], *solid.verts[1:]])
    save_mesh(solid, tmp_path / f"with{suffix}", normals)
    again = load_mesh(tmp_path / f"with{suffix}")
    assert np.array_equal(again.verts, solid.verts)
    assert np.array_equal(again.faces, solid.faces)
    assert encode_mesh(solid, suffix, normals) == (tmp_path / f"with{suffix}").read_bytes()
    if suffix == ".ply":
        found = np.stack(
            [read_vertex_property(tmp_path / "with.ply", name, SAME) for name in ("nx", "ny", "nz")], axis=1
        )
    else:
        lines = (tmp_path / "with.obj").read_text().splitlines()
        found = np.array([line.split()[1:] for line in lines if line.startswith("vn ")], dtype=np.float64)
        assert lines[-1] == "f " + " ".join(f"{v + 1}//{v + 1}" for v in solid.faces[-1])
    assert np.array_equal(found, normals)


@over("suffix", [".off", ".stl", ".glb"])
def test_formats_without_a_place_for_normals(tmp_path, suffix):
    with pytest.raises(MeshError, match=r"vertex normals can be written to \.obj and \.ply files only"):
        save_mesh(octahedron(), tmp_path / f"a{suffix}", octahedron().verts)
    assert not list(tmp_path.iterdir())
