"""Cleaning: dropped elements, warnings, and their counts."""

import re
import tracemalloc
import warnings

import numpy as np
import pytest

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.cleaning import clean
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup
from meshfit.mesh.solids import icosahedron, octahedron
from meshfit.subdivision.sphere import icosphere
from tests.loops import over
from tests.shapes import CLOSED, mixed_open, patch

SOLID = octahedron()


def cleaned(verts, faces, options=None):
    """The mesh, and what is said about it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh, _ = clean(PolygonSoup.of_triangles(np.asarray(verts, dtype=np.float64), np.asarray(faces)), "it", options)
        mesh = mesh.triangulated()
    assert all(warning.category is MeshfitWarning for warning in caught)
    said = [str(warning.message) for warning in caught]
    assert all(text.startswith("it: ") and "\n" not in text for text in said)
    return mesh, [text.removeprefix("it: ") for text in said]


@over("shape", CLOSED)
def test_a_clean_closed_mesh_is_left_alone_in_silence(shape):
    mesh = CLOSED[shape]()
    found, said = cleaned(mesh.verts, mesh.faces)
    assert said == []
    assert np.array_equal(found.verts, mesh.verts)
    assert np.array_equal(found.faces, mesh.faces)


def test_unreferenced_verts_are_dropped_and_the_others_keep_their_order():
    verts = np.insert(SOLID.verts, [0, 2, 2, 6], [9.0, 9, 9], axis=0)
    place = np.array([1, 2, 5, 6, 7, 8])
    found, said = cleaned(verts, place[SOLID.faces])
    assert said == ["dropped 4 unreferenced vertices"]
    assert np.array_equal(found.verts, SOLID.verts)
    assert np.array_equal(found.faces, SOLID.faces)


def test_welded_verts_are_not_called_unreferenced():
    corners = SOLID.verts[SOLID.faces].reshape(-1, 3)
    found, said = cleaned(np.concatenate([corners, [[5.0, 5, 5]]]), np.arange(24).reshape(-1, 3))
    assert found.num_verts == 6
    assert said == ["dropped 1 unreferenced vertex"]


@over("turn", [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]])
def test_duplicate_faces_are_dropped_whichever_way_they_are_turned(turn):
    faces = np.concatenate([SOLID.faces, SOLID.faces[[3, 5, 3]][:, turn]])
    found, said = cleaned(SOLID.verts, faces)
    assert said == ["dropped 3 duplicate faces"]
    assert np.array_equal(found.faces, SOLID.faces)


def test_degenerate_faces_are_dropped():
    verts = np.concatenate([SOLID.verts, [(SOLID.verts[0] + SOLID.verts[2]) / 2]])
    faces = np.concatenate([[[0, 0, 1]], SOLID.faces, [[4, 4, 4], [0, 6, 2]]])
    found, said = cleaned(verts, faces)
    assert said == ["dropped 3 degenerate faces"]
    assert np.array_equal(found.verts, SOLID.verts)
    assert np.array_equal(found.faces, SOLID.faces)


def test_a_thin_face_is_not_a_degenerate_one():
    verts = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0]])
    found, said = cleaned(verts, [[0, 1, 2]])
    assert found.num_faces == 1
    assert said == ["3 boundary edges: the surface is open"]


def test_open_surfaces_are_told_with_their_boundary():
    mesh = patch(5, 4)
    found, said = cleaned(mesh.verts, mesh.faces)
    assert np.array_equal(found.faces, mesh.faces)
    assert said == [f"{2 * (4 + 3)} boundary edges: the surface is open"]


def test_edges_with_three_faces_are_told_and_kept():
    fin = np.concatenate([SOLID.faces, [[0, 2, 6], [4, 0, 6]]])
    found, said = cleaned(np.concatenate([SOLID.verts, [[2.0, 2, 2]]]), fin, CleaningOptions(repair="refuse"))
    assert found.num_faces == 10
    remedy = "--repair split separates the faces"
    assert said == [f"2 non-manifold edges (three faces or more); {remedy}", "2 boundary edges: the surface is open"]


def test_faces_turned_over_are_told_with_the_edges_that_disagree():
    faces = SOLID.faces.copy()
    faces[0] = faces[0][::-1]
    found, said = cleaned(SOLID.verts, faces)
    assert np.array_equal(found.faces, faces)
    assert said == ["3 edges between faces of opposite orientation"]


def test_pieces_are_counted():
    pieces = [icosahedron().verts + np.array([5.0 * i, 0, 0]) for i in range(3)]
    faces = [icosahedron().faces + 12 * i for i in range(3)]
    assert cleaned(np.concatenate(pieces), np.concatenate(faces))[1] == ["3 separate components"]


def test_everything_at_once_is_told_in_a_line_each():
    mesh = mixed_open()
    away = mesh.verts + np.array([9.0, 0, 0])
    faces = np.concatenate([mesh.faces, mesh.faces[:2], [[1, 1, 2]], mesh.faces + mesh.num_verts])
    found, said = cleaned(np.concatenate([mesh.verts, away, [[0.0, 0, 0]]]), faces)
    assert found.num_faces == 2 * mesh.num_faces
    assert [re.sub(r"\d+", "N", text) for text in said] == [
        "dropped N degenerate face",
        "dropped N duplicate faces",
        "dropped N unreferenced vertex",
        "N boundary edges: the surface is open",
        "N separate components",
    ]


@over(
    ("verts", "faces", "message"),
    [
        (np.empty((0, 3)), [[0, 1, 2]], "it: the mesh has no vertices"),
        (
            np.eye(3),
            np.empty((0, 3), int),
            "it: expected a surface, got a cloud of 3 points and no faces; reconstruct a surface first: "
            "meshfit fit POINTS -o surface.ply",
        ),
        (np.eye(3), [[0, 1, 2], [0, 1, 3]], "it: face 1 is [0, 1, 3], but vertices are numbered 0 to 2"),
        (np.eye(3), [[0, -1, 2]], "it: face 0 is [0, -1, 2], but vertices are numbered 0 to 2"),
        (np.full((3, 3), 7.0), [[0, 1, 2], [2, 1, 0]], "it: no face has an area (2 faces)"),
        (np.eye(3) * 2e60, [[0, 1, 2]], "it: expected coordinates up to 1e+60, got [2e+60, 0.0, 0.0] at vertex 0"),
        (
            np.diag([1, np.nan, np.inf]),
            [[0, 1, 2]],
            "it: vertex 1 has a coordinate that is not finite: [0.0, nan, 0.0]",
        ),
    ],
)
def test_what_is_no_surface_is_refused(verts, faces, message):
    with pytest.raises(MeshError) as caught:
        clean(PolygonSoup.of_triangles(verts, np.asarray(faces)), "it")
    assert str(caught.value) == message


def test_warnings_name_the_file(tmp_path):
    save_mesh(Mesh(patch(3, 3).verts, patch(3, 3).faces), tmp_path / "open.ply")
    with pytest.warns(MeshfitWarning, match=r"open\.ply: 8 boundary edges"):
        load_mesh(tmp_path / "open.ply")


@over("number", [np.nan, np.inf, 1e70])
def test_vertices_that_no_face_uses_may_have_any_coordinates(number):
    found, said = cleaned(np.concatenate([SOLID.verts, [[number, 0, 0]]]), SOLID.faces)
    assert said == ["dropped 1 unreferenced vertex"]
    assert np.array_equal(found.verts, SOLID.verts)


@pytest.mark.parametrize(("suffix", "most"), [(".ply", 320), (".stl", 620)])
def test_the_memory_of_loading_is_a_few_hundred_bytes_per_face(tmp_path, suffix, most):
    path = tmp_path / f"sphere{suffix}"
    save_mesh(icosphere(6), path)
    tracemalloc.start()
    faces = load_mesh(path, attributes=False).num_faces
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert faces == 20 * 4**6
    assert peak / faces < most


def test_meshes_share_arrays_that_nobody_can_write_to():
    verts, faces = np.array(octahedron().verts), np.array(octahedron().faces)
    mesh = Mesh(verts, faces)
    assert not np.shares_memory(mesh.verts, verts)
    verts[:], faces[:] = 0.0, 0
    assert mesh.verts.any()
    assert mesh.faces.any()
    view = verts.view()
    view.setflags(write=False)  # its base can still be written to
    assert not np.shares_memory(Mesh(view, faces).verts, verts)
    assert mesh.with_verts(mesh.verts).verts is mesh.verts
    assert np.shares_memory(PolygonMesh.of(mesh).triangulated().faces, mesh.faces)
    part = Mesh(mesh.verts, mesh.faces[:4]).faces  # which would keep the whole alive
    assert not np.shares_memory(part, mesh.faces)
