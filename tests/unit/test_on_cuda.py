"""Both engines on a CUDA device, where there is one."""

import warnings
from functools import partial

import numpy as np
import pytest
import torch

import meshfit
from meshfit.fitting import first_order, sampling
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.nearest_neighbours import match_nearest, nearest_neighbour_search
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.settings import build
from meshfit.subdivision.refine import subdivide
from tests.fits import fit
from tests.shapes import real

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")

WEIGHTS = {"chamfer": 1.0, "normal": 0.02, "edge": 0.5, "laplacian": 0.1, "consistency": 0.05}


def problems(count):
    ball, shapes = subdivide(icosahedron(), "loop", 2), [real("bunny", 600), real("bone", 400)]
    return [Problem(ball, Mesh(shapes[k % 2].verts, shapes[k % 2].faces), k) for k in range(count)]


def engine(members, device="cuda", dtype=torch.float32, **changes):
    settings = build(FirstOrderSettings, {"samples": 400, "trace_every": 1, "losses": WEIGHTS} | changes)
    return FirstOrder(members, settings, torch.device(device), dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_pairs_are_those_of_the_cpu(dtype):
    generator = torch.Generator().manual_seed(0)
    p, q = (torch.randn(3 * 500, 3, generator=generator, dtype=dtype) for _ in range(2))
    here, there = match_nearest(p, q, 3), match_nearest(p.cuda(), q.cuda(), 3)
    assert torch.equal(here.forward, there.forward.cpu())
    assert torch.equal(here.backward, there.backward.cpu())
    assert torch.equal(nearest_neighbour_search(p)(q), nearest_neighbour_search(p.cuda())(q.cuda()).cpu())


class Seeding:
    """torch, whose generators are those of the CPU, whatever the device that they are for."""

    Generator = staticmethod(lambda _: torch.Generator())
    __getattr__ = staticmethod(partial(getattr, torch))


def drawn_on_the_cpu(table, count, generators, like):
    uniform = torch.stack([torch.rand(3, count, generator=each, dtype=like.dtype) for each in generators])
    root, third = uniform[:, 1].sqrt(), uniform[:, 1].sqrt() * uniform[:, 2]
    picked = table.pick(uniform[:, 0].sort(1).values.to(like.device))
    return picked, torch.stack([1 - root, root - third, third], 2).view(-1, 3).to(like.device)


@pytest.mark.parametrize("laplacian", ["uniform", "cotangent"])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-9)])
def test_the_same_samples_give_the_losses_of_the_cpu(laplacian, dtype, tolerance, monkeypatch):
    monkeypatch.setattr(first_order, "torch", Seeding())
    monkeypatch.setattr(sampling, "_draw", drawn_on_the_cpu)
    runs = []
    for device in ("cpu", "cuda"):
        fit = engine(problems(3), device, dtype, laplacian=laplacian)
        fit._evaluate = fit._evaluate_eagerly
        for _ in range(10):
            fit.step()
        runs.append([trace.rows for trace in fit.traces])
    np.testing.assert_allclose(runs[1], runs[0], rtol=0, atol=tolerance)


@pytest.mark.parametrize("count", [1, 3])
def test_a_captured_step_is_the_step(count):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours, eager = engine(problems(count)), engine(problems(count))
        eager._evaluate = eager._evaluate_eagerly
        for _ in range(20):
            np.testing.assert_allclose(ours.step(), eager.step(), rtol=1e-4)
    assert ours._evaluate._graph is not None


def test_a_fit_is_as_near_as_on_the_cpu():
    """Samples differ, and with them the losses of single steps, some of which leap."""
    (problem,) = problems(1)
    options = {"steps": 300, "samples": 1000, "losses": WEIGHTS, "trace_every": 1}
    traces = [fit(problem.source, problem.target, device=device, **options).trace.rows for device in ("cpu", "cuda")]
    here, there = (np.median([row[2] for row in rows[-100:]]) for rows in traces)
    np.testing.assert_allclose(there, here, rtol=0.2)


def test_a_member_that_diverges_leaves_the_others_alone():
    good, bad = problems(2)
    huge = Mesh(1e30 * bad.target.verts, bad.target.faces)
    outcomes = meshfit.fit_batch([good, Problem(bad.source, huge, 1)], device="cuda", steps=20, samples=100)
    assert np.isfinite(outcomes[0].mesh.verts).all()
    assert isinstance(outcomes[1], Exception)


@pytest.mark.parametrize("connectivity", ["remeshed", "fixed"])
def test_gauss_newton_reaches_what_it_reaches_on_the_cpu(connectivity):
    (problem,) = problems(1)
    goal = problem.target
    start = Mesh(0.3 * problem.source.verts * np.ptp(goal.verts) + goal.verts.mean(axis=0), problem.source.faces)
    options = {"method": "gauss-newton", "connectivity": connectivity, "levels": 1}
    options |= {"verts": 1000} if connectivity == "remeshed" else {}
    rms = []
    for device in ("cpu", "cuda"):
        result = fit(start, goal, device=device, **options)
        cloud = torch.tensor(goal.verts)
        near = nearest_neighbour_search(torch.tensor(result.mesh.verts))(cloud)
        rms.append(float((torch.tensor(result.mesh.verts)[near] - cloud).norm(dim=1).square().mean().sqrt()))
    assert rms[1] < 1.2 * rms[0]
