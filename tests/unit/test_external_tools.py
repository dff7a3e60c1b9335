"""Each ready entry of external tools, on a small ball and a squashed one."""

import importlib

import numpy as np
import pytest

from meshfit.experiment.running.commands import missing_tool
from meshfit.fitting.external.engine import run_external
from meshfit.fitting.external.tools import TOOLS, ToolError, missing_module
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import ExternalSettings
from meshfit.measuring.measure import measure
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.meshlab import screened_poisson
from meshfit.mesh.topology import Topology
from meshfit.subdivision.sphere import icosphere
from tests.loops import over

# Options, the largest mean distance from the target, and whether the faces are those of the source.
CASES = {
    "poisson": ({"samples": 5000, "depth": 5}, 0.01, False),
    "alpha-wrap": ({"alpha": 0.05, "offset": 0.005}, 0.04, False),
    "quadric": ({"verts": 100}, 0.02, False),
    "nricp": ({"variant": "sumner"}, 0.03, True),
    "pycpd": ({"points": 300, "eigenvectors": 60, "iterations": 30}, 0.05, True),
    "meshmonk": ({"iterations": 20}, 0.05, True),
    "reach-for-the-spheres": ({"grid": 12}, 0.03, False),
}


def squashed():
    ball = icosphere(3)
    return ball.with_verts(ball.verts * np.array([1.0, 0.8, 0.7]))


def test_every_ready_entry_has_a_case():
    assert CASES.keys() == TOOLS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_ready_entry_comes_near_the_target_and_gives_the_same_bytes_again(name):
    for module in TOOLS[name].requires:
        pytest.importorskip(module, reason="needs the extra peers")
    options, largest, keeps_faces = CASES[name]
    source, target = icosphere(2), squashed()
    settings = ExternalSettings(tool=name, options=options)
    (mesh, run), (again, _) = (run_external(Problem(source, target, seed=3), settings) for _ in range(2))
    result = mesh.triangulated()
    assert measure(result, target, MeasureSettings(samples=5000, points=500)).distance.mean < largest
    assert (result.faces.tobytes() == source.faces.tobytes()) == keeps_faces
    assert run.version.startswith(f"{TOOLS[name].package} ")
    assert 0 < run.seconds < 60
    assert again.verts.tobytes() == mesh.verts.tobytes()
    assert again.corners.tobytes() == mesh.corners.tobytes()


@pytest.mark.slow
@over("name", [name for name, tool in TOOLS.items() if not tool.seeded])
def test_tools_that_run_once_for_all_seeds_do_not_depend_on_them(name):
    if missing_module(name) is not None:
        return
    settings = ExternalSettings(tool=name, options=CASES[name][0])
    first, second = (run_external(Problem(icosphere(2), squashed(), seed), settings)[0] for seed in (1, 2))
    assert first.verts.tobytes() == second.verts.tobytes()


def test_a_poisson_surface_does_not_depend_on_the_one_before():
    ball = icosphere(3)
    first, _, again = (screened_poisson(ball.verts, ball.verts, depth, 4.0) for depth in (4, 5, 4))
    assert Topology.of(first).is_watertight
    assert abs(np.linalg.norm(first.verts, axis=1) - 1).max() < 0.1
    assert again.verts.tobytes() == first.verts.tobytes()


def test_a_tool_whose_package_is_missing_says_how_to_install_it(monkeypatch):
    def find_spec(name, *rest, find=importlib.util.find_spec):
        return None if name == "pycpd" else find(name, *rest)

    monkeypatch.setattr("meshfit.fitting.external.tools.find_spec", find_spec)
    settings = ExternalSettings(tool="pycpd")
    assert missing_tool(settings) == "fit.tool: pycpd needs pycpd: pip install 'meshfit[peers]'"
    with pytest.raises(ToolError, match=r"pycpd needs pycpd, which is not installed here: pip install 'meshfit\[peers"):
        run_external(Problem(icosphere(1), squashed()), settings)
