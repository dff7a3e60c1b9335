"""Outliers of targets: stray points and spikes, found and given up, on surfaces that are known."""

import numpy as np
import pytest
import torch

from meshfit.errors import MeshfitWarning
from meshfit.fitting.fit import fit
from meshfit.fitting.gauss_newton.correspondences import find_correspondences
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.mesh.any_mesh import as_mesh
from meshfit.mesh.control_mesh import control_mesh_of
from meshfit.mesh.geometry import signed_volume, unit_vectors
from meshfit.mesh.manifold import describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.outliers import spikes, stray_points
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.topology import Topology
from meshfit.subdivision.sphere import icosphere
from tests.loops import over

NOISE = 0.005


def ball(count, stray=0.0, noise=NOISE, seed=0, keep=None):
    """Return points of the unit ball's surface, then stray ones in its box."""
    generator = np.random.default_rng(seed)
    points = unit_vectors(generator.normal(size=(count, 3)))
    if keep is not None:
        points = points[generator.uniform(size=count) < keep(points)]
    points = points * (1 + noise * generator.normal(size=(len(points), 1)))
    return points, generator.uniform(-1.2, 1.2, (round(stray * len(points)), 3))


def off_ball(points):
    return np.abs(np.linalg.norm(points, axis=1) - 1)


@over("share", [0.02, 0.1, 0.3])
def test_stray_points_are_found_and_few_others(share):
    inside, outside = ball(4000, share)
    stray = stray_points(np.concatenate([inside, outside]))
    assert stray[: len(inside)].mean() < 0.003
    kept = outside[~stray[len(inside) :]]
    assert (off_ball(kept) < 0.25).all()
    assert len(kept) < 0.25 * len(outside)


@over("falls", [1.0, 2.0, 3.4])
def test_uneven_density_is_no_reason_to_drop_points(falls):
    points, _ = ball(40_000, keep=lambda at: np.exp(falls * (at[:, 0] - 1)))
    assert stray_points(points).mean() < 0.01


def test_a_few_points_and_equal_points_are_kept():
    assert not stray_points(ball(40)[0]).any()
    assert not stray_points(np.zeros((500, 3))).any()


def with_spikes(mesh, noise, seed=0):
    generator = np.random.default_rng(seed)
    heights = noise * generator.normal(size=(mesh.num_verts, 1))
    chosen = generator.choice(mesh.num_verts, 12, replace=False)
    heights[chosen] = 0.3 * generator.choice([-1, 1], (12, 1))
    return mesh.with_verts(mesh.verts * (1 + heights)), chosen


def test_spikes_are_found_and_no_others():
    mesh, chosen = with_spikes(icosphere(4), NOISE)
    assert np.array_equal(np.flatnonzero(spikes(mesh, NOISE)), np.sort(chosen))


def test_corners_and_borders_are_no_spikes():
    disc = icosphere(4)
    half = Mesh(disc.verts, disc.faces[disc.verts[disc.faces].mean(axis=1)[:, 2] > 0])
    for mesh in (as_mesh("cube", triangles=True), half):
        assert not spikes(mesh, 1e-6).any()


def test_a_wrap_goes_around_the_points_and_not_around_stray_ones():
    points = np.concatenate(ball(4000, 0.05))
    control = control_mesh_of(Mesh(points, []), "wrap", verts=300).mesh
    assert off_ball(control.verts).max() < 0.15
    assert len(np.unique(control.faces)) == control.num_verts


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 0.01])
def test_a_wrap_stays_outside_where_points_are_sparse(noise):
    """A ball whose one half has a tenth of the points of the other keeps them, and its wrap is a ball."""
    points, _ = ball(6000, noise=noise, keep=lambda at: np.where(at[:, 0] > 0, 1.0, 0.1))
    stray = stray_points(points)
    assert stray[points[:, 0] < 0].mean() < 0.1
    control = control_mesh_of(PointCloud(points), "wrap", verts=300).mesh
    assert describe_topology(Topology.of(control)) == "1 piece, closed, genus 0"
    assert off_ball(control.verts).max() < 0.2
    assert 0.95 < signed_volume(control) / (4 / 3 * np.pi) < 1.25


def test_a_cloud_with_stray_points_gives_the_ball():
    clean, stray = ball(3000, 0.1)
    settings = {"verts": 500, "levels": 0, "last_steps": 3, "decimate_from": 1.0, "device": "cpu", "normalise": "none"}
    with pytest.warns(MeshfitWarning, match=r"% of the target's points were left out as outliers"):
        result = fit("auto", PointCloud(np.concatenate([clean, stray])), method="gauss-newton", **settings).mesh
    away = off_ball(result.verts)
    assert np.median(away) < 2 * NOISE
    # Points apart from the surface by no more than its own points from each other look like a part of it.
    spacing = np.sqrt(4 * np.pi / len(clean))
    assert away.max() < 3 * spacing


