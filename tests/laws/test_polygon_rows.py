"""Laws of every scheme on polygons: affine invariance, and the same result under any numbering or mirror."""

import numpy as np
import pytest

from meshfit.mesh.manifold import euler_number, num_components, require_manifold
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from tests.laws.polygon_variants import (
    ANYWHERE,
    INTERPOLATORY,
    KEEPING,
    REGULAR,
    by_variant,
    dense,
    refined,
    shape_of,
    shapes_for,
)
from tests.loops import over
from tests.quads import mixed, quad_cube, quad_patch, renumbered
from tests.shapes import mixed_closed, mixed_open

every_shape = over("shape", shapes_for)
small_shapes = over(
    "shape",
    lambda spec: [s for s in shapes_for(spec) if s in ("mixed open", "prism of 5", "cut corner") or spec in REGULAR],
)
LEVELS = 2


def sorted_rows(matrix: np.ndarray) -> np.ndarray:
    """Rows in an order that depends on their (rounded) entries alone."""
    return matrix[np.lexsort((matrix.round(11) + 0.0).T)]


def face_set(rows, name) -> set[tuple[int, ...]]:
    """Faces with their verts renamed, up to where their rows start."""
    renamed = [[int(name[v]) for v in row] for row in rows]
    return {tuple(row[row.index(min(row)) :] + row[: row.index(min(row))]) for row in renamed}


@by_variant
@every_shape
def test_rows_sum_to_one(spec, shape):
    for operator in refined(shape_of(shape), spec, LEVELS).operators:
        np.testing.assert_allclose(operator.sum(axis=1), 1, rtol=0, atol=4e-15)


@by_variant
@every_shape
@over("levels", [1, 2])
def test_the_surface_stays_an_oriented_manifold_of_the_same_topology(spec, shape, levels):
    mesh = shape_of(shape)
    before, after = PolygonTopology.of(mesh), refined(mesh, spec, levels).finest
    require_manifold(after, "the test")
    assert euler_number(after) == euler_number(before)
    assert num_components(after) == num_components(before)
    assert after.is_watertight == before.is_watertight
    assert (after.valence > 0).all()
    assert np.array_equal(np.unique(after.corners), np.arange(after.num_verts))


@by_variant
@small_shapes
def test_affine_maps_commute_with_refinement(spec, shape):
    mesh, generator = shape_of(shape), np.random.default_rng(0)
    linear, shift = generator.standard_normal((3, 3)), np.array([10.0, 20.0, 30.0])
    moved_first = subdivide(mesh.with_verts(mesh.verts @ linear + shift), spec, LEVELS)
    moved_last = subdivide(mesh, spec, LEVELS).verts @ linear + shift
    np.testing.assert_allclose(moved_first.verts, moved_last, rtol=0, atol=3e-13)


@by_variant
@small_shapes
def test_a_mesh_is_refined_alike_under_any_numbering_and_wherever_its_faces_start(spec, shape):
    mesh, generator = shape_of(shape), np.random.default_rng(1)
    order = generator.permutation(mesh.num_verts)
    rows = [list(np.roll(row, generator.integers(len(row)))) for row in face_rows(renumbered(mesh, order))]
    generator.shuffle(rows)
    other = PolygonMesh(renumbered(mesh, order).verts, [v for row in rows for v in row], [len(row) for row in rows])
    expected, found = dense(mesh, spec, LEVELS), dense(other, spec, LEVELS)[:, order]
    np.testing.assert_allclose(sorted_rows(found), sorted_rows(expected), rtol=0, atol=1e-14)
    if spec in KEEPING:
        np.testing.assert_allclose(found[order], expected[: mesh.num_verts], rtol=0, atol=1e-14)
    # The faces are the same, too, when vertices are identified by their rows.
    first, second = refined(mesh, spec, 1), refined(other, spec, 1)
    matrices = first.matrix.toarray(), second.matrix.toarray()[:, order]
    names = [np.lexsort((matrix.round(11) + 0.0).T).argsort() for matrix in matrices]
    faces = [face_rows(r.mesh(np.zeros((r.finest.num_verts, 3)))) for r in (first, second)]
    assert face_set(faces[0], names[0]) == face_set(faces[1], names[1])


@by_variant
@small_shapes
def test_the_mirror_image_is_refined_to_the_mirror_image(spec, shape):
    mesh = shape_of(shape)
    corners = [v for row in face_rows(mesh) for v in row[::-1]]
    mirrored = PolygonMesh(mesh.verts, corners, mesh.sizes)
    found, expected = dense(mirrored, spec, LEVELS), dense(mesh, spec, LEVELS)
    np.testing.assert_allclose(sorted_rows(found), sorted_rows(expected), rtol=0, atol=1e-14)


