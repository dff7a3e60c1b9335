"""The parameter α of interpolatory Loop: from Loop at 0 to interpolation at 1, everywhere or per vertex."""

from math import cos, pi

import numpy as np
import pytest

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import resolve
from tests.laws.variants import dense
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open

MESHES = {"closed": mixed_closed, "open": mixed_open}
anywhere = over("make", MESHES.values())
OPTIONS = ("weights=loop", "weights=warren", "valence3=zorin", "weights=warren,valence3=zorin")


def with_alphas(mesh: Mesh, alphas, options: str = "weights=loop", levels: int = 1) -> np.ndarray:
    scheme = resolve(f"interp-loop:{options}").with_alpha(np.asarray(alphas, dtype=np.float64))
    return refine(Topology.of(mesh), scheme, levels).matrix.toarray()


@anywhere
@over("options", OPTIONS)
def test_alpha_0_is_loop_exactly(make, options):
    base = "warren" if "warren" in options else "loop"
    blend, loop = dense(make(), f"interp-loop:alpha=0,{options}", 2), dense(make(), f"loop:weights={base}", 2)
    assert np.array_equal(blend, loop)


@anywhere
@over("options", OPTIONS)
def test_the_matrix_is_affine_in_alpha(make, options):
    """Of one level; the blend at 0.3 lies three tenths of the way."""
    start, end, between = (dense(make(), f"interp-loop:alpha={a},{options}") for a in (0, 1, 0.3))
    assert np.abs(start - end).max() > 0.1
    np.testing.assert_allclose(between, 0.7 * start + 0.3 * end, rtol=0, atol=1e-15)


@anywhere
@over("options", OPTIONS)
def test_one_alpha_for_all_verts_equals_an_array_of_it(make, options):
    mesh = make()
    found = with_alphas(mesh, np.full(mesh.num_verts, 0.3), options, levels=2)
    np.testing.assert_allclose(found, dense(mesh, f"interp-loop:alpha=0.3,{options}", 2), rtol=0, atol=1e-15)


@anywhere
@over("levels", [1, 3])
def test_verts_of_alpha_1_are_kept_and_those_of_alpha_0_are_not(make, levels):
    mesh = make()
    alphas = np.random.default_rng(0).integers(2, size=mesh.num_verts).astype(np.float64)
    fine = subdivide(mesh, "interp-loop", levels, alpha=alphas).verts[: mesh.num_verts]
    kept = (fine == mesh.verts).all(axis=1)
    assert np.array_equal(kept, alphas == 1)
    assert set(alphas) == {0, 1}


def test_alpha_acts_near_its_own_vertex_only():
    mesh = mixed_closed()
    alphas = np.zeros(mesh.num_verts)
    alphas[5] = 1
    changed = np.abs(with_alphas(mesh, alphas) - dense(mesh, "loop")).max(axis=1) > 1e-12
    topology = Topology.of(mesh)
    spokes = np.flatnonzero((topology.edges == 5).any(axis=1))
    assert np.array_equal(np.flatnonzero(changed), [5, *(mesh.num_verts + spokes)])


@anywhere
@over("options", OPTIONS[:2])
def test_alpha_of_an_inserted_vertex_is_the_mean_of_the_ends_of_its_edge(make, options):
    mesh = make()
    topology = Topology.of(mesh)
    alphas = np.random.default_rng(1).random(mesh.num_verts)
    finer = np.concatenate([alphas, alphas[topology.edges].mean(axis=1)])
    once = subdivide(mesh, f"interp-loop:{options}", 1, alpha=alphas)
    twice = subdivide(once, f"interp-loop:{options}", 1, alpha=finer)
    at_once = subdivide(mesh, f"interp-loop:{options}", 2, alpha=alphas)
    np.testing.assert_allclose(at_once.verts, twice.verts, rtol=0, atol=1e-14)


