"""Both commands that fit, with the Gauss–Newton engine."""

import pytest

from tests.cli.processes import contents, meshfit
from tests.small import config_file

CONFIG = """\
targets: [ellipsoid.ply]
schemes: [loop]
seeds: [0]
source: {mesh: octahedron, levels: 2, radius: 0.3, project: sphere}
fit: {method: gauss-newton, verts: 200, levels: 1, coarse_steps: 6, tries: 1, level_steps: 2, last_steps: 1}
measure: {samples: 500, points: 500}
device: cpu
"""


@pytest.mark.slow
def test_run_and_compare_fit_by_gauss_newton_and_print_their_tables(tmp_path):
    config = config_file(tmp_path, CONFIG)
    out, err = meshfit("run", config, folder=tmp_path)
    assert "Hausdorff distance" in out
    assert "[1/1]" in err
    trace = (next((tmp_path / "runs").rglob("trace.csv"))).read_text(encoding="utf-8").splitlines()
    assert trace[0] == "step,distance,verts,matched,fairness,point_weight,held_back"
    assert len(trace) == 1 + 6 + 2 * 2 + 1
    fixed = ("--set", "fit.connectivity=fixed")
    out, err = meshfit("compare", "loop", "interp-loop", "--config", config, *fixed, folder=tmp_path)
    assert "interp-loop" in out
    assert "[2/2]" in err
    assert len(contents(tmp_path / "runs", "result.json")) == 3
