"""Creases and corners: exact rows, decreasing sharpness, and creases compared with boundaries."""

from fractions import Fraction
from math import inf

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS, cube
from meshfit.mesh.topology import Topology
from meshfit.subdivision.creases import Creases, creases_by_angle
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from tests.laws.test_subdivision_masks import fractions_of
from tests.loops import each, over
from tests.shapes import ALL, mixed_closed, mixed_open, permuted, torus, wheel

TAKING = (
    "midpoint",
    "loop",
    "loop:weights=warren",
    "interp-loop",
    "interp-loop:alpha=0.5",
    "interp-loop:valence3=zorin",
    "interp-loop:alpha=0.5,weights=warren,valence3=zorin",
    "butterfly:tension=0",
)
COLUMNS, ROWS = 9, 8
ROW = [(i, (i + 1) % COLUMNS) for i in range(COLUMNS)]
by_spec = each("spec", TAKING, ("midpoint", "loop", "interp-loop:alpha=0.5,weights=warren,valence3=zorin"))
anywhere = over("make", [mixed_closed, mixed_open])


def operator_of(mesh: Mesh, spec: str, creases: Creases | None, levels: int = 1) -> np.ndarray:
    return refine(Topology.of(mesh), resolve(spec), levels, creases).matrix.toarray()


def on_torus(spec: str, sharpness=inf, edges=ROW, corners=()) -> tuple[np.ndarray, Topology]:
    """The rows of a regular torus with a crease along its first row of verts."""
    mesh = torus(COLUMNS, ROWS)
    topology = Topology.of(mesh)
    return operator_of(mesh, spec, Creases.of(topology, edges, sharpness, corners)), topology


def edge_row(topology: Topology, a: int, b: int) -> int:
    return topology.num_verts + int(np.flatnonzero((topology.edges == sorted((a, b))).all(axis=1))[0])


def some_creases(mesh: Mesh, seed: int = 0, share: float = 0.3) -> Creases:
    """Edges and corners at random, of sharpness 0 to 3 or infinite."""
    generator, topology = np.random.default_rng(seed), Topology.of(mesh)
    edges = np.flatnonzero(generator.random(topology.num_edges) < share)
    sharpness = generator.choice([0.2, 0.5, 1, 1.4, 2.3, inf], size=len(edges))
    corners = np.flatnonzero(generator.random(mesh.num_verts) < 0.1)
    return Creases.of(topology, topology.edges[edges], sharpness, corners)


def test_the_rules_of_loop_on_a_crease_as_fractions():
    matrix, topology = on_torus("loop")
    assert fractions_of(matrix[3]) == {2: Fraction(1, 8), 3: Fraction(6, 8), 4: Fraction(1, 8)}
    assert fractions_of(matrix[edge_row(topology, 3, 4)]) == {3: Fraction(1, 2), 4: Fraction(1, 2)}
    across = fractions_of(matrix[edge_row(topology, 3, 3 + COLUMNS)])
    assert sorted(across.values()) == [Fraction(1, 8)] * 2 + [Fraction(3, 8)] * 2


@over("s", [Fraction(1, 4), Fraction(1, 2), Fraction(3, 4)])
def test_a_sharpness_below_one_blends_the_rules_with_and_without(s):
    matrix, topology = on_torus("loop", float(s))
    ring = [COLUMNS + 3, COLUMNS + 2, COLUMNS * (ROWS - 1) + 3, COLUMNS * (ROWS - 1) + 4]
    smooth = (1 - s) * Fraction(1, 16)
    assert fractions_of(matrix[3]) == {
        3: (1 - s) * Fraction(10, 16) + s * Fraction(6, 8),
        **dict.fromkeys((2, 4), smooth + s * Fraction(1, 8)),
        **dict.fromkeys(ring, smooth),
    }
    assert fractions_of(matrix[edge_row(topology, 3, 4)]) == {
        **dict.fromkeys((3, 4), (1 - s) * Fraction(3, 8) + s * Fraction(1, 2)),
        **dict.fromkeys((COLUMNS + 3, COLUMNS * (ROWS - 1) + 4), (1 - s) * Fraction(1, 8)),
    }


