"""The check of a reproduction can fail: even a small error in one weight of a mask is detected."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from meshfit.experiment.running.backends import Remote
from meshfit.experiment.running.scheduler import run_trials
from meshfit.experiment.storage.result import read_results
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.paths import bundled_folder
from meshfit.report.tables.expected import check, read_expected
from meshfit.report.tables.table import build_tables
from meshfit.subdivision.registry import SCHEMES
from meshfit.subdivision.triangles.scheme import EdgeMask
from tests.inline import Inline

EXPECTED = read_expected(bundled_folder("configs") / "expected" / "reproduce.json")


def deviations(folder: Path, *overrides: str) -> set[str]:
    """Metrics of loop on the bunny that are not as expected, after the fits that the expected numbers are of."""
    trials = plan([load_experiment("reproduce", ["targets=[bunny]", "schemes=[loop]", *overrides])])
    run_trials(trials, RunDirectory(folder), remote=Remote(Inline()))
    results = read_results([folder])
    tables = [table for wanted in EXPECTED.tables for table in build_tables(results, wanted.metric)]
    found = check(tables, EXPECTED)
    return {one.metric for one in found if (one.target, one.scheme) == ("bunny", "loop")}


def edge_mask(end: str):
    entry = SCHEMES["loop"]
    mask = EdgeMask(Fraction(end), opposite=Fraction(1, 2) - Fraction(end))
    return replace(entry, declare=lambda weights: replace(entry.declare(weights), inserted=mask))


@pytest.mark.slow
def test_the_scheme_as_it_should_be_passes(tmp_path):
    assert deviations(tmp_path) == set()


@pytest.mark.slow
@pytest.mark.parametrize(("end", "at_least"), [("0.3751", {"source.area"}), ("1/2", {"source.area", "distance.mean"})])
def test_a_changed_weight_turns_the_check_red(tmp_path, monkeypatch, end, at_least):
    monkeypatch.setitem(SCHEMES, "loop", edge_mask(end))
    assert deviations(tmp_path) >= at_least
