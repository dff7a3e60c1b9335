"""Polygons in files: kept or triangulated on loading, and cleaned like triangles."""

import struct
import warnings

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.cleaning import clean
from meshfit.mesh.io.files import encode_mesh, load_mesh, load_polygons, save_mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, face_rows
from tests.loops import over
from tests.quads import EVERY, mixed, prism, quad_cube, quad_torus

OF_POLYGONS = (".obj", ".off", ".ply")
pytestmark = pytest.mark.filterwarnings("ignore::meshfit.errors.MeshfitWarning")


@pytest.mark.parametrize("suffix", OF_POLYGONS)
@over("shape", EVERY)
def test_polygons_come_back_as_they_are_and_to_the_last_bit(tmp_path, suffix, shape):
    mesh = EVERY[shape]()
    save_mesh(mesh, tmp_path / f"a{suffix}")
    found = load_polygons(tmp_path / f"a{suffix}")
    for name in ("verts", "corners", "sizes"):
        assert np.array_equal(getattr(found, name), getattr(mesh, name))
    assert encode_mesh(found, suffix) == encode_mesh(mesh, suffix)


@over("suffix", [*OF_POLYGONS, ".stl", ".glb"])
@over("make", [mixed, quad_torus, lambda: prism(7)])
def test_a_reader_of_triangles_gets_the_triangulation(tmp_path, suffix, make):
    mesh = make()
    save_mesh(mesh, tmp_path / f"a{suffix}")
    found, expected = load_mesh(tmp_path / f"a{suffix}"), mesh.triangulated()
    corners = found.verts[found.faces]
    np.testing.assert_allclose(corners, expected.verts[expected.faces], atol=0 if suffix in OF_POLYGONS else 1e-6)
    if suffix in OF_POLYGONS:
        assert np.array_equal(found.faces, expected.faces)


@pytest.mark.parametrize("suffix", OF_POLYGONS)
def test_triangles_are_written_alike_as_polygons(suffix):
    mesh = mixed().triangulated()
    assert encode_mesh(PolygonMesh.of(mesh), suffix) == encode_mesh(mesh, suffix)


def test_a_polygon_of_more_corners_than_a_byte_counts(tmp_path):
    mesh = prism(300)
    save_mesh(mesh, tmp_path / "a.ply")
    assert b"property list uint int vertex_indices" in (tmp_path / "a.ply").read_bytes()
    assert np.array_equal(load_polygons(tmp_path / "a.ply").corners, mesh.corners)


def test_ply_of_polygons_byte_by_byte():
    mesh = PolygonMesh(np.arange(15.0).reshape(5, 3), [0, 1, 2, 3, 2, 1, 4], [4, 3])
    head, body = encode_mesh(mesh, ".ply").split(b"end_header\n")
    assert b"element face 2\nproperty list uchar int vertex_indices" in head
    assert body == struct.pack("<15d", *range(15)) + struct.pack("<B4iB3i", 4, 0, 1, 2, 3, 3, 2, 1, 4)


OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 1\n"


@over(
    ("faces", "rows"),
    [
        ("f 1 2 3 4\nf 2 5 3\n", [[0, 1, 2, 3], [1, 4, 2]]),
        ("f 1/1 2/2 3/3 4/4\nf 2//1 5//1 3//1\n", [[0, 1, 2, 3], [1, 4, 2]]),
        ("f -5 -4 -3 -2\nf 2 5 3\n", [[0, 1, 2, 3], [1, 4, 2]]),
        ("f 1 2 3 4 # a comment\nf 2 5 \\\n3\n", [[0, 1, 2, 3], [1, 4, 2]]),
    ],
)
def test_obj_in_all_its_ways_of_writing(tmp_path, faces, rows):
    (tmp_path / "a.obj").write_text(OBJ + faces)
    assert face_rows(load_polygons(tmp_path / "a.obj")) == rows


@over("load", [load_mesh, load_polygons])
@over(
    ("faces", "message"),
    [
        ("f 1 2 3 4\nf 1 2\n", "line 7: expected a face of 3 or more corners, got 2"),
        ("f 1 2 3 0\n", "line 6: a face with vertex 0"),
        ("f 1 2 3 x\n", "line 6: expected integers, got '1 2 3 x'"),
        ("f 1 2 3 9\n", "line 6: a face with vertex 9, but the file has 5 vertices"),
        ("f 1 2 3 ; 4\n", "line 6: expected integers, got "),
        ("", "a cloud of 5 points and no faces"),
    ],
)
def test_faces_at_fault_are_named_alike(tmp_path, load, faces, message):
    (tmp_path / "a.obj").write_text(OBJ + faces)
    with pytest.raises(MeshError, match=message):
        load(tmp_path / "a.obj")