@pytest.mark.parametrize(
    ("spec", "vert", "inserted"),
    [
        ("interp-loop", {3: 1}, {2: -1, 3: 9, 4: 9, 5: -1}),
        ("interp-loop:alpha=0.5", {2: 1, 3: 14, 4: 1}, {2: -1, 3: 17, 4: 17, 5: -1}),
        ("midpoint", {3: 1}, {3: 1, 4: 1}),
    ],
)
def test_the_curve_of_a_crease_is_that_of_the_boundary(spec, vert, inserted):
    """For interpolatory Loop, the four-point curve."""
    matrix, topology = on_torus(spec)
    for row, weights in ((3, vert), (edge_row(topology, 3, 4), inserted)):
        assert fractions_of(matrix[row]) == {k: Fraction(w, sum(weights.values())) for k, w in weights.items()}


@by_spec
def test_corners_stay_whether_tagged_or_made_by_three_creases(spec):
    matrix, topology = on_torus(spec, corners=[5, 40])
    third = np.array([*ROW, (3, 3 + COLUMNS)])
    assert fractions_of(matrix[5]) == {5: 1}
    assert fractions_of(matrix[40]) == {40: 1}
    assert fractions_of(on_torus(spec, edges=third)[0][3]) == {3: 1}
    if spec == "interp-loop":
        # A corner has no displacement, so that only the other end of the edge gives its own.
        ends = {5: Fraction(1, 2) - Fraction(1, 16), 6: Fraction(1, 2) + Fraction(1, 8), 7: Fraction(-1, 16)}
        assert fractions_of(matrix[edge_row(topology, 5, 6)]) == ends


@pytest.mark.parametrize("spec", ["loop", "interp-loop"])
@over("s", [0.5, 1, inf])
def test_a_crease_that_ends_alone_is_a_dart_and_smooth_there(spec, s):
    smooth, _ = on_torus(spec, 0.0)
    dart, topology = on_torus(spec, s, edges=[(3, 4)])
    changed = np.flatnonzero(np.abs(smooth - dart).max(axis=1) > 1e-14)
    assert changed.tolist() == [edge_row(topology, 3, 4)]


def test_sharpness_goes_down_by_one_with_each_level_and_stays_with_the_halves():
    mesh = mixed_closed()
    topology = Topology.of(mesh)
    given = {0: 2.5, 3: 0.5, 7: inf, 11: 1.0}
    creases = Creases.of(topology, topology.edges[list(given)], list(given.values()), corners=[4])
    for level in (1, 2, 3):
        refinement = refine(topology, resolve("loop"), level, creases)
        left = refinement.creases.sharpness
        expected = sorted(s - level for s in given.values() if s > level for _ in range(2**level))
        assert sorted(left[left > 0]) == expected
        assert np.flatnonzero(refinement.creases.corners).tolist() == [4]
        fine = Topology(refinement.matrix.shape[0], refinement.faces)
        # The halves of an edge lie on the polyline that it is to linear interpolation.
        places = refine(topology, resolve("midpoint"), level)(mesh.verts)
        a, b = mesh.verts[topology.edges[7]]
        middle = places[fine.edges[np.isinf(left)]].mean(axis=1)
        along = (middle - a) @ (b - a) / ((b - a) @ (b - a))
        np.testing.assert_allclose(np.sort(along), (np.arange(2**level) + 0.5) / 2**level, atol=1e-12)
        np.testing.assert_allclose(middle, a + along[:, None] * (b - a), atol=1e-12)


