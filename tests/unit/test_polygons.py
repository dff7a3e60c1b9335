"""Polygon meshes: refusals, triangulation and half-edges."""

import numpy as np
import pytest

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.manifold import duplicate_triangles, nonmanifold_verts, require_faces, require_manifold
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import POLYGON_SOLIDS, SOLIDS, cube
from meshfit.mesh.topology import NONE, PolygonTopology, Topology
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from tests.loops import over
from tests.quads import EVERY, VALENCE_2, mixed, prism, quad_cube, quad_patch, quad_wheel
from tests.shapes import ALL

every_shape = over("shape", EVERY)


@over(
    ("corners", "sizes", "message"),
    [
        ([0, 1, 2], [4], "3 corners do not match the sizes of 1 faces"),
        ([0, 1, 2, 0, 1], [3, 2], "face 1: expected 3 or more corners, got 2"),
        ([[0, 1, 2]], [3], "do not match"),
        ([0, 1, 2, 3], [5, -1], "face 1: expected 3 or more corners, got -1"),
    ],
)
def test_what_is_no_list_of_polygons(corners, sizes, message):
    with pytest.raises(MeshError, match=message):
        PolygonMesh(np.eye(4)[:, :3], corners, sizes)


def test_arrays_are_copies_and_read_only():
    corners = np.array([0, 1, 2])
    mesh = PolygonMesh(np.eye(3), corners, [3])
    corners[0] = 2
    assert mesh.corners.tolist() == [0, 1, 2]
    for array in (mesh.verts, mesh.corners, mesh.sizes):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@over("shape", ALL)
def test_triangles_are_polygons_and_back(shape):
    mesh = ALL[shape]()
    polygons = PolygonMesh.of(mesh)
    assert np.array_equal(polygons.triangulated().faces, mesh.faces)
    assert PolygonMesh.of(polygons) is polygons


@every_shape
def test_halfedges_of_polygons_by_counting(shape):
    mesh = EVERY[shape]()
    topology, rows = PolygonTopology.of(mesh), face_rows(mesh)
    sides = [(f, a, b) for f, row in enumerate(rows) for a, b in zip(row, row[1:] + row[:1], strict=True)]
    assert list(zip(topology.face, topology.tail, topology.head, strict=True)) == sides
    directed = {(a, b): h for h, (_, a, b) in enumerate(sides)}
    assert topology.twin.tolist() == [directed.get((b, a), NONE) for _, a, b in sides]
    halfedge = np.arange(len(sides))
    assert np.array_equal(topology.preceding(topology.following(halfedge)), halfedge)
    assert np.array_equal(topology.tail[topology.following(halfedge)], topology.head)
    neighbours = [
        {b for _, a, b in sides if a == v} | {a for _, a, b in sides if b == v} for v in range(mesh.num_verts)
    ]
    assert topology.valence.tolist() == [len(near) for near in neighbours]
    assert topology.corners_of(len(rows) - 1) == rows[-1]
    require_manifold(topology, "the test")


