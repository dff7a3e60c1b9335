import pytest
import torch

from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.solids import cube, icosahedron
from meshfit.settings import build
from meshfit.subdivision.refine import subdivide
from tests.benchmarks.plain_twin import PlainTwin

STEPS = 20


def test_the_twin_that_the_engine_is_timed_against_has_the_same_losses():
    weights = {"chamfer": 1.0, "normal": 0.01, "edge": 1.0, "laplacian": 0.1, "consistency": 0.01}
    settings = build(FirstOrderSettings, {"steps": STEPS, "samples": 300, "losses": weights})
    problem = Problem(subdivide(icosahedron(), "loop", 2), cube(), seed=3)
    engine = FirstOrder([problem], settings, torch.device("cpu"), torch.float64)
    twin = PlainTwin(problem, settings, torch.float64)
    for _ in range(STEPS):
        assert engine.step() == pytest.approx([twin.step()], rel=1e-5)