def cleaned(verts, rows):
    found = PolygonSoup(
        np.asarray(verts, float), np.array([v for row in rows for v in row]), np.array([len(r) for r in rows])
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh, _ = clean(found, "it")
    assert all(warning.category is MeshfitWarning for warning in caught)
    return mesh, [str(warning.message).removeprefix("it: ") for warning in caught]


CUBE = quad_cube()
SIDES = face_rows(CUBE)


def test_a_clean_cube_is_left_alone_in_silence():
    mesh, text = cleaned(CUBE.verts, SIDES)
    assert text == []
    assert face_rows(mesh) == SIDES


def test_what_is_dropped_is_told():
    verts = [*CUBE.verts, CUBE.verts[0], [9.0, 9, 9], [8.0, 8, 8]]
    a, b, c, d = SIDES[2]
    rows = [*SIDES[:2], [a, b, b, c, d], *SIDES[3:], [d, c, b, a], [a, b, a], [a, b, b, a]]
    mesh, text = cleaned(verts, rows)
    assert set(text) == {
        "dropped 2 degenerate faces",
        "dropped 1 duplicate face",
        "dropped 1 repeated corner",
        "dropped 3 unreferenced vertices",
    }
    assert face_rows(mesh) == SIDES


@over("roll", range(4))
@over("step", [1, -1])
def test_duplicates_are_found_whichever_way_they_are_turned(roll, step):
    again = list(np.roll(SIDES[3], roll)[::step])
    mesh, text = cleaned(CUBE.verts, [*SIDES, again])
    assert text == ["dropped 1 duplicate face"]
    assert face_rows(mesh) == SIDES


def test_other_polygons_on_the_same_corners_are_no_duplicates():
    a, b, c, d = SIDES[3]
    mesh, _ = cleaned(CUBE.verts, [*SIDES, [a, c, b, d]])
    assert mesh.num_faces == 7


def test_soup_of_polygons_is_welded():
    for make in (quad_cube, mixed, lambda: prism(5)):
        mesh = make()
        soup = PolygonMesh(mesh.verts[mesh.corners], np.arange(len(mesh.corners)), mesh.sizes)
        found, text = cleaned(soup.verts, face_rows(soup))
        assert text == []
        assert found.num_verts == mesh.num_verts
        assert np.array_equal(found.verts[found.corners], mesh.verts[mesh.corners])


@over(
    ("verts", "rows", "message"),
    [
        (np.zeros((0, 3)), [], "no vertices"),
        (np.eye(3), [], "no faces"),
        ([[0, 0, 0], [1, np.nan, 0], [0, 1, 0]], [[0, 1, 2]], "vertex 1 has a coordinate that is not finite"),
        ([[0, 0, 0], [1, 1e61, 0], [0, 1, 0]], [[0, 1, 2]], "expected coordinates up to 1e.60, got .* at vertex 1"),
        (CUBE.verts, [*SIDES, [0, 1, 2, 8]], r"face 6 is \[0, 1, 2, 8\], but vertices are numbered 0 to 7"),
        (CUBE.verts, [[0, -1, 2, 3]], "face 0 is"),
        (CUBE.verts, [[0, 1, 1, 0]], "no face has an area"),
        (np.outer(np.arange(4), np.ones(3)), [[0, 1, 2, 3]], "no face has an area"),
    ],
)
def test_what_makes_no_sense_is_refused(verts, rows, message):
    with pytest.raises(MeshError, match=message):
        cleaned(verts, rows)


@pytest.mark.parametrize("suffix", OF_POLYGONS)
def test_a_damaged_file_is_refused_or_gives_a_sane_mesh(tmp_path, suffix):
    content, generator = bytearray(encode_mesh(mixed(), suffix)), np.random.default_rng(7)
    path = tmp_path / f"a{suffix}"
    for _ in range(60):
        damaged = content.copy()
        for _ in range(generator.integers(1, 4)):
            at = int(generator.integers(len(damaged)))
            if generator.random() < 0.3:
                del damaged[at : at + int(generator.integers(1, 40))]
            else:
                damaged[at] = int(generator.integers(256))
        path.write_bytes(damaged)
        try:
            mesh = load_polygons(path)
        except MeshError:
            continue
        assert np.isfinite(mesh.verts).all()
        assert (mesh.sizes >= 3).all()
        assert ((mesh.corners >= 0) & (mesh.corners < mesh.num_verts)).all()