@over("shape", ALL)
def test_triangles_have_the_same_halfedges_either_way(shape):
    one = Topology.of(ALL[shape]())
    two = PolygonTopology.of(one)
    for name in ("tail", "head", "twin", "edges", "edge_of", "faces_per_edge", "valence", "boundary_neighbours"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name
    halfedge = np.arange(len(one.tail))
    for step in ("following", "preceding", "face_of", "next_around_tail"):
        assert np.array_equal(getattr(one, step)(halfedge), getattr(two, step)(halfedge)), step
    assert duplicate_triangles(one).tolist() == duplicate_triangles(two).tolist() == []


SPREAD = np.random.default_rng(0).standard_normal((9, 3))


@over(
    ("rows", "message"),
    [
        ([[0, 1, 2, 3], [1, 0, 4, 5], [0, 1, 6, 7]], r"edge \(0, 1\) has 3 faces; allowed: 1 or 2"),
        ([[0, 1, 2, 3], [0, 1, 4, 5]], r"edge \(0, 1\) has two faces of opposite orientation"),
        ([[0, 1, 2, 3], [0, 4, 5, 6]], "vertex 0 joins separate fans of faces"),
        (
            [[0, 1, 2, 3], [4, 5, 6], [5, 4, 6]],
            r"faces 1 and 2 are triangles with the same three vertices; remove one of them \(1 such pair\)",
        ),
        ([[0, 1, 2, 0, 3]], r"face 0 is \[0, 1, 2, 0, 3\]: it has a vertex twice"),
        ([[0, 1, 2, 3], [3, 2, 9, 5]], r"face 1 is \[3, 2, 9, 5\]: vertices are numbered 0 to 8"),
    ],
)
def test_what_is_no_manifold(rows, message):
    mesh = PolygonMesh(SPREAD, [v for row in rows for v in row], [len(row) for row in rows])
    with pytest.raises(MeshError, match=message):
        require_manifold(PolygonTopology.of(mesh), "the test")
    with pytest.raises(MeshError, match="subdivision needs"):
        subdivide(mesh, "catmull-clark")


def test_two_cones_at_one_tip():
    one = quad_cube()
    names = np.array([0, 8, 9, 10, 11, 12, 13, 14])
    topology = PolygonTopology(15, np.concatenate([one.corners, names[one.corners]]), np.full(12, 4))
    require_faces(topology, "the test")
    assert nonmanifold_verts(topology).tolist() == [0]


@over(
    "rows",
    [
        [[0, 1, 2, 6, 5, 4], [2, 3, 0, 4, 7, 6]],
        [[0, 1, 2, 3], [3, 2, 1, 4]],
        [[0, 1, 2, 3], [3, 2, 1, 0]],
        [[0, 1, 2], [0, 2, 3, 1]],
    ],
)
def test_faces_may_share_several_edges(rows):
    """A tube of two hexagons that share two sides far apart, and faces whose common sides meet, at valence 2."""
    require_manifold(PolygonTopology(8, np.concatenate(rows), np.array([len(row) for row in rows])), "the test")


@over("scheme", ["loop", "interp-sqrt3", "midpoint"])
def test_schemes_on_triangles_refuse_polygons(scheme):
    with pytest.raises(SchemeError, match="refines triangles, and the mesh is of polygons: triangulate it, or choose"):
        subdivide(quad_cube(), scheme)


@over("scheme", ["ternary", "interp-ternary"])
@over(
    ("make", "message"),
    [
        (mixed, r"needs quads: face \d+ has [35] corners"),
        (lambda: prism(5), "face 0 has 5 corners; catmull-clark"),
        (lambda: quad_wheel(5, 2), r"vertex 0, inside, has valence 5, 4 is allowed \(1 such vertex\)"),
        (quad_cube, r"vertex 0, inside, has valence 3, 4 is allowed \(8 such vertices\)"),
        (VALENCE_2["pillow"], r"vertex 0, inside, has valence 2, 4 is allowed \(4 such vertices\)"),
    ],
)
def test_tensor_products_refuse_what_they_have_no_rule_for(scheme, make, message):
    with pytest.raises(MeshError, match=message):
        subdivide(make(), scheme)


def test_ternary_schemes_take_regular_patches_at_every_level():
    mesh = quad_patch(4, 3)
    for scheme in ("ternary", "interp-ternary"):
        assert subdivide(mesh, scheme, 3).num_faces == mesh.num_faces * 9**3


def test_alpha_of_each_vertex():
    mesh = mixed()
    alphas = np.random.default_rng(1).random(mesh.num_verts)
    for scheme in ("interp-catmull-clark", "interp-sqrt2"):
        some, none, whole = (subdivide(mesh, scheme, 1, alpha=alpha).verts for alpha in (alphas, 0.0, 1.0))
        kept = slice(mesh.num_verts)
        expected = none[kept] + alphas[:, None] * (whole - none)[kept]
        np.testing.assert_allclose(some[kept], expected, rtol=0, atol=1e-14)
        assert np.isfinite(subdivide(mesh, scheme, 3, alpha=alphas).verts).all()
    with pytest.raises(SchemeError, match="no parameter alpha"):
        subdivide(mesh, "kobbelt", alpha=alphas)


def test_refinements_carry_anything_given_at_verts():
    mesh = mixed()
    refinement = refine(PolygonTopology.of(mesh), resolve("kobbelt"), 2)
    values = np.random.default_rng(2).standard_normal((mesh.num_verts, 2, 2))
    expected = np.einsum("ij,jkl->ikl", refinement.matrix.toarray(), values)
    np.testing.assert_allclose(refinement(values), expected, rtol=0, atol=1e-13)


def test_the_cube_of_quads_is_the_cube():
    mesh = quad_cube()
    assert np.array_equal(mesh.verts, cube().verts)
    assert mesh.sizes.tolist() == [4] * 6
    across = mesh.triangulated()
    volume = np.linalg.det(across.verts[across.faces]).sum() / 6
    assert np.isclose(volume, (2 / np.sqrt(3)) ** 3)
    require_manifold(PolygonTopology.of(mesh), "the test")
    assert POLYGON_SOLIDS.keys() <= SOLIDS.keys()
