"""Restarts of the rough shape: the best is kept, and unnecessary ones are skipped."""

import numpy as np
import pytest
import torch

from meshfit.fitting.gauss_newton import restarts
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.restarts import Restarts
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron, octahedron
from meshfit.subdivision.refine import subdivide

pytestmark = pytest.mark.usefixtures("fewer_target_points")


def surface(mesh):
    return FitState.of(torch.tensor(mesh.verts), torch.tensor(mesh.faces))


FIRST, SECOND, THIRD = (surface(make()) for make in (icosahedron, octahedron, lambda: subdivide(icosahedron(), "loop")))


@pytest.mark.parametrize(
    ("shares", "hidden", "best", "settled"),
    [
        ((0.8, 0.9, 0.95), 0.0, 2, False),
        ((0.9, 0.97, 0.95), 0.0, 1, True),
        ((0.999, 0.8, 1.0), 0.0, 0, True),
        ((0.9, 0.91, 1.0), 0.0, 1, True),  # the second gained too little for a third
        ((0.9, 0.91, 1.0), 0.4, 0, True),  # what is left is hidden
    ],
)
def test_the_search_with_most_matched_points_is_kept_and_a_good_one_is_enough(shares, hidden, best, settled):
    rough = Restarts()
    assert not rough.settled
    for share, found in zip(shares, (FIRST, SECOND, THIRD), strict=True):
        rough.reached = share
        kept = rough.end_search(found, lambda: hidden)
    assert kept is (FIRST, SECOND, THIRD)[best]
    assert rough.settled == settled


@pytest.mark.parametrize("best", [None, FIRST])
def test_restarts_are_restored_to_the_byte(best):
    rough = Restarts(best, 0.5, 0.25, 0.375, 0.125, settled=best is None)
    again = Restarts.restored(rough.saved(), torch.float64, torch.device("cpu"))
    assert (again.share, again.matched, again.reached, again.distance) == (0.5, 0.25, 0.375, 0.125)
    assert again.settled == rough.settled
    assert (again.best is None) == (best is None)
    if again.best is not None:
        assert torch.equal(again.best.verts, best.verts)
        assert torch.equal(again.best.pattern.connectivity.faces, best.pattern.connectivity.faces)


def engine(tries):
    ball = subdivide(icosahedron(), "loop", 2)
    source, goal = Mesh(0.3 * ball.verts, ball.faces), Mesh(ball.verts * [1.0, 0.8, 0.6], ball.faces)
    settings = GaussNewtonSettings(verts=300, coarse_steps=8, tries=tries, level_steps=1, last_steps=1)
    return GaussNewton([Problem(source, goal, 0)], settings, torch.device("cpu"), torch.float32)


def taken_to_the_end(fit):
    distances = []
    while fit.done < fit.steps:
        distances += fit.step()
    return fit.mesh(0), [row[0] for row in fit.traces[0].rows], distances


@pytest.mark.slow
def test_unnecessary_restarts_take_no_step_and_change_nothing(monkeypatch):
    monkeypatch.setattr(restarts, "_ENOUGH", 0.5)
    (once, _, _), (thrice, steps, distances) = taken_to_the_end(engine(1)), taken_to_the_end(engine(3))
    np.testing.assert_array_equal(once.verts, thrice.verts)
    assert steps == [*range(8), *range(24, 27)]
    assert distances[8:24] == [distances[7]] * 16


def test_restarts_begin_from_the_source(monkeypatch):
    monkeypatch.setattr(restarts, "_ENOUGH", 2.0)
    _, steps, distances = taken_to_the_end(engine(2))
    assert steps == list(range(19))
    # Both begin as far off as the source is, and draw other points.
    assert distances[8] == pytest.approx(distances[0], rel=0.05)
    assert distances[8] != distances[0]
    assert distances[7] < 0.2 * distances[0]


def test_a_surface_that_spans_what_the_target_does_not_show_is_not_searched_for_again():
    """All of a shell with a hole is reached at once; the rest of a closed surface has nothing to be matched with."""
    ball = subdivide(icosahedron(), "loop", 3)
    shell = ball.with_verts(ball.verts * [1.0, 0.8, 0.6])
    source, shown = ball.with_verts(0.5 * ball.verts), shell.verts[shell.faces].mean(axis=1)[:, 0] > -0.4
    holed = Mesh(shell.verts, shell.faces[shown])
    settings = GaussNewtonSettings(
        connectivity="fixed", tries=3, coarse_steps=10, level_steps=1, last_steps=1, levels=0
    )
    made = {}
    for name, target in (("whole", shell), ("holed", holed)):
        fit = GaussNewton([Problem(source, target, 0)], settings, torch.device("cpu"), torch.float32)
        taken_to_the_end(fit)
        rough = fit._restarts[0]
        assert rough.settled
        assert rough.share > 0.992
        assert (rough.matched < 0.9) == (name == "holed")
        made[name] = fit.progress(0)[0]
    assert made["holed"] == made["whole"] == 12
