"""The schedule of a Gauss–Newton fit, and errors about its settings."""

from itertools import pairwise, product

import pytest

from meshfit.config.loading import load_experiment
from meshfit.errors import ConfigError
from meshfit.fitting.gauss_newton.schedule import schedule, stage_at
from meshfit.fitting.settings import FirstOrderSettings, GaussNewtonSettings
from meshfit.mesh.solids import cube, icosahedron
from meshfit.settings import build
from tests.fits import fit
from tests.loops import over

COUNTS = {
    "connectivity": ("remeshed", "fixed"),
    "variables": ("verts", "control"),
    "levels": (0, 1, 3),
    "coarse_steps": (0, 1, 5, 17, 40),
    "level_steps": (1, 2, 6),
    "last_steps": (0, 4),
    "tries": (1, 3),
    "decimate_from": (1.0, 2.4),
}
PLANS = [
    build(GaussNewtonSettings, dict(zip(COUNTS, values, strict=True)))
    for values in product(*COUNTS.values())
    if sum(values[3:6]) > 0 and (values[-1] > 1 or values[0] == "remeshed")
]
FAIRNESS = [(0.1, 0.02), (0.1, 0.09), (20.0, 5.0), (1e-6, 1e-9)]


def test_stages_have_as_many_steps_as_settings_say():
    for settings in PLANS:
        assert sum(len(stage.weights) for stage in schedule(settings)) == settings.steps, settings


@pytest.mark.parametrize(("fairness", "last"), FAIRNESS)
def test_within_a_stage_weights_fall_to_no_less_than_their_limits(fairness, last):
    for settings in PLANS:
        changed = settings.model_copy(update={"fairness": fairness, "last_fairness": last})
        for stage in schedule(changed):
            soft, near = zip(*stage.weights, strict=True) if stage.weights else ((), ())
            least = last if stage.name in {"fine", "last", "control mesh"} else fairness
            assert all(value >= least for value in soft)
            assert all(0.01 <= value <= 0.5 for value in near)
            parts = [soft, near]
            if stage.name == "control mesh":
                start = settings.level_steps
                parts = [part[at] for part in parts for at in (slice(start), slice(start, None))]
            assert all(a >= b for part in parts for a, b in pairwise(part))


def test_the_rough_shape_gets_softer_from_part_to_part():
    for settings in PLANS:
        for attempt in range(settings.tries):
            coarse = [w for stage in schedule(settings) if stage.attempt == attempt for w in stage.weights]
            assert len(coarse) == settings.coarse_steps
            assert all(a[0] >= b[0] and a[1] >= b[1] for a, b in pairwise(coarse))


def test_every_search_for_the_rough_shape_starts_from_the_source():
    for settings in PLANS:
        tries = [stage for stage in schedule(settings) if stage.name == "rough shape"]
        starts = [stage.attempt for stage in tries if stage.change == "start"]
        assert starts == (list(range(settings.tries)) if settings.coarse_steps else [])
        assert all(stage.attempt is None for stage in schedule(settings) if stage.name != "rough shape")


@pytest.mark.parametrize(("near", "usual"), [(False, (0.2, 0.1, 0.02)), (True, (0.05, 0.02, 0.005))])
@pytest.mark.parametrize("given", [{}, {"start_fairness": 0.3, "fairness": 0.15, "last_fairness": 0.03}])
def test_long_stages_fall_from_the_fairness_that_is_set_or_usual(near, usual, given):
    settings = GaussNewtonSettings(coarse_steps=40, level_steps=20, last_steps=20, levels=2, **given)
    start, level, last = given.values() or usual
    *levels, fine, end = schedule(settings, near=near)[-5:]
    last = min(last, 0.005) if not given else last  # a surface that is decimated has little to lose either
    for stage in levels:
        assert (stage.weights[0][0], stage.weights[-1][0]) == (start, level)
    assert (fine.weights[-1][0], end.weights[-1][0]) == (last, last)


def test_later_searches_for_the_rough_shape_have_no_fewer_verts():
    plan = schedule(GaussNewtonSettings(tries=5))
    shares = [{stage.share for stage in plan if stage.attempt == attempt} for attempt in range(5)]
    assert all(len(share) == 1 for share in shares)
    assert [max(share) for share in shares] == sorted(max(share) for share in shares)
    assert max(shares[1]) > max(shares[0])


def test_levels_come_in_order_and_refine_as_often_as_is_asked_for():
    for settings in PLANS:
        plan = schedule(settings)
        names = [stage.name for stage in plan if stage.name.startswith("level")]
        refined = 0 if settings.variables == "control" else settings.levels
        assert names == [f"level {k}" for k in range(refined + 1)]
        assert sum(stage.change == "refine" for stage in plan) == refined
        assert sum(stage.change == "control" for stage in plan) == (settings.variables == "control")