@pytest.mark.slow
def test_spikes_of_a_noisy_mesh_are_given_up_unless_told_otherwise():
    mesh, _ = with_spikes(icosphere(4), NOISE)
    settings = {"verts": 1000, "levels": 0, "last_steps": 3, "decimate_from": 1.0, "device": "cpu", "normalise": "none"}
    worst = {
        robust: off_ball(fit("auto", mesh, method="gauss-newton", robust=robust, **settings).mesh.verts).max()
        for robust in ("auto", "off")
    }
    assert worst["auto"] < 0.03 < worst["off"]


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:(source and target differ|the target is open .1 opening|the points show an open surface)"
)
def test_what_the_target_shows_is_marked_on_the_result():
    """A ball without its cap: what fills the cap is marked, with its share of the area, and a closed ball has none."""
    whole, height = icosphere(4), 0.6
    cut = Mesh(whole.verts, whole.faces[whole.verts[whole.faces][:, :, 2].max(axis=1) < height])
    points, _ = ball(8000, noise=0.0)
    settings = {"connectivity": "fixed", "levels": 0, "coarse_steps": 0, "level_steps": 4, "last_steps": 1}
    settings |= {"device": "cpu", "normalise": "none", "register": "off"}
    for target in (cut, PointCloud(points[points[:, 2] < height])):
        result = fit(icosphere(3), target, method="gauss-newton", **settings)
        attributes = result.mesh.attributes
        for marks, at in (
            (attributes.vertex["supported"], result.mesh.verts),
            (attributes.face["supported"], result.mesh.verts[result.mesh.faces].mean(axis=1)),
        ):
            clear = np.abs(at[:, 2] - height) > 0.12
            assert np.array_equal(marks[clear] != 0, at[clear, 2] < height)
        # The fill is no larger than the ball's cap, of area 2π (1 - height).
        assert (1 + height) / 2 - 0.04 < result.supported < 0.9
    closed = fit(icosphere(3), whole, method="gauss-newton", **settings)
    assert closed.supported is None
    assert not closed.mesh.attributes


@pytest.mark.slow
def test_holes_are_filled_where_asked_and_marked():
    """A ball without two caps becomes a closed ball, on which the caps are smooth and marked."""
    whole, height = icosphere(4), 0.8
    cut = Mesh(whole.verts, whole.faces[np.abs(whole.verts[whole.faces][:, :, 2]).max(axis=1) < height])
    control = control_mesh_of(cut, "closed", verts=400).mesh
    assert describe_topology(Topology.of(control)) == "1 piece, closed, genus 0"
    settings = {"verts": 800, "levels": 0, "last_steps": 3, "decimate_from": 1.0, "device": "cpu", "normalise": "none"}
    result = fit("closed", cut, method="gauss-newton", **settings)
    assert Topology.of(result.mesh).is_watertight
    marks = result.mesh.attributes.vertex["supported"] != 0
    away = off_ball(result.mesh.verts)
    assert away[marks].max() < 0.02
    # Flat discs would be 0.2 away.
    assert 0 < (~marks).sum() < 0.3 * len(marks)
    assert away[~marks].max() < 0.16


def shape_of(mesh):
    verts = torch.tensor(mesh.verts)
    return Shape(Connectivity(torch.tensor(np.array(mesh.faces)), len(verts), verts.dtype), verts)


def test_an_outlier_loses_its_weight_and_a_part_out_of_reach_keeps_it():
    generator = np.random.default_rng(0)
    points = unit_vectors(generator.normal(size=(4000, 3)))
    part = np.linalg.norm(points - [0.0, 0.0, 1.0], axis=1) < 0.4
    raised = np.where(part[:, None], 1.3, 1.0) * points
    raised[:3] = [[1.3, 0, 0], [-1.3, 0, 0], [0, -1.3, 0]]
    target = TargetCloud.of(PointCloud(raised, points), torch.float64, torch.device("cpu"), NOISE, robust=False)
    pairs = find_correspondences(shape_of(icosphere(3)), target, torch.Generator().manual_seed(0), "to-source", 3.0)
    goals = (pairs.corners[:, :, None] * shape_of(icosphere(3)).corners[pairs.face]).sum(1) + pairs.residuals
    far, on_part = goals.norm(dim=1) > 1.2, goals[:, 2] > 0.5
    full = pairs.weights.max()
    assert bool((pairs.weights[far & on_part] == full).all())
    assert bool(far[~on_part].any())
    assert bool((pairs.weights[far & ~on_part] < 1e-6 * full).all())
    assert float(pairs.weights[~far].median()) > 0.8 * float(full)