@anywhere
@over("levels", [1, 2, 3])
def test_unified_sqrt3_takes_an_alpha_for_each_vertex_too(make, levels):
    """Verts of α = 1 stay; one α for all equals an array of it, also where the boundary is trisected."""
    mesh = make()
    alphas = np.random.default_rng(2).integers(2, size=mesh.num_verts).astype(np.float64)
    fine = subdivide(mesh, "lin-luo-sqrt3", levels, alpha=alphas).verts[: mesh.num_verts]
    moves = ~Topology.of(mesh).boundary_verts | (levels > 1)
    assert np.array_equal((fine == mesh.verts).all(axis=1), (alphas == 1) | ~moves)
    even = subdivide(mesh, "lin-luo-sqrt3", levels, alpha=np.full(mesh.num_verts, 0.3))
    np.testing.assert_allclose(even.verts, subdivide(mesh, "lin-luo-sqrt3:alpha=0.3", levels).verts, atol=1e-14)


@anywhere
def test_alpha_of_a_vertex_in_a_face_is_the_mean_of_its_corners(make):
    mesh = make()
    alphas = np.random.default_rng(3).random(mesh.num_verts)
    once = subdivide(mesh, "lin-luo-sqrt3", 1, alpha=alphas)
    twice = subdivide(mesh, "lin-luo-sqrt3", 2, alpha=alphas)
    finer = np.concatenate([alphas, alphas[mesh.faces].mean(axis=1)])
    second = refine(Topology.of(once), resolve("lin-luo-sqrt3").with_alpha(finer), 2).operators[0] @ once.verts
    inner = ~Topology.of(once).boundary_verts
    # On its own the second step leaves the boundary alone, so only verts off it are compared.
    np.testing.assert_allclose(twice.verts[: once.num_verts][inner], second[: once.num_verts][inner], atol=1e-14)


def limit_restoring_shift(mesh: Mesh, ring_weight) -> np.ndarray:
    """(V, V) each vertex moved, the others left, such that its own Loop limit is where it was."""
    topology = Topology.of(mesh)
    moved = np.zeros((mesh.num_verts, mesh.num_verts))
    for vert in range(mesh.num_verts):
        if topology.boundary_verts[vert]:
            neighbours, own = topology.boundary_neighbours[vert], 4 / 6
            share = 1 / 6
        else:
            neighbours = np.unique(topology.edges[(topology.edges == vert).any(axis=1)])
            neighbours = neighbours[neighbours != vert]
            share = 1 / (len(neighbours) + 3 / (8 * ring_weight(len(neighbours))))
            own = 1 - len(neighbours) * share
        moved[vert, vert] = 1 / own
        moved[vert, neighbours] = -share / own
    return moved


def loop_weight(n: int) -> float:
    return (5 / 8 - (3 / 8 + cos(2 * pi / n) / 4) ** 2) / n


def warren_weight(n: int) -> float:
    return 3 / 16 if n == 3 else 3 / (8 * n)


@anywhere
@pytest.mark.parametrize(("weights", "ring_weight"), [("loop", loop_weight), ("warren", warren_weight)])
def test_new_verts_are_loops_own_after_an_end_is_made_to_interpolate(make, weights, ring_weight):
    """Li and Zheng's construction: do so for either end alone, apply Loop's edge rule, and take the mean of both."""
    mesh = make()
    topology = Topology.of(mesh)
    moved = limit_restoring_shift(mesh, ring_weight)
    edge_rule = dense(mesh, f"loop:weights={weights}")[mesh.num_verts :]
    found = dense(mesh, f"interp-loop:weights={weights}")[mesh.num_verts :]
    on_border = topology.boundary_verts[topology.edges]
    checked = ~on_border.any(axis=1) | topology.boundary_edges
    for edge in np.flatnonzero(checked):
        expected = np.zeros(mesh.num_verts)
        for end in topology.edges[edge]:
            control = np.eye(mesh.num_verts)
            control[end] = moved[end]
            expected += edge_rule[edge] @ control / 2
        np.testing.assert_allclose(found[edge], expected, rtol=0, atol=1e-15)
    assert checked.sum() > 20
