"""Welding of seams, and splitting of vertices and edges that are not manifold."""

import warnings

import numpy as np
import pytest
from scipy.stats import special_ortho_group

import meshfit
from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.cleaning import clean
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.geometry import signed_volume
from meshfit.mesh.io.files import load_mesh, load_mesh_with_vertex_map, load_polygons, save_mesh
from meshfit.mesh.io.vertex_values import read_vertex_values
from meshfit.mesh.manifold import (
    duplicate_triangles,
    nonmanifold_edges,
    nonmanifold_verts,
    num_components,
    require_manifold,
    vertex_fans,
)
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonSoup
from meshfit.mesh.solids import cube, icosahedron, octahedron
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.mesh.welding import coincident, stitch
from meshfit.subdivision.creases import read_creases
from tests.loops import over
from tests.shapes import CLOSED, patch


def cleaned(mesh, **options):
    """The mesh after cleaning, and what is said about it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        soup = PolygonSoup.of_triangles(np.asarray(mesh.verts), np.asarray(mesh.faces))
        result, _ = clean(soup, "it", CleaningOptions(**options), triangles=True)
    return result.triangulated(), [str(warning.message).removeprefix("it: ") for warning in caught]


def soup(mesh):
    """Every face with vertices of its own."""
    return Mesh(mesh.verts[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3))


def joined(*meshes):
    """Several meshes as one, with the vertices at equal positions made one vertex."""
    verts = np.concatenate([mesh.verts for mesh in meshes])
    starts = np.cumsum([0, *[mesh.num_verts for mesh in meshes]])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    places, index = np.unique(verts.round(9), axis=0, return_inverse=True)
    return Mesh(places, index.reshape(-1)[faces])


def moved(mesh, *offset):
    return Mesh(mesh.verts + np.array(offset), mesh.faces)


def pieces(mesh):
    """The number of components, and whether each is closed and manifold."""
    topology = Topology.of(mesh)
    require_manifold(topology, "a test")
    return num_components(topology), topology.is_watertight


BOX = Mesh((cube().verts / cube().verts.max() + 1) / 2, cube().faces)  # from 0 to 1
TOUCHING = {
    "at a vertex": (joined(BOX, moved(BOX, 1, 1, 1)), 1),
    "at an edge": (joined(BOX, moved(BOX, 1, 1, 0)), 2),
    "three in a row": (joined(BOX, moved(BOX, 1, 1, 0), moved(BOX, 2, 2, 1)), 3),
    "tip to tip": (joined(octahedron(), moved(octahedron(), 2, 0, 0)), 1),
}


@over("name", TOUCHING)
@over("make", [lambda mesh: mesh, soup])
def test_closed_bodies_that_touch_become_closed_pieces(name, make):
    mesh, split = TOUCHING[name]
    result, said = cleaned(make(mesh))
    bodies = 3 if "three" in name else 2
    assert pieces(result) == (bodies, True)
    assert result.num_faces == mesh.num_faces
    assert signed_volume(result) == pytest.approx(signed_volume(mesh))
    vertices = f"{split} vertex" if split == 1 else f"{split} vertices"
    about = (
        []
        if make is soup
        else [f"split {vertices} where separate fans of faces, or more than two faces at an edge, meet"]
    )
    assert said == [*about, f"{bodies} separate components"]


@over("name", TOUCHING)
@over("seed", range(3))
def test_the_split_does_not_depend_on_how_the_mesh_lies_or_is_numbered(name, seed):
    mesh, _ = TOUCHING[name]
    generator = np.random.default_rng(seed)
    order = generator.permutation(mesh.num_verts)
    turn = special_ortho_group.rvs(3, random_state=seed)
    other = Mesh((mesh.verts @ turn.T + 7)[np.argsort(order)], order[mesh.faces][generator.permutation(mesh.num_faces)])
    assert pieces(cleaned(other)[0]) == pieces(cleaned(mesh)[0])


def test_refuse_leaves_what_is_not_manifold_and_tells_it():
    mesh, _ = TOUCHING["at a vertex"]
    result, said = cleaned(mesh, repair="refuse")
    assert np.array_equal(result.faces, mesh.faces)
    assert said == ["1 non-manifold vertex (separate fans of faces); --repair split separates them"]
    with pytest.raises(MeshError, match="joins separate fans of faces"):
        meshfit.subdivide(result, "loop")
    result, said = cleaned(TOUCHING["at an edge"][0], repair="refuse")
    assert said[0] == "1 non-manifold edge (three faces or more); --repair split separates the faces"
    # The weld of a soup makes neither.
    for name in TOUCHING:
        assert pieces(cleaned(soup(TOUCHING[name][0]), repair="refuse")[0])[1]


def test_a_fin_on_a_closed_body_is_separated_and_the_body_stays_closed():
    fin = np.array([[0, 2, 6]])
    mesh = Mesh(np.concatenate([octahedron().verts, [[2.0, 2, 2]]]), np.concatenate([octahedron().faces, fin]))
    for make in (lambda mesh: mesh, soup):
        result, _ = cleaned(make(mesh))
        topology = Topology.of(result)
        assert not len(nonmanifold_edges(topology))
        assert num_components(topology) == 2
        assert topology.boundary_edges.sum() == 3


def test_a_wall_inside_a_body_is_separated():
    wall = Mesh(BOX.verts, [[0, 3, 7], [0, 7, 4]])  # a diagonal plane of the cube
    edges_shared = {frozenset(e) for f in wall.faces.tolist() for e in zip(f, f[1:] + f[:1], strict=True)}
    of_box = {frozenset(e) for f in BOX.faces.tolist() for e in zip(f, f[1:] + f[:1], strict=True)}
    assert len(edges_shared & of_box) >= 2
    result, _ = cleaned(Mesh(BOX.verts, np.concatenate([BOX.faces, wall.faces])))
    topology = Topology.of(result)
    assert not len(nonmanifold_edges(topology))
    assert not len(nonmanifold_verts(topology))
    assert num_components(topology) == 2


def test_a_sheet_of_two_sides_stays_two_sheets():
    """Their rims coincide; joining them would make double faces and edges of four faces at the corners."""
    front = patch(4, 4)
    back = Mesh(front.verts, front.faces[:, ::-1])
    both = Mesh(np.concatenate([front.verts, back.verts]), np.concatenate([front.faces, back.faces + front.num_verts]))
    for mesh in (both, soup(both)):
        result, said = cleaned(mesh)
        assert result.num_faces == both.num_faces
        assert pieces(result) == (2, False)
        assert not any("duplicate" in text or "manifold" in text for text in said)


@over("shape", CLOSED)
@over("seed", range(2))
def test_a_closed_surface_cut_along_random_edges_is_welded_again(shape, seed):
    mesh = CLOSED[shape]()
    generator = np.random.default_rng(seed)
    # Some faces get vertices of their own.
    own = generator.random(mesh.num_faces) < 0.4
    corners = mesh.faces.copy()
    corners[own] = mesh.num_verts + np.arange(3 * own.sum()).reshape(-1, 3)
    verts = np.concatenate([mesh.verts, mesh.verts[mesh.faces[own]].reshape(-1, 3)])
    result, _ = cleaned(Mesh(verts, corners))
    assert np.array_equal(result.verts[result.faces], mesh.verts[mesh.faces])
    assert Topology.of(result).is_watertight
    assert result.num_verts == mesh.num_verts


def test_faces_with_an_edge_without_length_are_dropped_and_the_rest_stays_closed():
    mesh = icosahedron()
    verts, faces = mesh.verts.copy(), mesh.faces
    verts[faces[0, 0]] = verts[faces[0, 1]]
    result, said = cleaned(Mesh(verts, faces))
    assert result.num_faces == 18
    assert Topology.of(result).is_watertight
    assert said == ["dropped 2 degenerate faces"]


def cube_with_a_flat_cap(seed):
    """A cube with a vertex in the middle of an edge, where one side has a flat face in place of the vertex."""
    verts = np.concatenate([BOX.verts, [(BOX.verts[0] + BOX.verts[1]) / 2]])
    faces = []
    for face in BOX.faces.tolist():
        pairs = list(zip(face, face[1:] + face[:1], strict=True))
        if (0, 1) in pairs:
            tip = next(v for v in face if v not in (0, 1))
            faces += [[0, 8, tip], [8, 1, tip]]
        else:
            faces.append(face)
    faces.append([0, 1, 8] if any((1, 0) in zip(f, f[1:] + f[:1], strict=True) for f in faces) else [1, 0, 8])
    turn = special_ortho_group.rvs(3, random_state=seed) if seed else np.eye(3)
    return Mesh(verts @ turn.T + (seed > 0) * 0.3, faces)


@over("seed", range(6))
def test_a_flat_face_that_closes_a_surface_is_kept_however_it_lies(seed):
    mesh = cube_with_a_flat_cap(seed)
    result, said = cleaned(mesh)
    assert (result.num_faces, said) == (14, [])
    assert Topology.of(result).is_watertight


def test_a_flat_face_that_closes_nothing_is_dropped():
    verts = np.concatenate([BOX.verts, [[2.0, 0, 0], [3, 0, 0], [4, 0, 0]]])
    result, said = cleaned(Mesh(verts, np.concatenate([BOX.faces, [[8, 9, 10]]])))
    assert (result.num_faces, said) == (12, ["dropped 1 degenerate face"])


def test_vertices_that_nearly_coincide_are_told_and_joined_on_demand(tmp_path):
    left, right = patch(4, 4), patch(4, 4)
    width = np.ptp(left.verts[:, 0])
    gap = 1e-5 * width
    both = Mesh(
        np.concatenate([left.verts, right.verts + np.array([width + gap, 0, 0])]),
        np.concatenate([left.faces, right.faces + left.num_verts]),
    )
    result, said = cleaned(both)
    assert num_components(Topology.of(result)) == 2
    assert f"8 boundary vertices nearly coincident with another, up to {gap:.2g} apart; --weld" in said[-1]
    result, said = cleaned(both, weld=1.01 * gap)
    assert num_components(Topology.of(result)) == 1
    assert result.num_verts == both.num_verts - 4
    assert not any("--weld" in text for text in said)
    assert cleaned(both, weld=0.9 * gap)[0].num_verts == both.num_verts
    save_mesh(both, tmp_path / "a.ply")
    with pytest.warns(MeshfitWarning):
        assert load_mesh(tmp_path / "a.ply", CleaningOptions(weld=2 * gap)).num_verts == both.num_verts - 4


def test_values_and_creases_of_a_split_vertex_go_to_all_its_copies(tmp_path):
    mesh, _ = TOUCHING["at an edge"]
    save_mesh(mesh, tmp_path / "a.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        result, vertex_map = load_mesh_with_vertex_map(tmp_path / "a.ply")
    (tmp_path / "values.txt").write_text("\n".join(str(v) for v in range(mesh.num_verts)))
    values = read_vertex_values(tmp_path / "values.txt", vertex_map).astype(int)
    assert np.array_equal(mesh.verts[values], result.verts)
    shared = [v for v in range(mesh.num_verts) if len(vertex_map.mesh_verts(v)) == 2]
    (tmp_path / "creases.txt").write_text(" ".join(map(str, shared)))
    topology = Topology.of(result)
    creases = read_creases(tmp_path / "creases.txt", topology, vertex_map)
    assert (creases.sharpness > 0).sum() == 2


def test_a_polygon_with_a_bridge_to_a_hole_is_triangulated_for_schemes_on_polygons(tmp_path):
    ring = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 1 1 0\nv 1 3 0\nv 3 3 0\nv 3 1 0\n"
    (tmp_path / "a.obj").write_text(ring + "f 1 2 3 4 1 5 6 7 8 5\n")
    with pytest.warns(MeshfitWarning, match="8 boundary edges"):
        mesh = load_polygons(tmp_path / "a.obj")
    assert mesh.sizes.tolist() == [3] * 8


def test_an_inside_out_surface_is_told():
    mesh = icosahedron()
    assert cleaned(Mesh(mesh.verts, mesh.faces[:, ::-1]))[1] == [
        "the surface is inside out: closed, with a negative volume"
    ]


@over("shape", CLOSED)
def test_fans_found_by_walking_are_those_of_components(shape):
    meshes = [CLOSED[shape](), *[TOUCHING[name][0] for name in TOUCHING], patch(4, 5)]
    for mesh in meshes:
        topology = Topology.of(mesh)
        count, fan = vertex_fans(topology)
        owner = np.empty(count, dtype=np.int64)
        owner[fan] = topology.tail
        expected = np.flatnonzero(np.bincount(owner, minlength=mesh.num_verts) > 1)
        assert np.array_equal(nonmanifold_verts(topology), expected)


def test_no_weld_makes_a_duplicate_face_or_an_edge_of_three_faces():
    """Random triangles on a coarse lattice, where many ends and faces coincide."""
    rng = np.random.default_rng(0)

    def defects(topology):
        return int((topology.faces_per_edge > 2).sum()), len(duplicate_triangles(topology))

    for _ in range(250):
        lattice = rng.integers(0, 3, size=(24, 3)).astype(float)
        faces = np.array([rng.choice(24, 3, replace=False) for _ in range(13)])
        sides = lattice[faces][:, 1:] - lattice[faces][:, :1]
        faces = faces[np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > 0]
        used, numbers = np.unique(faces, return_inverse=True)
        verts, sizes = lattice[used], np.full(len(faces), 3)
        given = PolygonTopology(len(verts), numbers.reshape(-1), sizes)
        places = coincident(given, verts)
        stitched = stitch(verts, given, PolygonTopology(len(verts), places[given.corners], sizes), split=False)
        after = PolygonTopology(len(stitched.origins), stitched.corners, sizes)
        assert all(new <= old for new, old in zip(defects(after), defects(given), strict=True))
