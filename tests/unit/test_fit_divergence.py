"""Divergence: the error names step and term, and keeps the last good mesh and the trace."""

import numpy as np
import pytest
import torch

import meshfit
from meshfit.errors import TrialError
from meshfit.fitting import first_order
from meshfit.fitting.problem import COLUMNS, Diverged
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from tests.fits import fit

TERMS = COLUMNS[2:-1]
NOTHING = dict.fromkeys(TERMS, 0.0)


def diverged(**changes):
    options = {"steps": 50, "samples": 40, "device": "cpu", "trace_every": 1} | changes
    with pytest.raises(Diverged) as caught:
        fit(icosahedron(), cube(), **options)
    error = caught.value
    assert isinstance(error, TrialError)
    assert error.exit_code == 1
    assert str(error).startswith(f"the fit diverged at step {error.step}: {error.term} is not finite; lower")
    assert "\n" not in str(error)
    assert np.isfinite(error.last_good.verts).all()
    np.testing.assert_array_equal(error.last_good.faces, icosahedron().faces)
    traced = error.step + error.term.startswith("gradient")  # a loss that has no gradient is still known
    assert [row[0] for row in error.trace.rows] == list(range(traced))
    assert all(np.isfinite(row).all() for row in error.trace.rows)
    return error


@pytest.mark.parametrize(
    ("optimizer", "dtype", "lr"),
    [
        ("sgd", "float32", 1e5),
        ("sgd", "float32", 1e12),
        ("sgd", "float32", 1e37),
        ("sgd", "float64", 1e5),
        ("sgd", "float64", 1e37),
        ("sgd", "float64", 1e300),
        ("adam", "float32", 1e20),  # steps of Adam are about as long as the rate, and do not add up as fast
        ("adam", "float64", 1e200),
    ],
)
def test_a_huge_learning_rate_diverges(optimizer, dtype, lr):
    assert diverged(optimizer={"name": optimizer, "lr": lr}, dtype=dtype).step >= 1


def test_the_last_good_mesh_has_the_polygons_of_the_source():
    quads = meshfit.subdivide("cube", "catmull-clark", 1)
    with pytest.raises(Diverged) as caught:
        meshfit.fit(quads, icosahedron(), steps=9, samples=40, optimizer={"lr": 1e30}, device="cpu")
    np.testing.assert_array_equal(caught.value.last_good.corners, quads.corners)


@pytest.mark.parametrize("name", TERMS)
def test_a_huge_learning_rate_diverges_whichever_term_acts(name):
    error = diverged(losses=NOTHING | {name: 1.0}, optimizer={"lr": 1e30})
    assert error.step >= 1
    assert error.term in {name, f"gradient of {name}", "vertex position"}


@pytest.mark.parametrize("name", TERMS)
def test_an_astronomical_weight_is_named(name):
    error = diverged(losses={"normal": 0.01, name: 1e39})
    assert (error.step, error.term) == (0, name)
    np.testing.assert_allclose(error.last_good.verts, icosahedron().verts, rtol=1e-6)


def test_weights_that_are_too_large_only_together_are_put_down_to_the_loss():
    error = diverged(losses=dict.fromkeys(TERMS, 1.6e38))
    assert (error.step, error.term) == (0, "loss")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_weight_that_throws_verts_out_of_range_is_noticed_after_the_step_that_led_there(dtype):
    error = diverged(losses={"edge": 1e30 if dtype == "float32" else 1e200}, dtype=dtype)
    assert (error.step, error.term) == (1, "vertex position")


def test_a_gradient_that_is_not_finite_is_put_down_to_its_term(monkeypatch):
    def kinked(state):
        moved = state.verts - state.verts.detach()
        return moved.square().sum().sqrt()[None]

    monkeypatch.setitem(first_order.TERMS, "edge", kinked)
    error = diverged()
    assert (error.step, error.term) == (0, "gradient of edge")
    np.testing.assert_allclose(error.last_good.verts, icosahedron().verts, rtol=1e-6)


@pytest.mark.parametrize("name", TERMS)
def test_a_term_that_becomes_nan_is_named_and_the_mesh_before_is_kept(monkeypatch, name):
    steps, term = [], first_order.TERMS[name]

    def failing(state):
        if torch.is_grad_enabled():  # and not while a row is traced
            steps.append(state.verts.detach().clone())
        return term(state) * (torch.nan if len(steps) == 4 else 1.0)

    monkeypatch.setitem(first_order.TERMS, name, failing)
    if name == "laplacian":
        monkeypatch.setitem(first_order.LAPLACIANS, "uniform", failing)
    error = diverged(losses={"normal": 0.01})
    assert (error.step, error.term) == (3, name)
    np.testing.assert_array_equal(error.last_good.verts, steps[2].double().numpy())


def test_positions_that_the_last_step_leads_out_of_range_are_noticed():
    error = diverged(steps=1, losses=NOTHING | {"edge": 1e30}, optimizer={"lr": 1e30})
    assert (error.step, error.term) == (1, "vertex position")
    np.testing.assert_allclose(error.last_good.verts, icosahedron().verts, rtol=1e-6)


def test_a_single_vertex_out_of_range_is_noticed_though_no_sample_lies_near_it(monkeypatch):
    def throwing(state):
        """Pulls at vertex 0 only, hard enough to overflow."""
        return state.verts[0].sum()[None] * 1e30

    monkeypatch.setitem(first_order.TERMS, "edge", throwing)
    error = diverged(losses=NOTHING | {"chamfer": 1e-9, "edge": 1.0}, optimizer={"lr": 1e9})
    assert (error.step, error.term) == (1, "vertex position")


def test_a_target_too_far_off_for_squared_distances_names_the_term():
    far = Mesh(np.where([True, False, False], 1e30, cube().verts), cube().faces)
    with pytest.raises(Diverged) as caught:
        fit(icosahedron(), far, steps=3, samples=40, device="cpu")
    assert (caught.value.step, caught.value.term) == (0, "chamfer")


def test_a_term_of_weight_0_does_not_act_even_where_it_is_not_finite(monkeypatch):
    monkeypatch.setitem(first_order.TERMS, "normal", lambda state: state.verts.sum()[None] * torch.nan)
    result = fit(icosahedron(), cube(), steps=2, samples=40, device="cpu")
    assert np.isfinite(result.mesh.verts).all()
    assert [np.isnan(row).nonzero()[0].tolist() for row in result.trace.rows] == [[COLUMNS.index("normal")]] * 2
