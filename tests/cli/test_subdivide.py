"""`meshfit subdivide` with creases, limit surfaces, normals, and an alpha for each vertex."""

from math import inf

import numpy as np
import pytest

from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.io.vertex_values import read_vertex_property
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, octahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.growth import num_faces_after
from meshfit.subdivision.limit import loop_limit, loop_limit_normals
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import SCHEMES, SURFACES, resolve
from tests.cli import answered, invoke, refused
from tests.loops import over
from tests.quads import quad_torus

ALPHAS = [0.0, 1.0, 0.25, 0.5, 0.125, 1.0]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(cube(), tmp_path / "cube.ply")
    save_mesh(octahedron(), tmp_path / "solid.obj")
    return tmp_path


def told(*arguments: object) -> str:
    ran = invoke("subdivide", *arguments)
    assert (ran.code, ran.err) == (0, "")
    return ran.out


def test_creases_by_angle(folder):
    out = told("cube.ply", "out.ply", "--creases", "45", "-n", 2)
    assert out == "out.ply: 12 faces → 192 faces, 98 vertices; 12 sharp edges, 8 corners\n"
    assert np.array_equal(
        load_mesh("out.ply").verts, subdivide(cube(), "loop", 2, creases=creases_by_angle(cube(), 45)).verts
    )


def test_creases_by_file_with_sharpness_here_and_there(folder):
    (folder / "edges.txt").write_text("0 2\n0 4 inf # here\n1\n")
    out = told("solid.obj", "out.ply", "-s", "interp-loop", "--creases", "edges.txt", "--sharpness", "0.5", "-n", 2)
    assert out.endswith("; 2 sharp edges, 1 corner\n")
    solid = octahedron()
    creases = Creases.of(Topology.of(solid), [(0, 2), (0, 4)], [0.5, inf], [1])
    assert np.array_equal(load_mesh("out.ply").verts, subdivide(solid, "interp-loop", 2, creases=creases).verts)


def test_verts_at_their_limits_with_normals(folder):
    told("cube.ply", "out.ply", "--creases", "45", "-n", 1, "--limit", "--normals")
    found = load_mesh("out.ply")
    side = cube().verts.max()
    assert np.allclose(np.abs(found.verts).max(axis=1), side)
    numbering = VertexMap(np.arange(found.num_verts))
    normals = np.stack([read_vertex_property("out.ply", name, numbering) for name in ("nx", "ny", "nz")], axis=1)
    expected = np.where(np.abs(found.verts) > side - 1e-9, np.sign(found.verts), 0)
    np.testing.assert_allclose(normals, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-12)


def test_the_limit_of_a_mesh_that_is_not_refined(folder):
    told("solid.obj", "out.obj", "-n", 0, "--limit", "--normals", "--weights", "warren")
    solid = octahedron()
    limit = loop_limit(Topology.of(solid), resolve("loop:weights=warren")) @ solid.verts
    assert np.array_equal(load_mesh("out.obj").verts, limit)
    lines = (folder / "out.obj").read_text().splitlines()
    normals = np.array([line.split()[1:] for line in lines if line.startswith("vn ")], dtype=float)
    np.testing.assert_allclose(normals, loop_limit_normals(solid), atol=1e-15)


