"""Polynomials that schemes reproduce on the regular lattice: values at old vertices give those at new ones."""

import numpy as np
import pytest

from meshfit.mesh.topology import Topology
from tests.laws.variants import INTERPOLATORY, QUADRISECTING, SQRT3, by_variant, dense, refined
from tests.shapes import patch

COLUMNS, ROWS = 12, 12
DEGREE = {
    "midpoint": 1,
    "loop": 1,
    "loop:weights=warren": 1,
    "interp-loop:alpha=0.25": 1,
    "interp-loop:alpha=0.5": 1,
    "interp-loop": 3,
    "interp-loop:weights=warren": 3,
    "interp-loop:valence3=zorin": 3,
    "butterfly": 3,
    "butterfly:tension=0.03": 1,
    "modified-butterfly": 3,
    "sqrt3": 1,
    "lin-luo-sqrt3:alpha=0.5": 1,
    "lin-luo-sqrt3": 2,
    "interp-sqrt3": 3,
}


def monomials(points: np.ndarray, degree: int) -> np.ndarray:
    """(N, degree + 1) values of x^k y^(degree - k), centred so that they stay of moderate size."""
    x, y = (points[:, :2] - 5.5).T
    return np.stack([x**k * y ** (degree - k) for k in range(degree + 1)], axis=1)


def lattice_places(spec: str, levels: int = 1) -> np.ndarray:
    """Where the fine verts lie on the lattice: new ones at the mean of their edge's ends or their face's corners."""
    mesh = patch(COLUMNS, ROWS)
    if spec in QUADRISECTING:
        return refined(mesh, "midpoint", levels).matrix @ mesh.verts
    assert levels == 1
    return np.concatenate([mesh.verts, mesh.verts[mesh.faces].mean(axis=1)])


def inside(points: np.ndarray, margin: float) -> np.ndarray:
    """Which lie at least that far from the patch's sides."""
    return ((points[:, :2] >= margin) & (points[:, :2] <= COLUMNS - 1 - margin)).all(axis=1)


def errors(spec: str, degree: int, margin: float) -> float:
    mesh, places = patch(COLUMNS, ROWS), lattice_places(spec)
    error = np.abs(dense(mesh, spec) @ monomials(mesh.verts, degree) - monomials(places, degree))
    return error[inside(places, margin)].max()


@pytest.mark.parametrize(("spec", "highest"), DEGREE.items())
def test_reproduction_inside(spec, highest):
    for degree in range(highest + 1):
        assert errors(spec, degree, margin=3) < 1e-12
    assert errors(spec, highest + 1, margin=3) > 1e-3


@by_variant
def test_linear_functions_survive_along_straight_sides(spec):
    """Everywhere but near the patch's corners, where the boundary curve itself is rounded off."""
    mesh, places = patch(COLUMNS, ROWS), lattice_places(spec)
    x, y = places[:, 0], places[:, 1]
    away = (np.abs(x - 5.5) < 3) | (np.abs(y - 5.5) < 3)
    found = dense(mesh, spec) @ mesh.verts
    assert (y[away] == 0).sum() > 5
    np.testing.assert_allclose(found[away], places[away], rtol=0, atol=1e-14)


@pytest.mark.parametrize("spec", ["butterfly", "butterfly:tension=0.125", "modified-butterfly", "interp-sqrt3"])
def test_mirrored_wings_keep_linear_functions_up_to_the_corners(spec):
    mesh, places = patch(5, 4), None
    matrix = dense(mesh, spec)
    topology = Topology.of(mesh)
    if spec in SQRT3:
        places, inner = mesh.verts[mesh.faces].mean(axis=1), np.full(mesh.num_faces, fill_value=True)
    else:
        places, inner = mesh.verts[topology.edges].mean(axis=1), ~topology.boundary_edges
    found = matrix[mesh.num_verts :] @ mesh.verts
    np.testing.assert_allclose(found[inner], places[inner], rtol=0, atol=1e-14)


@pytest.mark.parametrize("spec", [spec for spec in INTERPOLATORY if DEGREE.get(spec, 0) >= 2])
def test_boundary_curves_are_cubic(spec):
    """Along a side, at twice or thrice the parameter, including a boundary vertex of any valence on the way."""
    mesh = patch(COLUMNS, ROWS)
    levels = 2 if spec in SQRT3 else 1
    matrix = refined(mesh, spec, levels).operators[-1].toarray()
    coarse = np.zeros(matrix.shape[1])
    t = np.arange(COLUMNS) - 5.5
    for degree in range(4):
        coarse[:COLUMNS] = t**degree
        touched = np.abs(matrix[:, :COLUMNS]).sum(axis=1) > 0
        alone = touched & ~np.abs(matrix[:, COLUMNS:]).any(axis=1)
        places = matrix[:, :COLUMNS] @ t
        clear = alone & (np.abs(places) < 4)
        np.testing.assert_allclose((matrix @ coarse)[clear], places[clear] ** degree, rtol=0, atol=1e-12)
        wanted = np.arange(-10, 12) / 3 + 1 / 6 if spec in SQRT3 else np.arange(-7, 8) / 2
        assert np.isclose(wanted[:, None], places[clear]).any(axis=1).all()


@pytest.mark.parametrize(("spec", "order"), [("loop", 0.0), ("interp-loop:alpha=0.5", 0.5), ("interp-loop", 1.0)])
def test_quadratics_are_displaced_by_a_constant(spec, order):
    """Loop lifts this paraboloid by the same amount everywhere, and α takes that share of it back."""
    mesh, places = patch(COLUMNS, ROWS), lattice_places(spec)

    def paraboloid(points):
        x, y = points[:, 0] - 5.5, points[:, 1] - 5.5
        return x**2 + x * y + y**2

    gap = (dense(mesh, spec) @ paraboloid(mesh.verts) - paraboloid(places))[inside(places, 3)]
    # Each of the six neighbours lies at value 1, so the vertex rule gives 6/16.
    np.testing.assert_allclose(gap, (1 - order) * 6 / 16, rtol=0, atol=1e-12)