def test_the_connectivity_of_a_fixed_fit_is_remeshed_only_before_the_source_is_placed():
    for settings in PLANS:
        changes = [stage.change for stage in schedule(settings)]
        if settings.connectivity == "fixed":
            assert changes.count("place") == 1
            assert "remesh" not in changes[changes.index("place") :]
        else:
            assert "place" not in changes


def test_a_remeshed_surface_is_finest_before_it_is_decimated_if_there_are_steps_for_both():
    for settings in PLANS:
        names = [stage.name for stage in schedule(settings)]
        decimated = settings.connectivity == "remeshed" and settings.variables == "verts" and settings.last_steps > 1
        assert ("fine" in names) == (decimated and settings.decimate_from > 1)
        changes = [stage.change for stage in schedule(settings)]
        assert changes.count("decimate") == names.count("fine")
    many = GaussNewtonSettings(verts=100_000)
    assert "fine" not in [stage.name for stage in schedule(many)]


def test_the_stage_is_known_at_every_step_and_at_both_ends():
    for settings in PLANS[::7]:
        named = [stage.name for stage in schedule(settings) for _ in stage.weights]
        assert [stage_at(settings, done).name for done in range(settings.steps)] == named
        assert stage_at(settings, settings.steps).name == named[-1]
    settings = GaussNewtonSettings()
    assert stage_at(settings, 0).name == "rough shape"
    assert stage_at(settings, settings.tries * 40 - 1).name == "rough shape"
    assert stage_at(settings, settings.tries * 40).name == "level 0"
    assert stage_at(settings, settings.steps - 1).name == "last"


SAID = [
    ({"method": "gauss-newton", "steps": 5}, "steps: no such key: "),
    ({"method": "gauss-newton", "losses": {"edge": 1}}, "losses: no such key: "),
    ({"method": "gauss-newton", "vrts": 500}, "vrts: no such key: did you mean 'verts'? allowed: method, connectivity"),
    ({"method": "gauss-newton", "verts": 50}, "verts: expected a number of 100 or more, got 50"),
    ({"method": "gauss-newton", "levels": 6}, "levels: expected a number of 5 or less, got 6"),
    ({"method": "gauss-newton", "level_steps": -1}, "level_steps: expected a number of 1 or more, got -1"),
    ({"method": "gauss-newton", "fairness": 0}, "fairness: expected a number above 0, got 0"),
    (
        {"method": "gauss-newton", "connectivity": "fixd"},
        "connectivity: got \"fixd\"; did you mean 'fixed'? allowed: remeshed, fixed",
    ),
    ({"verts": 500}, "verts: no such key: "),
    ({"method": "first-order", "coarse_steps": 5}, "coarse_steps: no such key: "),
    (
        {"method": "gaus-newton"},
        "method: got \"gaus-newton\"; did you mean 'gauss-newton'? allowed: first-order, gauss-newton",
    ),
]
EACH = over(("changes", "expected"), SAID)


def assert_said(message, changes, expected):
    assert message.startswith(expected)
    assert "\n" not in message
    if "no such key" in expected:
        model = GaussNewtonSettings if changes.get("method") == "gauss-newton" else FirstOrderSettings
        assert message.endswith("allowed: " + ", ".join(model.model_fields))


@EACH
def test_what_is_said_to_callers(changes, expected):
    with pytest.raises(ConfigError) as caught:
        fit(icosahedron(), cube(), device="cpu", **changes)
    assert_said(str(caught.value), changes, expected)


@EACH
def test_what_is_said_of_configs_names_the_line_and_the_whole_key(tmp_path, changes, expected):
    path = tmp_path / "c.yaml"
    lines = [f"  {key}: {value}" for key, value in changes.items()]
    path.write_text("\n".join(["targets: [cow]", "fit:", *lines, ""]), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_experiment(str(path))
    where = f"{path}, line {2 + len(lines)}: fit."
    assert str(caught.value).startswith(where)
    assert_said(str(caught.value).removeprefix(where), changes, expected)


def test_what_is_written_without_a_method_is_first_order():
    assert fit(icosahedron(), cube(), steps=0, device="cpu").trace.columns[1] == "loss"
    with pytest.raises(ConfigError, match=r"^connectivity: no such key: "):
        fit(icosahedron(), cube(), connectivity="fixed", device="cpu")


def test_settings_of_the_one_method_do_not_hinder_the_other():
    """Overrides that change the method leave behind what was set for the one before."""
    result = fit(icosahedron(), cube(), GaussNewtonSettings(), method="first-order", steps=0, device="cpu")
    assert result.trace.columns[1] == "loss"