def test_an_alpha_for_each_vertex_from_text_or_from_the_mesh_file(folder):
    solid = octahedron()
    (folder / "alphas.txt").write_text("\n".join(map(str, ALPHAS)))
    rows = [f"{x!r} {y!r} {z!r} {a}" for (x, y, z), a in zip(solid.verts.tolist(), ALPHAS, strict=True)]
    faces = [f"3 {a} {b} {c}" for a, b, c in solid.faces.tolist()]
    head = ["ply", "format ascii 1.0", "element vertex 6", *(f"property double {name}" for name in "xyz")]
    head += ["property double stay", "element face 8", "property list uchar int vertex_indices", "end_header"]
    (folder / "own.ply").write_text("\n".join([*head, *rows, *faces, ""]))
    told("solid.obj", "text.ply", "-s", "interp-loop", "--alpha", "alphas.txt", "-n", 2)
    told("own.ply", "own-fine.ply", "-s", "interp-loop", "--alpha", "attribute:stay", "-n", 2)
    expected = subdivide(solid, "interp-loop", 2, alpha=np.array(ALPHAS)).verts
    assert np.array_equal(load_mesh("text.ply").verts, expected)
    assert np.array_equal(load_mesh("own-fine.ply").verts, expected)
    told("solid.obj", "three.ply", "-s", "lin-luo-sqrt3", "--alpha", "alphas.txt", "-n", 2)
    assert np.array_equal(load_mesh("three.ply").verts[[1, 5]], solid.verts[[1, 5]])


def test_seams_are_welded_and_files_count_as_the_mesh_file_does(folder):
    solid = octahedron()
    soup = Mesh(solid.verts[solid.faces].reshape(-1, 3), np.arange(24).reshape(8, 3))
    save_mesh(soup, folder / "soup.obj")
    alphas = np.array(ALPHAS)[solid.faces].reshape(-1)
    (folder / "alphas.txt").write_text("\n".join(map(str, alphas)))
    (folder / "edges.txt").write_text("0 1\n")
    told("soup.obj", "out.ply", "-s", "interp-loop", "--alpha", "alphas.txt", "--creases", "edges.txt")
    creases = Creases.of(Topology.of(solid), solid.faces[:1, :2])
    expected = subdivide(solid, "interp-loop", 1, creases=creases, alpha=np.array(ALPHAS))
    found = load_mesh("out.ply")
    distance = np.linalg.norm(found.verts[:, None] - expected.verts[None], axis=2).min(axis=1)
    assert distance.max() < 1e-15


VALENCE_2 = """\
v 0.0 0.0 2.0
v 0.0 0.3 0.0
v 2.0 0.0 0.0
v 0.6 0.1 0.8
v 2.0 0.2 2.0
f 1 2 3 4
f 4 3 5 1
"""


@over(
    ("scheme", "counts"),
    [
        ("catmull-clark", "8 faces, 13 vertices"),
        ("interp-catmull-clark", "8 faces, 13 vertices"),
        ("kobbelt", "8 faces, 13 vertices"),
        ("doo-sabin", "4 faces, 8 vertices"),
        ("sqrt2", "6 faces, 7 vertices"),
        ("interp-sqrt2", "6 faces, 7 vertices"),
    ],
)
def test_an_interior_vertex_of_valence_2(folder, scheme, counts):
    """Two quads that share two edges: 2 faces, 6 edges, 5 vertices and 8 corners."""
    (folder / "two.obj").write_text(VALENCE_2)
    ran = invoke("subdivide", "two.obj", "out.obj", "-s", scheme)
    assert (ran.code, ran.out) == (0, f"out.obj: 2 faces → {counts}\n")
    assert ran.err == "warning: two.obj: 4 boundary edges: the surface is open\n"


def test_tensor_products_refuse_a_vertex_of_valence_2(folder):
    (folder / "two.obj").write_text(VALENCE_2)
    for scheme in ("ternary", "interp-ternary"):
        ran = invoke("subdivide", "two.obj", "out.obj", "-s", scheme)
        assert ran.code == 2
        assert "vertex 3, inside, has valence 2, 4 is allowed (1 such vertex); catmull-clark, kobbelt" in ran.err


