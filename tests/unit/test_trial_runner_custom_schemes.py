"""Trials with user-defined schemes: their identities and their results."""

import pickle

import pytest

from meshfit.config.experiment import non_default_settings
from meshfit.config.loading import load_experiment
from meshfit.config.strict_yaml import dump
from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.report.html.tables import definitions_grid
from meshfit.report.tables.grouping import distinguish_definitions, resolve_scheme
from meshfit.report.tables.table import build_tables
from tests.small import experiment

LOOP = {
    "edge": {"end": "3/8", "opposite": "1/8"},
    "vertex": "5/8 - (3/8 + cos(2*pi/n)/4)^2",
    "boundary": "cubic-bspline",
}
DEFINE = {"mine": LOOP, "softer": {"base": "mine", "alpha": 0.5}, "other": {"base": "sqrt3"}}


def trials(folder, *schemes, **changes):
    return plan([experiment(folder, **{"define": DEFINE, "schemes": list(schemes)} | changes)])


def only(folder, scheme, **changes):
    (trial,) = trials(folder, scheme, **changes)
    return trial


def test_a_trial_holds_the_definitions_that_its_scheme_hangs_on(tmp_path):
    found = {trial.scheme: list(trial.settings.define) for trial in trials(tmp_path, "loop", "mine", "softer", "other")}
    assert found == {"loop": [], "mine": ["mine"], "softer": ["softer", "mine"], "other": ["other"]}
    assert "define" not in only(tmp_path, "loop").plain_settings


def test_other_definitions_change_no_identity_and_its_own_does(tmp_path):
    def identity(scheme, **changes):
        return only(tmp_path, scheme, define=DEFINE | changes).identity

    assert only(tmp_path, "loop").identity == plan([experiment(tmp_path)])[0].identity
    for scheme in ("loop", "mine", "softer"):
        assert identity(scheme) == identity(scheme, other={"base": "loop"}, more={"base": "loop"})
    assert identity("mine") == identity("mine", softer={"base": "loop"})
    warren = LOOP | {"vertex": {"3": "9/16", "else": "3/8"}}
    assert identity("mine") != identity("mine", mine=warren)
    assert identity("softer") != identity("softer", mine=warren)
    assert identity("softer") != identity("softer", softer={"base": "mine", "alpha": 0.25})
    assert identity("softer") != identity("softer:alpha=0.25")
    assert len({identity(scheme) for scheme in ("loop", "mine", "softer", "softer:alpha=0.25", "other")}) == 5


def test_trials_travel_to_workers(tmp_path):
    trial = only(tmp_path, "softer:alpha=0.25")
    again = pickle.loads(pickle.dumps(trial))
    assert again == trial
    assert again.identity == trial.identity
    assert again.named_scheme.resolve().alpha == 0.25


@pytest.mark.usefixtures("fewer_target_points")
@pytest.mark.parametrize(
    "fit",
    [
        {},
        {
            "method": "gauss-newton",
            "connectivity": "fixed",
            "verts": 100,
            "coarse_steps": 2,
            "level_steps": 1,
            "last_steps": 1,
        },
    ],
)
def test_a_scheme_that_is_declared_as_loop_is_fits_as_loop_does(tmp_path, fit):
    ours, theirs = trials(tmp_path, "mine", "loop", fit=fit)
    store = RunDirectory(tmp_path / "runs")
    assert [outcome.status for outcome in run_batch([ours, theirs], store, lambda *_: None)] == [
        TrialStatus.COMPLETE
    ] * 2
    files = [(store.folder(trial) / "result.ply").read_bytes() for trial in (ours, theirs)]
    assert files[0] == files[1]
    assert ours.identity != theirs.identity
    (again,) = plan([load_experiment(str(store.folder(ours) / "config.yaml"))])
    assert again.identity == ours.identity
    assert store.result(ours)["settings"]["define"] == ours.plain_settings["define"]
    assert set(non_default_settings(ours.plain_settings)) >= {"define", "schemes"}


def test_a_definition_can_be_swept(tmp_path):
    sweep = {"define.softer.alpha": [0.25, 0.5]}
    found = trials(tmp_path, "loop", "softer", sweep=sweep)
    assert [(trial.scheme, trial.variant) for trial in found] == [
        ("loop", "alpha=0.25"),
        ("softer", "alpha=0.25"),
        ("softer", "alpha=0.5"),
    ]
    assert [trial.named_scheme.resolve().alpha for trial in found[1:]] == [0.25, 0.5]


def result(trial, value):
    names = {"experiment": "small", "identity": trial.identity, "schema_version": 2, "inputs": {}}
    return names | trial.names | {"settings": trial.plain_settings, "hausdorff": {"symmetric": value}}


def test_a_definition_goes_with_its_scheme_and_not_with_the_settings(tmp_path):
    found = trials(tmp_path, "loop", "mine", "softer", seeds=[0, 1, 2])
    results = distinguish_definitions([result(trial, 1 + trial.seed / 9) for trial in found])
    (table,) = build_tables(results, baseline="softer:alpha=0.5")
    assert table.schemes == ("loop", "mine", "softer")
    assert (table.variations[0].baseline, len(table.comparisons)) == ("softer", 2)


def test_definitions_of_one_name_are_told_apart(tmp_path):
    old = trials(tmp_path, "loop", "mine", "softer")
    new = trials(tmp_path, "loop", "mine", "softer", define=DEFINE | {"mine": LOOP | {"vertex": "3/8"}})
    results = distinguish_definitions([result(trial, place) for place, trial in enumerate([*old, *new[1:]])])
    (table,) = build_tables(results, baseline="mine [vertex=3/8]")
    loop = LOOP["vertex"]
    assert set(table.schemes) == {
        "loop",
        *(f"{name} [vertex={vertex}]" for name in ("mine", "softer") for vertex in ("3/8", loop)),
    }
    assert distinguish_definitions(results) == results


def test_the_page_says_what_own_schemes_are(tmp_path):
    spokes = {"4": ["3/8", 0, "-1/8", 0], "else": "1/n"}
    define = DEFINE | {"mine": LOOP | {"spokes": spokes}}
    results = [result(trial, 1.0) for trial in trials(tmp_path, "loop", "mine", "softer", define=define)]
    mine, softer = definitions_grid(results).rows
    assert mine[0] == "mine"
    assert "spokes.4: [3/8, 0, -1/8, 0]; spokes.else: 1/n; edge.end: 3/8; edge.opposite: 1/8" in mine[1]
    assert softer[0] == "softer"
    assert softer[1].startswith("base: mine; alpha: 0.5; mine.split: quadrisect; mine.vertex: 5/8 - (3/8 + cos")


def test_a_baseline_may_be_named_by_its_file(tmp_path):
    results = [result(trial, 1.0) for trial in trials(tmp_path, "softer:alpha=0.25")]
    assert resolve_scheme(results, "own/softer.yaml:alpha=0.250") == "softer:alpha=0.25"
    assert resolve_scheme(results, "interp-loop:alpha=1") == "interp-loop"


def test_what_is_written_is_read_back(tmp_path):
    trial = only(tmp_path, "softer")
    (tmp_path / "again.yaml").write_text(dump(trial.plain_settings))
    assert load_experiment(str(tmp_path / "again.yaml")).settings.define == trial.settings.define