@pytest.mark.parametrize("spec", ANYWHERE)
def test_the_cube_stays_symmetric(spec):
    fine = subdivide(quad_cube(), spec, 3).verts
    for symmetry in (np.roll(np.eye(3), 1, axis=0), np.diag([-1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, 1.0])):
        distance = np.linalg.norm((fine @ symmetry)[:, None] - fine[None], axis=2).min(axis=1)
        assert distance.max() < 1e-13


@pytest.mark.parametrize("spec", KEEPING)
def test_interpolatory_schemes_keep_old_verts_and_the_others_do_not(spec):
    for mesh in (quad_patch(5, 4),) if spec in REGULAR else (mixed(), mixed(closed=False), quad_cube()):
        kept = dense(mesh, spec, LEVELS)[: mesh.num_verts]
        assert np.array_equal(kept, np.eye(mesh.num_verts)) == (spec in INTERPOLATORY)


@by_variant
def test_boundary_curves_depend_on_boundary_verts_alone(spec):
    mesh = quad_patch(5, 4) if spec in REGULAR else mixed(closed=False)
    refinement = refined(mesh, spec, LEVELS)
    border, fine = PolygonTopology.of(mesh).boundary_verts, refinement.finest.boundary_verts
    assert fine.sum() > border.sum()
    assert not refinement.matrix.toarray()[fine][:, ~border].any()


@pytest.mark.parametrize("spec", ["catmull-clark", "interp-catmull-clark", "kobbelt", "sqrt2", "interp-sqrt2"])
@pytest.mark.parametrize("curve", ["loop", "interp-loop"])
def test_boundaries_are_those_of_loop_or_its_interpolatory_form(spec, curve):
    """Edges are halved there by the cubic B-spline or the four-point rule, in √2 schemes at every second level."""
    if (spec in INTERPOLATORY) != curve.startswith("interp"):
        return
    mesh = mixed_open()
    border = Topology.of(mesh).boundary_verts
    twice = refine(PolygonTopology.of(Topology.of(mesh)), resolve(spec), 2 if "sqrt2" in spec else 1)
    ours = twice.matrix.toarray()[twice.finest.boundary_verts][:, border]
    loop = refine(Topology.of(mesh), resolve(curve), 1)
    theirs = loop.matrix.toarray()[Topology(loop.matrix.shape[0], loop.faces).boundary_verts][:, border]
    np.testing.assert_allclose(sorted_rows(ours), sorted_rows(theirs), rtol=0, atol=1e-15)


@pytest.mark.parametrize("spec", ANYWHERE)
@over("make", [mixed_closed, mixed_open])
def test_triangles_go_in_as_polygons(spec, make):
    mesh = make()
    found, expected = subdivide(mesh, spec, 2), subdivide(PolygonMesh.of(mesh), spec, 2)
    assert np.array_equal(found.verts, expected.verts)
    assert np.array_equal(found.corners, expected.corners)


@pytest.mark.parametrize("spec", ANYWHERE)
def test_verts_without_faces_stay_put(spec):
    loose, solid = np.array([[5.0, 6.0, 7.0], [-1.0, 2.0, -3.0]]), mixed(closed=False)
    verts = np.concatenate([loose[:1], solid.verts, loose[1:]])
    fine = subdivide(PolygonMesh(verts, solid.corners + 1, solid.sizes), spec, 2)
    expected = subdivide(solid, spec, 2)
    at = [0, 1] if spec == "doo-sabin" else [0, solid.num_verts + 1]
    assert np.array_equal(fine.verts[at], loose)
    np.testing.assert_allclose(np.delete(fine.verts, at, axis=0), expected.verts, rtol=0, atol=1e-15)
    assert not np.isin(fine.corners, at).any()


@by_variant
def test_no_faces_and_no_levels_change_nothing(spec):
    points = PolygonMesh(np.eye(3), [], [])
    assert np.array_equal(subdivide(points, spec, 2).verts, np.eye(3))
    mesh = quad_patch(3, 3)
    same = subdivide(mesh, spec, 0)
    assert np.array_equal(same.verts, mesh.verts)
    assert np.array_equal(same.corners, mesh.corners)


def test_pieces_do_not_see_each_other():
    one, two = mixed(closed=False), quad_cube()
    both = PolygonMesh(
        np.concatenate([one.verts, two.verts]),
        np.concatenate([one.corners, two.corners + one.num_verts]),
        np.concatenate([one.sizes, two.sizes]),
    )
    for spec in ANYWHERE:
        rows = dense(both, spec)
        touches = [(part != 0).any(axis=1) for part in (rows[:, : one.num_verts], rows[:, one.num_verts :])]
        assert not (touches[0] & touches[1]).any()
        found = sorted_rows(rows[touches[1]][:, one.num_verts :])
        np.testing.assert_allclose(found, sorted_rows(dense(two, spec)), rtol=0, atol=1e-15)