REFUSED = {
    (
        "cube.ply",
        "out.ply",
        "-s",
        "sqrt3",
        "--creases",
        "45",
    ): "--creases: sqrt3 takes no creases; loop, interp-loop",
    ("cube.ply", "out.ply", "--creases", "0"): "a crease angle of 0 degrees is not allowed: expected",
    ("cube.ply", "out.ply", "--creases", "nan"): "a crease angle of nan degrees is not allowed",
    (
        "cube.ply",
        "out.ply",
        "--creases",
        "gone.txt",
    ): "--creases: expected a number of degrees or a file, got",
    ("cube.ply", "out.ply", "--creases", "cube.ply"): "cube.ply: not a text file in UTF-8",
    ("cube.ply", "out.ply", "--creases", "solid.obj"): "solid.obj, line 1: found 'v ",
    ("cube.ply", "out.ply", "--creases", "45", "--sharpness", "-1"): "--sharpness: expected 0 or more, got -1",
    ("cube.ply", "out.ply", "--creases", "45", "--sharpness", "nan"): "--sharpness: expected 0 or more, got nan",
    ("cube.ply", "out.ply", "--sharpness", "2"): "--sharpness applies to creases only; choose them with --creases",
    ("cube.ply", "out.ply", "--creases", "45", "--sharpness", "3.5", "--limit"): "limits are known where creases are "
    "smooth or permanently sharp: a sharpness of 2.5 is left; refine 3 levels more",
    (
        "cube.ply",
        "out.ply",
        "-s",
        "interp-loop",
        "--limit",
    ): "--limit: the limit surface is known for loop only, not for interp-loop",
    (
        "cube.ply",
        "out.ply",
        "-s",
        "sqrt3",
        "--normals",
    ): "--normals: the limit surface is known for loop only",
    ("cube.ply", "out.stl", "--normals"): "out.stl: vertex normals can be written to .obj and .ply files only",
    ("cube.ply", "out.ply", "--alpha", "solid.obj"): "scheme 'loop' has no parameter 'alpha'",
    (
        "cube.ply",
        "out.ply",
        "-s",
        "interp-loop",
        "--alpha",
        "attribute:a",
    ): "cube.ply: 'a' cannot be read: its vertices",
    ("solid.obj", "out.ply", "-s", "interp-loop", "--alpha", "attribute:a"): "solid.obj: 'a' can be read from a PLY",
    ("bunny", "out.ply", "-s", "interp-loop", "--alpha", "solid.obj"): "solid.obj, line 1: expected one number",
    ("cube.ply", "out.ply", "-s", "interp-loop", "--alpha", "nan"): "interp-loop: alpha=nan is not allowed",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_refusals(folder, arguments):
    assert REFUSED[arguments] in refused("subdivide", *arguments)
    assert sorted(path.name for path in folder.iterdir()) == ["cube.ply", "solid.obj"]


def test_a_mesh_of_very_many_faces_is_made_only_where_it_is_asked_for_twice(tmp_path, monkeypatch):
    save_mesh(cube(), tmp_path / "cube.ply")
    text = refused("subdivide", tmp_path / "cube.ply", tmp_path / "fine.ply", "--levels", "10")
    assert text.startswith("error: 10 levels: about 12,582,912 faces, 5.7 GB of memory")
    assert text.endswith("; choose fewer --levels, or give --yes to make them")
    assert not (tmp_path / "fine.ply").exists()
    monkeypatch.setattr("meshfit.cli.subdivide._MOST_FACES", 100)
    arguments = ("subdivide", tmp_path / "cube.ply", tmp_path / "fine.ply", "-n", "2")
    refused(*arguments)
    ran = invoke(*arguments, "--yes")
    assert ran.code == 0
    assert ran.err.startswith("2 levels: about 192 faces, ")
    assert "192 faces" in ran.out
    answered(*arguments[:-1], "1")


@over("spec", [name for name, entry in SCHEMES.items() if entry.domain in SURFACES])
def test_the_number_of_faces_is_known_in_advance(spec):
    scheme = resolve(spec)
    mesh = octahedron() if SCHEMES[spec].domain == "triangles" else quad_torus(4, 3)
    for levels in range(4):
        count = subdivide(mesh, scheme, levels).num_faces
        assert num_faces_after(mesh, scheme, levels) == pytest.approx(count, rel=0.1), levels