@by_spec
@anywhere
@over("k", [0, 1, 2])
def test_sharpness_k_is_k_sharp_levels_and_smooth_ones_after(spec, make, k):
    mesh = make()
    topology = Topology.of(mesh)
    edges = topology.edges[::4]
    at_once = subdivide(mesh, spec, 3, creases=Creases.of(topology, edges, k))
    sharp = refine(topology, resolve(spec), k, Creases.of(topology, edges))
    in_turn = subdivide(Mesh(sharp(mesh.verts), sharp.faces), spec, 3 - k)
    assert np.array_equal(at_once.faces, in_turn.faces)
    np.testing.assert_allclose(at_once.verts, in_turn.verts, rtol=0, atol=1e-13)


@by_spec
@anywhere
def test_levels_at_once_are_levels_one_by_one_with_what_is_left_of_the_creases(spec, make):
    mesh = make()
    creases = some_creases(mesh)
    at_once = subdivide(mesh, spec, 3, creases=creases)
    for _ in range(3):
        refinement = refine(Topology.of(mesh), resolve(spec), 1, creases)
        mesh, creases = Mesh(refinement(mesh.verts), refinement.faces), refinement.creases
    np.testing.assert_allclose(at_once.verts, mesh.verts, rtol=0, atol=1e-13)


@by_spec
@over("shape", ALL)
def test_creases_at_the_boundary_change_nothing(spec, shape):
    mesh = ALL[shape]()
    topology = Topology.of(mesh)
    plain = operator_of(mesh, spec, None, 2)
    border = topology.edges[topology.boundary_edges]
    for creases in (Creases.of(topology), Creases.of(topology, border, 0.3), Creases.of(topology, border)):
        assert np.array_equal(operator_of(mesh, spec, creases, 2), plain)


@by_spec
@over("shape", ALL)
def test_rows_sum_to_one(spec, shape):
    mesh = ALL[shape]()
    rows = operator_of(mesh, spec, some_creases(mesh), 2)
    np.testing.assert_allclose(rows.sum(axis=1), 1, rtol=0, atol=4e-15)


@by_spec
@anywhere
def test_affine_maps_commute_with_refinement(spec, make):
    mesh, generator = make(), np.random.default_rng(0)
    creases = some_creases(mesh)
    linear, shift = generator.standard_normal((3, 3)), np.array([10.0, 20.0, 30.0])
    moved_first = subdivide(Mesh(mesh.verts @ linear + shift, mesh.faces), spec, 2, creases=creases)
    moved_last = subdivide(mesh, spec, 2, creases=creases).verts @ linear + shift
    np.testing.assert_allclose(moved_first.verts, moved_last, rtol=0, atol=3e-13)


@by_spec
@anywhere
def test_a_mesh_is_refined_alike_under_any_numbering(spec, make):
    mesh, generator = make(), np.random.default_rng(1)
    topology, creases = Topology.of(mesh), some_creases(mesh)
    order = generator.permutation(mesh.num_verts)
    other = permuted(mesh, order)
    other = Mesh(other.verts, generator.permutation(other.faces))
    renamed = order[topology.edges][:, ::-1]
    again = Creases.of(Topology.of(other), renamed, creases.sharpness, order[np.flatnonzero(creases.corners)])
    first, second = operator_of(mesh, spec, creases, 2), operator_of(other, spec, again, 2)[:, order]
    np.testing.assert_allclose(second[order], first[: mesh.num_verts], rtol=0, atol=1e-14)
    sort = [matrix[np.lexsort((matrix.round(11) + 0.0).T)] for matrix in (first, second)]
    np.testing.assert_allclose(sort[1], sort[0], rtol=0, atol=1e-14)


