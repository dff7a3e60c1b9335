"""Fits from sources that are near to their target: detected, short, and never worse than the source."""

import numpy as np
import pytest
import torch

from meshfit.errors import MeshfitWarning
from meshfit.fitting.fit import fit
from meshfit.fitting.gauss_newton import closeness
from meshfit.fitting.gauss_newton import engine as gauss_newton
from meshfit.fitting.gauss_newton.closeness import Closeness, hidden_share, is_near
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.manifold import describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.pieces import crossing_faces, manifold_pieces
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.solids import cube, icosahedron
from meshfit.mesh.targets import load_target
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.shapes import torus

pytestmark = pytest.mark.usefixtures("fewer_target_points")

SETTINGS = GaussNewtonSettings(connectivity="fixed", coarse_steps=20, level_steps=3, last_steps=2)


def shape(mesh):
    return Shape(Connectivity(torch.tensor(mesh.faces), mesh.num_verts, torch.float64), torch.tensor(mesh.verts))


def cloud(mesh):
    return TargetCloud.of(mesh, torch.float64, torch.device("cpu"))


def ball(levels, radius=1.0):
    mesh = subdivide(icosahedron(), "loop", levels)
    return Mesh(radius * mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


def engine(source, goal, settings=SETTINGS):
    return GaussNewton([Problem(source, goal, 0)], settings, torch.device("cpu"), torch.float32)


def to_the_end(fit):
    while fit.done < fit.steps:
        fit.step()
    return fit


def test_decimated_targets_are_near_and_spheres_of_other_sizes_are_far():
    for goal in (torus(24, 16), ball(3)):
        for faces in (60, 200, 400):
            assert is_near(shape(decimate(goal, faces)), cloud(goal), goal)[0], faces
        for levels, radius in ((0, 1.6), (2, 0.3), (3, 0.3), (3, 1.4)):
            assert not is_near(shape(ball(levels, radius)), cloud(goal), goal)[0], (levels, radius)


def test_a_plate_is_near_to_itself_however_thin_it_is_and_is_not_lost():
    plate = subdivide(cube(), "midpoint", 2)
    plate = plate.with_verts(plate.verts * [1.0, 0.02, 0.0002])
    fit = engine(plate, plate)
    assert fit.progress(0) == (0, SETTINGS.steps - SETTINGS.tries * SETTINGS.coarse_steps)
    before, after = (Closeness.of(mesh, plate) for mesh in (plate, to_the_end(fit).mesh(0)))
    assert not after.is_worse_than(before)


def test_closeness_of_concentric_spheres_is_the_difference_of_their_radii():
    goal, outer = ball(4), ball(4, 1.1)
    found = Closeness.of(outer, goal)
    assert found.rms == pytest.approx(0.1, rel=0.05)
    assert 0.09 < found.worst < 0.12


def test_what_parts_of_a_target_hide_of_each_other_is_a_share_of_its_area():
    outer, inner = ball(3), ball(3, 0.5)
    goal = Mesh(
        np.concatenate([outer.verts, inner.verts]), np.concatenate([outer.faces, inner.faces + outer.num_verts])
    )
    assert hidden_share(outer) == 0
    assert hidden_share(goal) == pytest.approx(0.2, rel=0.05)  # 0.5² of 1 + 0.5²
    assert hidden_share(Mesh(goal.verts, goal.faces[1:])) == 0


def test_a_fit_from_a_near_source_skips_the_search_and_keeps_genus_and_detail():
    goal = torus(24, 16)
    source = decimate(goal, 200)
    fit = to_the_end(engine(source, goal))
    assert fit.traces[0].column("step")[0] == SETTINGS.tries * SETTINGS.coarse_steps
    assert describe_topology(Topology.of(fit.mesh(0))) == describe_topology(Topology.of(goal))
    before, after = (Closeness.of(mesh, goal) for mesh in (source, fit.mesh(0)))
    assert after.rms < before.rms / 2
    assert after.worst < before.worst
    assert not fit.shortfalls(0)


@pytest.mark.parametrize("connectivity", ["fixed", pytest.param("remeshed", marks=pytest.mark.slow)])
def test_a_fit_that_would_end_worse_returns_the_surface_of_its_source_and_says_so(monkeypatch, connectivity):
    goal = torus(24, 16)
    source = decimate(goal, 200)
    # A bug that shrinks the surface at every step.
    step = FitState.step

    def spoiled(self, *args):
        report = step(self, *args)
        return type(report)(
            type(report.state)(self.pattern, 0.9 * self.verts, self.stiffness, polygons=self.polygons),
            report.pairs,
            0,
        )

    monkeypatch.setattr(gauss_newton.FitState, "step", spoiled)
    fit = to_the_end(engine(source, goal, SETTINGS.model_copy(update={"connectivity": connectivity, "verts": 300})))
    (text,) = fit.shortfalls(0)
    assert "farther from the target than its source" in text
    before, after = (Closeness.of(mesh, goal) for mesh in (source, fit.mesh(0)))
    assert not after.is_worse_than(before)


@pytest.mark.slow
def test_a_target_that_crosses_itself_is_named_where_a_sound_result_is_farther():
    with pytest.warns(MeshfitWarning, match=r"farther .* source was, \d+ faces of which cross others; surface: outer"):
        found = fit("target", load_target("cow"), method="gauss-newton", device="cpu")
    assert not crossing_faces(found.mesh)[0].any()


def test_a_corner_that_is_cut_off_does_not_outweigh_a_surface_that_is_much_nearer():
    before = Closeness(rms=5e-4, worst=3e-3, diagonal=2.4)
    assert not Closeness(rms=1.4e-4, worst=1.3e-2, diagonal=2.4).is_worse_than(before)
    assert Closeness(rms=4e-4, worst=1.3e-2, diagonal=2.4).is_worse_than(before)
    assert Closeness(rms=1.4e-4, worst=5e-2, diagonal=2.4).is_worse_than(before)


@pytest.mark.parametrize("faces", [pytest.param(50, marks=pytest.mark.slow), 100])
def test_a_fit_from_a_very_coarse_source_ends_no_farther_than_it_began(faces):
    """One of 50 faces is no near one, by its edges; one of 100 has needles, none of which cross."""
    target = load_target("airplane")
    source = decimate(target, faces)
    with pytest.warns(MeshfitWarning, match="so the result is the surface of the source"):
        result = fit(source, target, method="gauss-newton", connectivity="fixed", levels=0, coarse_steps=10)
    assert not Closeness.of(result.mesh, target).is_worse_than(Closeness.of(source, target))


def test_a_larger_distance_somewhere_is_the_price_of_a_much_better_fit_only():
    """The largest distance grows by a fifth, from 1 % of the diagonal."""
    before = Closeness(0.004, 0.01, 1.0)
    much_better, hardly_better = Closeness(0.002, 0.012, 1.0), Closeness(0.0039, 0.012, 1.0)
    assert not much_better.is_worse_than(before)
    assert much_better.has_grown(before)
    assert much_better.growth_text(before) == "the largest distance grew from 1 % to 1.2 % of the diagonal"
    assert hardly_better.is_worse_than(before)
    assert not Closeness(0.0039, 0.0105, 1.0).is_worse_than(before)
    assert not Closeness(0.0039, 0.006, 1.0).has_grown(Closeness(0.004, 0.005, 1.0))


def test_a_fit_whose_largest_distance_grew_says_so(monkeypatch):
    goal = torus(24, 16)
    source = decimate(goal, 200)
    monkeypatch.setattr(closeness, "_GROWN_DIAGONAL", 0.0)
    monkeypatch.setattr(closeness, "_GROWN", 0.0)
    (text,) = to_the_end(engine(source, goal)).shortfalls(0)
    assert "the largest distance grew from" in text


@pytest.mark.slow
def test_pieces_that_cross_in_the_target_are_fitted_although_they_cross():
    ring = torus(24, 16)
    other = Mesh(ring.verts[:, [2, 0, 1]] + [2, 0, 0], ring.faces)
    goal = Mesh(np.concatenate([ring.verts, other.verts]), np.concatenate([ring.faces, other.faces + ring.num_verts]))
    source = manifold_pieces(decimate(goal, 500))
    fit = to_the_end(engine(source, goal, SETTINGS.model_copy(update={"connectivity": "remeshed", "verts": 900})))
    before, after = (Closeness.of(mesh, goal) for mesh in (source, fit.mesh(0)))
    assert not fit.shortfalls(0)
    assert after.rms < before.rms
    crossing, within = crossing_faces(fit.mesh(0))
    assert crossing.any()
    assert not within.any()
    again = engine(source, goal)
    again.restore([engine(source, goal).checkpoint(0)])
    assert again._states[0].crossing


@over("points", [False, True])
def test_a_near_fit_is_resumed_to_the_byte(points):
    goal = torus(24, 16)
    source = decimate(goal, 200)
    goal = PointCloud(torus(48, 32).verts) if points else goal
    whole = to_the_end(engine(source, goal))
    half = engine(source, goal)
    while half.done < half.steps - 3:
        half.step()
    again = engine(source, goal)
    again.restore([half.checkpoint(0)])
    np.testing.assert_array_equal(to_the_end(again).mesh(0).verts, whole.mesh(0).verts)
    assert again.traces[0].rows == whole.traces[0].rows


def heap(count):
    """Return many small balls in one place, each of which crosses most others."""
    rng, small = np.random.default_rng(0), ball(0, 0.3)
    verts = [small.verts + 0.2 * rng.normal(size=3) for _ in range(count)]
    return Mesh(np.concatenate(verts), np.concatenate([small.faces + small.num_verts * i for i in range(count)]))


def apart(levels):
    sphere = ball(levels)
    return sphere.with_verts(sphere.verts + np.array([3.0, 0, 0]))


def test_a_fit_to_points_that_cannot_become_sound_is_cut_short_and_says_so():
    source, goal = heap(8), PointCloud(apart(2).verts)
    settings = SETTINGS.model_copy(update={"connectivity": "remeshed", "verts": 24})
    fit = engine(source, goal, settings)
    half = None
    while fit.done < fit.steps:
        half = fit.checkpoint(0) if fit._made[0] == 1 else half
        fit.step()
    texts = fit.shortfalls(0)
    assert sum(text.startswith("cut short: the source crosses itself, and has too many pieces") for text in texts) == 1
    assert any("more than the 24 wanted, as its 8 pieces cannot do with so few" in text for text in texts)
    # One step of each stage, and no search for a rough shape.
    stages = len({id(stage) for stage, _ in fit._plans[False] if stage.attempt is None})
    assert fit.progress(0) == (stages, stages)
    assert len(fit.traces[0].rows) == stages
    assert fit.mesh(0).num_verts > 24
    assert np.isfinite(fit.mesh(0).verts).all()
    again = engine(source, goal, settings)
    again.restore([half])
    np.testing.assert_array_equal(to_the_end(again).mesh(0).verts, fit.mesh(0).verts)
    assert again.shortfalls(0) == texts


@over(("connectivity", "verts", "count"), [("fixed", 60, 20), ("remeshed", 600, 20), ("remeshed", 60, 1)])
def test_a_fit_is_not_cut_short_where_it_can_be_remeshed_or_has_no_need_to(connectivity, verts, count):
    settings = SETTINGS.model_copy(update={"connectivity": connectivity, "verts": verts})
    assert not engine(heap(count), apart(1), settings)._restarts[0].hopeless
