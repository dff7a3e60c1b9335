"""Laws of every scheme on every mesh: affine invariance, and the same result under any numbering or mirror."""

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.subdivision.refine import subdivide
from tests.laws.variants import INTERPOLATORY, by_variant, dense, refined
from tests.loops import over
from tests.shapes import ALL, mixed_closed, mixed_open, permuted

pytestmark = by_variant
LEVELS = 2


def sorted_rows(matrix: np.ndarray) -> np.ndarray:
    """Rows in an order that depends on their (rounded) entries alone."""
    rounded = matrix.round(11) + 0.0
    return matrix[np.lexsort(rounded.T)]


def face_set(faces: np.ndarray) -> set[tuple[int, ...]]:
    """Faces up to where their rows start."""
    return {tuple(np.roll(face, -int(np.argmin(face)))) for face in faces}


@over("shape", ALL)
def test_rows_sum_to_one(spec, shape):
    matrix = refined(ALL[shape](), spec, LEVELS).matrix
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=4e-15)


@over("make", [mixed_closed, mixed_open])
def test_affine_maps_commute_with_refinement(spec, make):
    mesh, generator = make(), np.random.default_rng(0)
    linear, shift = generator.standard_normal((3, 3)), np.array([10.0, 20.0, 30.0])
    moved_first = subdivide(Mesh(mesh.verts @ linear + shift, mesh.faces), spec, LEVELS)
    moved_last = subdivide(mesh, spec, LEVELS).verts @ linear + shift
    np.testing.assert_allclose(moved_first.verts, moved_last, rtol=0, atol=3e-13)


@over("make", [mixed_closed, mixed_open])
def test_a_mesh_is_refined_alike_under_any_numbering(spec, make):
    mesh = make()
    generator = np.random.default_rng(1)
    order = generator.permutation(mesh.num_verts)
    other = permuted(mesh, order)
    other = Mesh(other.verts, generator.permutation(other.faces))
    expected, found = dense(mesh, spec, LEVELS), dense(other, spec, LEVELS)[:, order]
    np.testing.assert_allclose(sorted_rows(found), sorted_rows(expected), rtol=0, atol=1e-14)
    # Old verts keep their numbers, so at these the rows agree in place too.
    kept = mesh.num_verts
    np.testing.assert_allclose(found[order], expected[:kept], rtol=0, atol=1e-14)


@over("make", [mixed_closed, mixed_open])
def test_it_does_not_matter_at_which_corner_a_face_row_starts(spec, make):
    mesh = make()
    shifts = np.random.default_rng(2).integers(3, size=mesh.num_faces)
    rolled = Mesh(mesh.verts, np.stack([np.roll(face, k) for face, k in zip(mesh.faces, shifts, strict=True)]))
    first, second = subdivide(mesh, spec, 1), subdivide(rolled, spec, 1)
    by_place = np.lexsort(first.verts.round(9).T), np.lexsort(second.verts.round(9).T)
    np.testing.assert_allclose(second.verts[by_place[1]], first.verts[by_place[0]], rtol=0, atol=1e-14)
    name = np.empty(len(second.verts), dtype=int)
    name[by_place[1]] = by_place[0]
    assert face_set(name[second.faces]) == face_set(first.faces)


@over("make", [mixed_closed, mixed_open])
def test_the_mirror_image_is_refined_to_the_mirror_image(spec, make):
    mesh = make()
    mirrored = Mesh(mesh.verts, mesh.faces[:, ::-1])
    np.testing.assert_allclose(
        sorted_rows(dense(mirrored, spec, LEVELS)), sorted_rows(dense(mesh, spec, LEVELS)), rtol=0, atol=1e-14
    )


def test_pieces_do_not_see_each_other(spec):
    one, two = mixed_open(), SOLIDS["octahedron"]()
    both = Mesh(np.concatenate([one.verts, two.verts]), np.concatenate([one.faces, two.faces + one.num_verts]))
    rows = dense(both, spec)
    touches_one = (rows[:, : one.num_verts] != 0).any(axis=1)
    touches_two = (rows[:, one.num_verts :] != 0).any(axis=1)
    assert not (touches_one & touches_two).any()
    found = sorted_rows(rows[touches_two][:, one.num_verts :])
    np.testing.assert_allclose(found, sorted_rows(dense(two, spec)), rtol=0, atol=1e-15)


@over("solid", SOLIDS)
def test_symmetric_solids_stay_symmetric(spec, solid):
    """All of them have the three mirror planes or half-turns, and the three-fold turn about (1, 1, 1)."""
    fine = subdivide(SOLIDS[solid](), spec, 3).verts
    for symmetry in (np.roll(np.eye(3), 1, axis=0), np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, -1.0, -1.0])):
        image = fine @ symmetry
        distance = np.linalg.norm(image[:, None] - fine[None], axis=2).min(axis=1)
        assert distance.max() < 1e-13


def test_interpolatory_schemes_keep_old_verts_and_the_others_do_not(spec):
    for make in (mixed_closed, mixed_open):
        mesh = make()
        kept = dense(mesh, spec, LEVELS)[: mesh.num_verts]
        assert np.array_equal(kept, np.eye(mesh.num_verts)) == (spec in INTERPOLATORY)


def test_boundary_curves_depend_on_boundary_verts_alone(spec):
    mesh = mixed_open()
    refinement = refined(mesh, spec, LEVELS)
    fine_border, border = (border_verts(faces) for faces in (refinement.faces, mesh.faces))
    rows = refinement.matrix.toarray()[fine_border]
    assert len(fine_border) > len(border)
    assert not np.delete(rows, border, axis=1).any()


def border_verts(faces: np.ndarray) -> np.ndarray:
    """Verts of edges that one face uses, by counting."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    distinct, count = np.unique(edges, axis=0, return_counts=True)
    return np.unique(distinct[count == 1])
