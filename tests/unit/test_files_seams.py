"""Seams, which formats cut for textures, normals or lack of an index, are welded; real contact is not."""

import warnings

import numpy as np
import pytest
import trimesh

from meshfit.errors import MeshfitWarning
from meshfit.mesh.cleaning import clean
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.manifold import euler_number, nonmanifold_edges
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonSoup
from meshfit.mesh.solids import SOLIDS, cube, icosahedron, octahedron
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from tests.loops import over
from tests.shapes import patch, torus


def weld_seams(mesh):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        return clean(PolygonSoup.of_triangles(mesh.verts, mesh.faces), "it")[0].triangulated()


def soup(mesh):
    """Every face with verts of its own."""
    return Mesh(mesh.verts[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3))


def obj_text(mesh, corner):
    verts = "".join("v {} {} {}\n".format(*vert) for vert in mesh.verts.tolist())
    faces = "".join(
        "f " + " ".join(corner(v + 1, f + 1, k + 1) for k, v in enumerate(face)) + "\n"
        for f, face in enumerate(mesh.faces.tolist())
    )
    extra = "vt 0.25 0.5\n" * mesh.num_faces + "vn 0 0 1\n" * mesh.num_faces
    return verts + extra + faces


CORNERS = {
    "texture": lambda vert, face, place: f"{vert}/{(face + place) % 3 + 1}",
    "normal": lambda vert, face, place: f"{vert}//{face}",
    "both": lambda vert, face, place: f"{vert}/{place}/{face}",
    "mixed": lambda vert, face, place: f"{vert}/{place}/{face}" if face % 2 else f"{vert}//{face}",
}


@over("corner", CORNERS)
def test_texture_and_normal_seams_of_obj_do_not_cut_the_surface(tmp_path, corner):
    mesh = icosahedron()
    (tmp_path / "a.obj").write_text(obj_text(mesh, CORNERS[corner]))
    found = load_mesh(tmp_path / "a.obj")
    assert np.array_equal(found.verts, mesh.verts)
    assert np.array_equal(found.faces, mesh.faces)


def test_textured_obj_loads_without_its_material(tmp_path):
    text = obj_text(cube(), CORNERS["texture"])
    lines = ["mtllib gone.mtl", "o thing", "usemtl skin", *text.splitlines()]
    lines.insert(len(lines) - 5, "usemtl hair")
    (tmp_path / "a.obj").write_text("\n".join(lines))
    with pytest.warns(MeshfitWarning, match="materials is incomplete: library 'gone.mtl' is missing"):
        found = load_mesh(tmp_path / "a.obj")
    assert np.array_equal(found.verts, cube().verts)
    assert np.array_equal(found.faces, cube().faces)
    assert [material.name for material in found.attributes.materials] == ["skin", "hair"]
    load_mesh(tmp_path / "a.obj", attributes=False)  # without a warning


@over("solid", SOLIDS)
def test_soup_is_welded_into_one_closed_surface(solid):
    mesh = SOLIDS[solid]()
    welded = weld_seams(soup(mesh))
    used = np.unique(welded.faces)
    assert len(used) == mesh.num_verts
    assert Topology(len(welded.verts), welded.faces).is_watertight
    assert np.array_equal(welded.verts[welded.faces], mesh.verts[mesh.faces])


def test_stl_soup_is_welded_and_keeps_its_genus(tmp_path):
    save_mesh(torus(12, 9), tmp_path / "a.stl")
    found = load_mesh(tmp_path / "a.stl")
    topology = Topology.of(found)
    assert (found.num_verts, found.num_faces) == (12 * 9, 2 * 12 * 9)
    assert topology.is_watertight
    assert euler_number(topology) == 0


def test_zero_and_minus_zero_are_one_place():
    mesh = patch(3, 3)
    split = soup(mesh)
    verts = np.array(split.verts)
    verts[::2][verts[::2] == 0.0] = -0.0
    assert np.signbit(verts).any()
    welded = weld_seams(Mesh(verts, split.faces))
    assert len(np.unique(welded.faces)) == mesh.num_verts


def test_welding_takes_equal_positions_only():
    mesh = soup(octahedron())
    verts = np.array(mesh.verts)
    verts[0] = np.nextafter(verts[0], 9)
    assert len(np.unique(weld_seams(Mesh(verts, mesh.faces)).faces)) == 7


def test_two_closed_surfaces_that_touch_at_a_vertex_or_an_edge_stay_apart():
    mesh = octahedron()
    touching = Mesh(
        np.concatenate([mesh.verts, mesh.verts + np.array([2, 0, 0])]), np.concatenate([mesh.faces, mesh.faces + 6])
    )
    assert len(np.unique(touching.verts + 0.0, axis=0)) == 11
    assert np.array_equal(weld_seams(touching).faces, touching.faces)
    box = cube()
    length = box.verts[:, 0].max() - box.verts[:, 0].min()
    beside = Mesh(
        np.concatenate([box.verts, box.verts + np.array([length, length, 0])]),
        np.concatenate([box.faces, box.faces + 8]),
    )
    assert np.array_equal(weld_seams(beside).faces, beside.faces)


def test_the_cow_which_touches_itself_is_not_torn():
    cow = load_target("cow")
    topology = Topology.of(cow)
    assert len(np.unique(cow.verts, axis=0)) < cow.num_verts
    assert topology.is_watertight
    assert not len(nonmanifold_edges(topology))
    assert euler_number(topology) == 2


def test_coincident_verts_of_two_boundaries_are_joined_in_one_place_each():
    left, right = patch(3, 4), patch(3, 4)
    both = Mesh(
        np.concatenate([left.verts, right.verts + np.array([2, 0, 0])]), np.concatenate([left.faces, right.faces + 12])
    )
    assert len(np.unique(weld_seams(both).faces)) == patch(5, 4).num_verts


def test_the_parts_of_a_glb_stand_where_their_nodes_put_them(tmp_path):
    mesh = octahedron()
    turn = np.array([[0.0, -2, 0, 5], [2, 0, 0, 6], [0, 0, 2, 7], [0, 0, 0, 1]])
    scene = trimesh.Scene()
    part = trimesh.Trimesh(mesh.verts, mesh.faces, process=False)
    scene.add_geometry(part, geom_name="part", transform=turn)
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    found = load_mesh(tmp_path / "a.glb")
    assert np.allclose(found.verts, mesh.verts @ turn[:3, :3].T + turn[:3, 3], atol=1e-6)
    assert np.array_equal(found.faces, mesh.faces)
