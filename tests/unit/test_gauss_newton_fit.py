"""Gauss–Newton fits from end to end: close to the target, sound, and with the requested connectivity."""

from functools import cache

import numpy as np
import pytest
import torch

import meshfit
from meshfit.errors import ConfigError, MeshError
from meshfit.fitting.gauss_newton import fit_state, target
from meshfit.fitting.gauss_newton.engine import COLUMNS
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import refine_state
from meshfit.fitting.gauss_newton.schedule import stage_at
from meshfit.fitting.problem import Diverged
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import euler_number
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.fits import fit
from tests.loops import over
from tests.ragged import BOOK
from tests.shapes import torus

SMALL = {"verts": 600, "levels": 1, "coarse_steps": 15, "tries": 1, "level_steps": 4, "last_steps": 3}
SHORT = SMALL | {"verts": 300, "coarse_steps": 7, "level_steps": 2, "last_steps": 2}
FEW = SMALL | {"verts": 100, "coarse_steps": 6, "level_steps": 1, "last_steps": 1}
FIXED = {"connectivity": "fixed"}
QUADRISECTING = ["loop", "interp-loop", "modified-butterfly", "midpoint"]


@pytest.fixture(autouse=True)
def fewer_points(monkeypatch):
    monkeypatch.setattr(target, "_POINTS", 20_000)


@cache
def ball(levels, radius=1.0):
    mesh = subdivide(icosahedron(), "midpoint", levels)
    return Mesh(radius * mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def ellipsoid():
    return Mesh(ball(4).verts * np.array([1.0, 0.8, 0.6]), ball(4).faces)


def rounded_box():
    """Where x⁴ + y⁴ + z⁴ = 1."""
    return Mesh(ball(4).verts / (ball(4).verts ** 4).sum(axis=1, keepdims=True) ** 0.25, ball(4).faces)


def bumpy():
    x, y, z = ball(4).verts.T
    return Mesh(ball(4).verts * (0.8 + 0.1 * np.sin(3 * x) * np.cos(2 * y) + 0.05 * z)[:, None], ball(4).faces)


# With the largest curvature that each has, or more.
TARGETS = {"ellipsoid": (ellipsoid, 2.8), "rounded box": (rounded_box, 4.0), "bumpy": (bumpy, 4.0)}


def fitted(goal, source=None, **changes):
    options = SMALL | {"method": "gauss-newton", "device": "cpu", "scheme": "loop"} | changes
    return fit(source or ball(2, 0.3), goal, **options)


@pytest.mark.parametrize(
    ("name", "changes"),
    [pytest.param("ellipsoid", {}, marks=pytest.mark.slow), ("rounded box", {}), ("bumpy", FIXED)],
)
def test_a_small_ball_is_fitted_to_a_shape(name, changes):
    """A chord of length h is at most κ h² / 8 off; in the mean surfaces have to be nearer than where they bend most."""
    make, curvature = TARGETS[name]
    goal = make()
    result = fitted(goal, **changes).mesh
    found = meshfit.measure(result, goal, samples=3000, points=1000)
    square = 2 * face_areas(goal).sum() / (np.sqrt(3) * result.num_verts)
    assert found.distance.mean < curvature * square / 8
    assert found.hausdorff.symmetric < 4 * curvature * square / 8
    quality = found.quality
    assert (quality.self_intersecting_faces, quality.flipped_faces, quality.degenerate_faces) == (0, 0, 0)
    assert (quality.euler_number, quality.components, quality.watertight) == (2, 1, True)
    assert 0.7 * SMALL["verts"] < quality.verts <= (642 if changes else SMALL["verts"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "levels"),
    [*((scheme, 1) for scheme in QUADRISECTING), ("loop", 0), ("loop", 2), ("sqrt3", 1), ("sqrt3", 2)],
)
def test_a_fixed_connectivity_is_that_of_the_refined_source(scheme, levels):
    source = ball(1, 0.3)
    result = fitted(ellipsoid(), source, scheme=scheme, **SHORT | FIXED | {"levels": levels}).mesh
    np.testing.assert_array_equal(result.faces, subdivide(source, scheme, levels).faces)


@pytest.mark.parametrize(
    "changes", [{"coarse_steps": 0}, {"level_steps": 1}, {"last_steps": 0}, {"coarse_steps": 0, "last_steps": 0}]
)
def test_a_fixed_connectivity_is_kept_by_stages_without_steps(changes):
    source = ball(1, 0.3)
    result = fitted(ellipsoid(), source, **FEW | FIXED | changes).mesh
    np.testing.assert_array_equal(result.faces, subdivide(source, "loop", 1).faces)


def test_a_source_of_another_genus_keeps_its_own_connectivity():
    source = Mesh(0.3 * torus(12, 8).verts, torus(12, 8).faces)
    result = fitted(torus(40, 20), source, **FEW | FIXED).mesh
    np.testing.assert_array_equal(result.faces, subdivide(source, "loop", 1).faces)


@over("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scheme", ["interp-loop", "modified-butterfly", "midpoint"])
def test_interpolatory_schemes_leave_the_coarse_verts_where_they_are(scheme, dtype):
    mesh = Mesh(ball(2).verts * [1.0, 0.8, 0.6], ball(2).faces)
    surface = FitState.of(torch.tensor(mesh.verts, dtype=dtype), torch.tensor(mesh.faces))
    fine = refine_state(surface, scheme)
    close = {
        "rtol": 0,
        "atol": 0 if scheme != "interp-loop" else 1e-6,
    }  # of which the verts are put back, up to rounding
    torch.testing.assert_close(fine.verts[:162], surface.verts, **close)
    np.testing.assert_allclose(fine.verts, subdivide(mesh, scheme).verts, atol=1e-6)


@pytest.mark.parametrize("scheme", ["loop", pytest.param("modified-butterfly", marks=pytest.mark.slow)])
def test_the_surface_of_a_control_mesh_is_its_refinement(scheme):
    result = fitted(ellipsoid(), scheme=scheme, **FEW | {"variables": "control", "verts": 150})
    expected = subdivide(result.control, scheme, 1)
    np.testing.assert_array_equal(result.mesh.faces, expected.faces)
    np.testing.assert_allclose(result.mesh.verts, expected.verts, atol=1e-5)
    assert result.control.num_verts <= 150


@pytest.mark.parametrize(
    ("goal", "changes"),
    [
        (torus(40, 20), FIXED),
        (torus(40, 20), {"levels": 0}),
        pytest.param(Mesh(ball(3).verts, ball(3).faces[200:]), {}, marks=pytest.mark.slow),
    ],
    ids=["torus, fixed", "torus, remeshed", "open, remeshed"],
)
def test_a_target_of_another_topology_is_fitted_to_the_end(goal, changes):
    result = fitted(goal, **SHORT | changes)
    assert [row[0] for row in result.trace.rows] == list(range(len(result.trace.rows)))
    assert euler_number(Topology.of(result.mesh)) == 2
    assert result.trace.rows[-1][1] < 0.5 * result.trace.rows[0][1]


def test_every_step_is_reported_with_its_stage_and_traced():
    seen, settings = [], GaussNewtonSettings(**SHORT)
    result = fitted(ellipsoid(), on_step=seen.append, **SHORT)
    assert result.control is None
    assert [(step.done, step.steps) for step in seen] == [(k + 1, settings.steps) for k in range(settings.steps)]
    assert [step.stage for step in seen] == [stage_at(settings, step.done).name for step in seen]
    assert result.trace.columns == COLUMNS
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in result.trace.rows]
    assert [row["distance"] for row in rows] == [step.loss for step in seen]
    assert rows[-1]["verts"] == result.mesh.num_verts
    weights = [(row["fairness"], row["point_weight"]) for row in rows]
    assert weights[7:9] == list(stage_at(settings, 7).weights)
    assert all(0 <= row["matched"] <= 1 and 0 <= row["held_back"] <= row["verts"] for row in rows)


