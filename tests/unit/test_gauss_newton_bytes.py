"""Byte-identity of Gauss–Newton fits: same seed, any number of threads, any batch, with and without interruption."""

from functools import cache

import numpy as np
import pytest
import torch

from meshfit.fitting.batch import fit_batch
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.gauss_newton import restarts, target
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.loop import run
from meshfit.fitting.problem import Diverged, Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.settings import build
from meshfit.subdivision.refine import subdivide
from tests.checkpoints import through_a_file
from tests.fits import fit
from tests.ragged import bytes_of
from tests.shapes import torus

pytestmark = pytest.mark.slow  # whole fits, many times over

# With a remesh among the first steps of either try.
SMALL = {"verts": 120, "levels": 1, "coarse_steps": 6, "tries": 2, "level_steps": 1, "last_steps": 2}
KINDS = {
    "remeshed": {},
    "fixed": {"connectivity": "fixed"},
    "control": {"connectivity": "fixed", "variables": "control", "trace_every": 3},
}
EACH = pytest.mark.parametrize("kind", KINDS)
STEPS = 16
# At the start, where one try ends and the other begins, before and after its remesh, and around decimation.
RESTORED = (0, 6, 11, 12, 14, 15)


@pytest.fixture(autouse=True)
def fewer_points(monkeypatch):
    monkeypatch.setattr(target, "_POINTS", 5000)
    monkeypatch.setattr(restarts, "_ENOUGH", 2.0)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@cache
def source():
    mesh = subdivide(icosahedron(), "midpoint", 1)
    return Mesh(0.3 * mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


@cache
def goal():
    box = subdivide(cube(), "loop", 3)
    return Mesh(box.verts * np.array([1.0, 0.8, 0.6]), box.faces)


def settings(kind, **changes):
    return build(GaussNewtonSettings, SMALL | KINDS[kind] | changes)


def fitted(kind, **changes):
    return fit(source(), goal(), settings(kind), **{"device": "cpu", "seed": 3} | changes)


@cache
def expected(kind, **changes):
    return bytes_of(fitted(kind, **changes))


@EACH
def test_the_same_seed_gives_the_same_bytes_and_another_gives_others(kind):
    assert settings(kind).steps == STEPS
    assert bytes_of(fitted(kind)) == expected(kind)
    assert bytes_of(fitted(kind, seed=4)) != expected(kind)


@pytest.mark.usefixtures("threads")
def test_threads_change_no_byte():
    torch.set_num_threads(2)
    assert bytes_of(fitted("remeshed", threads=2)) == expected("remeshed")
    assert torch.get_num_threads() == 2


def test_global_generators_are_neither_used_nor_changed():
    torch.manual_seed(1)
    before = torch.get_rng_state()
    assert bytes_of(fitted("fixed")) == expected("fixed")
    assert torch.equal(torch.get_rng_state(), before)


def test_single_and_double_precision_agree_until_decisions_are_made_by_rounding():
    single, double = (fitted("fixed", dtype=dtype).trace.rows for dtype in ("float32", "float64"))
    np.testing.assert_allclose(np.array(single)[:4], np.array(double)[:4], rtol=1e-3)
    assert double != single
    assert expected("fixed", dtype="float64") == expected("fixed", dtype="float64")


@EACH
def test_restored_in_any_stage_it_ends_at_the_same_bytes(kind):
    moving = GaussNewton([Problem(source(), goal(), 3)], settings(kind), torch.device("cpu"), torch.float32)
    held = []
    for done in range(STEPS + 1):
        held.append(moving.checkpoint(0))
        if done in RESTORED:
            result = fitted(kind, resume=through_a_file(held[-1]))
            assert bytes_of(result) == expected(kind), f"after step {done}"
        if done < STEPS:
            moving.step()
    # Nor have those from before changed as the fit went on, and one is not used up by whoever goes on from it.
    assert bytes_of(fitted(kind, resume=held[13])) == expected(kind)


@pytest.mark.parametrize(("kind", "stop"), [("remeshed", 14), ("fixed", 8)])
def test_a_fit_that_is_interrupted_saves_and_goes_on_from_there(kind, stop):
    saved, seen = [], []

    def interrupt(step):
        if step.done == stop:
            raise Interrupted

    with pytest.raises(Interrupted):
        fitted(kind, on_step=interrupt, save=saved.append)
    *_, checkpoint = saved  # on a busy machine there are earlier ones
    assert bytes_of(fitted(kind, resume=through_a_file(checkpoint), on_step=seen.append)) == expected(kind)
    assert [step.done for step in seen] == list(range(stop + 1, STEPS + 1))


PROBLEMS = [
    Problem(source(), goal(), 3),
    Problem(Mesh(0.4 * torus(8, 6).verts, torus(8, 6).faces), goal(), 5, scheme="interp-loop"),
    Problem(source(), torus(20, 12), 3),
]


@cache
def alone(place, kind):
    problem = PROBLEMS[place]
    return bytes_of(
        fit(
            problem.source,
            problem.target,
            settings(kind, tries=1),
            seed=problem.seed,
            scheme=problem.scheme,
            device="cpu",
        )
    )


@pytest.mark.parametrize(("kind", "places"), [("remeshed", (1, 0)), ("fixed", (2, 0, 1)), ("fixed", (0, 2))])
def test_neither_order_nor_the_rest_of_the_batch_matters(kind, places):
    outcomes = fit_batch([PROBLEMS[place] for place in places], settings(kind, tries=1), device="cpu")
    assert [bytes_of(outcome) for outcome in outcomes] == [alone(place, kind) for place in places]


def test_problems_of_one_engine_go_on_as_they_do_alone_when_one_of_them_fails():
    broken = Problem(source(), Mesh(1e30 * goal().verts, goal().faces), 0)
    together = [PROBLEMS[0], broken, PROBLEMS[1]]
    outcomes = run(GaussNewton(together, settings("fixed", tries=1), torch.device("cpu"), torch.float32))
    assert isinstance(outcomes[broken], Diverged)
    assert outcomes[broken].step == 0
    # The source, remeshed.
    assert np.linalg.norm(outcomes[broken].last_good.verts, axis=1).min() > 0.2
    assert np.linalg.norm(outcomes[broken].last_good.verts, axis=1).max() < 0.45
    assert [bytes_of(outcomes[PROBLEMS[place]]) for place in (0, 1)] == [alone(place, "fixed") for place in (0, 1)]