@by_spec
@over("centre", [0, 5, 14])
def test_a_closed_crease_parts_the_surface_as_a_cut_would(spec, centre):
    """On either side, the mesh with a crease about a vertex's faces is refined as that side alone is, with a rim."""
    mesh = mixed_closed()
    topology = Topology.of(mesh)
    inner = (mesh.faces == centre).any(axis=1)
    sides = [mesh.faces[inner], mesh.faces[~inner]]
    rims = [Topology(mesh.num_verts, faces) for faces in sides]
    rim = rims[0].edges[rims[0].boundary_edges]
    assert (np.bincount(rim.reshape(-1)) <= 2).all()
    fine = subdivide(mesh, spec, 2, creases=Creases.of(topology, rim))
    for faces in sides:
        used = np.unique(faces)
        alone = subdivide(Mesh(mesh.verts[used], np.searchsorted(used, faces)), spec, 2)
        distance = np.linalg.norm(alone.verts[:, None] - fine.verts[None], axis=2).min(axis=1)
        assert distance.max() < 1e-13


@pytest.mark.parametrize("spec", ["midpoint", "loop", "interp-loop", "interp-loop:alpha=0.4"])
def test_a_cube_with_sharp_edges_stays_a_cube(spec):
    solid = cube()
    creases = creases_by_angle(solid, 45)
    assert int((creases.sharpness > 0).sum()) == 12
    fine = subdivide(solid, spec, 3, creases=creases)
    side = solid.verts.max()
    np.testing.assert_allclose(np.abs(fine.verts).max(axis=1), side, rtol=0, atol=1e-14)
    assert np.array_equal(fine.verts[:8], solid.verts)
    volume = np.linalg.det(fine.verts[fine.faces]).sum() / 6
    assert np.isclose(volume, (2 * side) ** 3, rtol=1e-12)
    if spec == "loop":
        assert np.abs(subdivide(solid, spec, 3).verts).max() < 0.9 * side


def test_the_sharper_a_cube_the_larger_it_stays():
    solid = cube()
    volumes = []
    for sharpness in (0, 0.5, 1, 1.5, 2, inf):
        fine = subdivide(solid, "loop", 3, creases=creases_by_angle(solid, 45, sharpness))
        volumes.append(np.linalg.det(fine.verts[fine.faces]).sum() / 6)
    assert np.all(np.diff(volumes) > 1e-2)


@pytest.mark.parametrize("spec", ["loop", "interp-loop"])
@over("sharpness", [1.0, 2.0])
def test_sharpness_acts_without_jumps_where_levels_meet(spec, sharpness):
    mesh = torus(COLUMNS, ROWS)
    topology = Topology.of(mesh)
    near = [operator_of(mesh, spec, Creases.of(topology, ROW, sharpness + d), 3) for d in (-1e-9, 0, 1e-9)]
    for other in near[::2]:
        assert np.abs(other - near[1]).max() < 1e-8


def test_the_valence_3_safeguard_is_for_smooth_verts_only():
    """With a crease through the vertex of valence 3, the pure rule holds again, which is that of a boundary there."""
    mesh = wheel(3)
    topology = Topology.of(mesh)
    ring = topology.edges[(topology.edges == 0).any(axis=1)]
    for creases, same in ((Creases.of(topology, ring[:2]), True), (Creases.of(topology), False)):
        found = [operator_of(mesh, f"interp-loop:valence3={rule}", creases) for rule in ("zorin", "displacement")]
        assert np.array_equal(*found) == same


def test_angles_are_those_between_the_faces_normals():
    for name, degrees in {"tetrahedron": 109.4712, "cube": 90.0, "octahedron": 70.5288, "icosahedron": 41.8103}.items():
        solid = SOLIDS[name]()
        edges = {"tetrahedron": 6, "cube": 12, "octahedron": 12, "icosahedron": 30}[name]
        assert int((creases_by_angle(solid, degrees - 1e-3).sharpness > 0).sum()) == edges
        assert not creases_by_angle(solid, degrees + 1e-3).sharpness.any()


def test_along_a_boundary_and_in_a_plane_no_angle_makes_a_crease():
    mesh = wheel(7, 2)
    creases = creases_by_angle(mesh, 1)
    assert np.array_equal(creases.sharpness > 0, Topology.of(mesh).boundary_edges)