@pytest.mark.parametrize("every", [4, pytest.param(100, marks=pytest.mark.slow)])
def test_rows_are_trace_every_steps_apart_and_the_last_step_has_one(every):
    steps = [row[0] for row in fitted(ellipsoid(), **FEW, trace_every=every).trace.rows]
    assert steps == sorted({*range(0, 9, every), 8})


@pytest.mark.parametrize("when", [0, 7])
def test_a_step_that_is_not_finite_ends_the_fit_with_the_last_good_mesh(monkeypatch, when):
    calls, solve, before = [], fit_state.solve_step, []

    def failing(pattern, verts, *arguments):
        calls.append(pattern.connectivity.mesh(verts))
        step, count = solve(pattern, verts, *arguments)
        return step * (torch.nan if len(calls) == when + 1 else 1.0), count

    monkeypatch.setattr(fit_state, "solve_step", failing)
    with pytest.raises(Diverged, match=rf"^the fit diverged at step {when}: the step is not finite; raise ") as caught:
        fitted(ellipsoid(), on_step=before.append, **FEW)
    assert len(before) == when
    np.testing.assert_array_equal(caught.value.last_good.verts, calls[-1].verts)
    np.testing.assert_array_equal(caught.value.last_good.faces, calls[-1].faces)
    assert [row[0] for row in caught.value.trace.rows] == list(range(when))


def test_a_source_that_is_no_manifold_is_refused():
    with pytest.raises(MeshError, match="a Gauss–Newton fit"):
        fitted(ellipsoid(), BOOK)


def test_limit_surfaces_need_a_control_mesh():
    with pytest.raises(ConfigError, match=r"^limit: "):
        fitted(ellipsoid(), limit=True)
