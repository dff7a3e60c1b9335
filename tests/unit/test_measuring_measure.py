"""The `measure` call: its settings, its JSON, and the table of metrics."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from meshfit.errors import ConfigError, MeasureError
from meshfit.measuring.deviation import deviation
from meshfit.measuring.measure import measure
from meshfit.measuring.metrics import MEASURED, METRICS, require_metric
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.solids import cube, octahedron
from tests.loops import over

FEW = MeasureSettings(samples=1000, points=500)
BESIDE = {"hausdorff.samples", "chamfer.points", "f_score.tau", "edges.reason"}


def flat(measurement):
    """The metrics, and what is beside them, by dotted name."""
    parts = {group: part for group, part in measurement.to_dict().items() if group != "farthest"}
    return {f"{group}.{name}": value for group, part in parts.items() for name, value in part.items()}


def test_the_dict_survives_json_and_holds_plain_values():
    found = measure(octahedron(), cube(), FEW)
    assert json.loads(json.dumps(found.to_dict())) == found.to_dict()
    assert {type(value) for value in flat(found).values()} == {int, float, bool, str}


def test_the_table_names_every_figure_and_can_print_it():
    found = flat(measure(octahedron(), cube(), FEW))
    assert [name for name in found if name not in BESIDE] == list(MEASURED)
    for name, metric in MEASURED.items():
        assert format(found[name], metric.format)
    assert len({metric.title for metric in METRICS.values()}) == len(METRICS)


def test_a_target_that_is_inside_out_is_measured_to_as_its_turned_twin():
    small = octahedron().with_verts(octahedron().verts / 2)
    inverted = Mesh(cube().verts, cube().faces[:, ::-1])
    assert measure(small, inverted, FEW) == measure(small, cube(), FEW)
    assert (deviation(small, inverted).verts == deviation(small, cube()).verts).all()
    assert measure(Mesh(small.verts, small.faces[:, ::-1]), cube(), FEW).normal_consistency.signed < 0


def test_settings_of_a_wrong_type_are_refused():
    for name in ("settings", "samples", "points", "f_score_tau", "crease_angle", "seed"):
        for value in (["a"], np.zeros(3), object(), {"a": 1}):
            with pytest.raises(ConfigError, match=name):
                measure(octahedron(), cube(), **{name: value})


def test_settings_are_no_metrics():
    found = flat(measure(octahedron(), cube(), FEW))
    for name, setting in (
        ("hausdorff.samples", "samples"),
        ("chamfer.points", "points"),
        ("f_score.tau", "f_score_tau"),
    ):
        assert name in found
        with pytest.raises(ConfigError, match=f"'{name}' is the setting measure.{setting}, not a metric"):
            require_metric(name)


def test_the_farthest_points_are_where_the_largest_distances_are():
    spike = cube().verts.copy()
    spike[5] *= 2
    result, target = Mesh(spike, cube().faces), cube()
    found = measure(result, target, FEW)
    for point, largest, own, other in (
        (found.farthest.forward, found.hausdorff.forward, result, target),
        (found.farthest.backward, found.hausdorff.backward, target, result),
    ):
        assert point.distance == largest == pytest.approx(math.dist(point.position, point.nearest), rel=1e-12)
        for position, face, mesh in ((point.position, point.face, own), (point.nearest, point.nearest_face, other)):
            alone = Mesh(mesh.verts, mesh.faces[[face]])
            assert point_distances(alone, np.array([position])) == pytest.approx([0], abs=1e-12)
    assert found.farthest.forward.position == tuple(spike[5])
    assert 5 in result.faces[found.farthest.forward.face]


def test_the_table_cannot_be_changed():
    with pytest.raises(TypeError):
        MEASURED["hausdorff.forward"] = MEASURED["hausdorff.backward"]


def test_a_perfect_result_is_no_worse_than_a_poor_one():
    poor = Mesh(
        np.concatenate([0.5 * cube().verts, 0.4 * cube().verts + 0.2]),
        np.concatenate([cube().faces, octahedron().faces + 8]),
    )
    good, bad = flat(measure(cube(), cube(), FEW)), flat(measure(poor, cube(), FEW))
    for name, metric in MEASURED.items():
        if metric.smaller_is_better is not None:
            assert good[name] <= bad[name] if metric.smaller_is_better else good[name] >= bad[name], name


def test_figures_are_those_asked_for():
    found = measure(octahedron(), cube(), FEW, f_score_tau=0.25)
    assert (found.hausdorff.samples, found.chamfer.points, found.f_score.tau) == (1000, 500, 0.25)
    assert measure(octahedron(), cube(), FEW, f_score_tau="25%").f_score.tau == pytest.approx(0.25 * 2)
    assert measure(octahedron(), cube(), samples=100, points=100).f_score.tau == pytest.approx(0.005 * 2)
    assert found.hausdorff.percent_of_diagonal == pytest.approx(100 * found.hausdorff.symmetric / 2)
    assert (found.quality.verts, found.quality.faces) == (6, 8)


def test_overrides_count_as_settings():
    assert measure(octahedron(), cube(), samples=1000, points=500) == measure(octahedron(), cube(), FEW)
    assert measure(octahedron(), cube(), FEW, seed=3) != measure(octahedron(), cube(), FEW)


@over(
    ("override", "message"),
    [({"sample": 10}, "sample: no such key.*samples"), ({"samples": 5}, "samples: expected .*100.* got 5")],
)
def test_an_override_that_is_not_allowed_is_named(override, message):
    with pytest.raises(ConfigError, match=message) as caught:
        measure(octahedron(), cube(), **override)
    assert "\n" not in str(caught.value)


def test_a_result_with_nan_is_refused_before_meshlab_sees_it():
    verts = cube().verts.copy()
    verts[3, 1] = np.nan
    with pytest.raises(MeasureError, match=r"the result: expected finite coordinates .* at vertex 3"):
        measure(Mesh(verts, cube().faces), cube(), FEW)


@over("module", ["metrics", "settings"])
def test_help_and_configs_load_nothing_heavy(module):
    heavy = "{'torch', 'pymeshlab', 'trimesh', 'scipy', 'pykdtree'}"
    code = f"import sys, meshfit.measuring.{module}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_measuring_needs_no_torch():
    code = "import sys, meshfit.measuring.measure; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
