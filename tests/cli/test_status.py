"""`meshfit status` and `meshfit show` of hand-written run directories, with trials in every state."""

import json
import re
import shutil
from datetime import UTC, datetime, timedelta
from unittest import mock

import pytest

from meshfit.cli.status import MOST_LISTED
from tests.cli import answered
from tests.runs import begun, complete, failed, held, place, write_plan, write_progress


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A run directory with an experiment of 240 trials in every state, of which three are to run."""
    runs, schemes = tmp_path_factory.mktemp("template") / "runs", ("loop", "interp-loop:alpha=0.5")
    names = [
        {"target": t, "scheme": s, "seed": i} for t in ("bunny", "cow", "mousehead") for s in schemes for i in range(40)
    ]
    write_plan(runs / "table1", names, workers=4)
    for number, name in enumerate(names):
        if number % 10 < 4:
            complete(runs, experiment="table1", **name)
        elif number % 10 == 4:
            said = (
                {"kind": "out-of-memory", "step": None, "message": "not enough memory " * 9} if number % 50 == 4 else {}
            )
            failed(runs, experiment="table1", **name, **said)
        elif number % 80 == 5:
            write_progress(
                begun(runs, experiment="table1", **name), now=datetime.now(UTC), silent=300 if number < 9 else 1
            )
    return runs


@pytest.fixture
def many(template, tmp_path, monkeypatch):
    """A copy of that run directory in which the three trials run."""
    monkeypatch.chdir(tmp_path)
    runs = shutil.copytree(template, tmp_path / "runs")
    with held(*(path.parent for path in runs.rglob("checkpoint.pt"))):
        yield runs


def at_80_columns(*arguments):
    with mock.patch("tests.cli.WIDTH", 80):
        return answered(*arguments)


def test_status_fits_80_columns_whatever_there_is(many):
    out = at_80_columns("status")
    assert all(len(line) <= 80 for line in out.splitlines() if "/" not in line)
    first = out.splitlines()[0]
    assert first == "table1  96 complete · 3 running · 24 failed · 117 waiting  about 5 min left"
    assert len(out.splitlines()) < 75
    assert re.search(
        r"bunny · loop · seed 5 +500/2,000 +0\.0123 +7 min +node7:4711 *\n +no sign of life for 5 min", out
    )
    assert out.count("no sign of life") == 1
    assert out.count("the fit diverged at step 7") == 1
    assert "failed: diverged (19)" in out
    assert "failed: out-of-memory (5)" in out


def test_a_long_name_of_a_machine_leaves_room_for_the_rest(tmp_path):
    for seed, silent in ((0, 1), (1, 300)):
        folder = begun(tmp_path, seed=seed, target="mousehead", scheme="interp-loop:alpha=0.5")
        write_progress(
            folder, now=datetime.now(UTC), silent=silent, host="civil-soccer-xpcqqh.example.org", pid=1234567
        )
    with held(*(path.parent for path in tmp_path.rglob("checkpoint.pt"))):
        out = at_80_columns("status", tmp_path)
    assert "    no sign of life for 5 min\n" in re.sub(" +\n", "\n", out)
    assert out.count("civil-socce…:1234567") == 2
    assert all(len(line) <= 80 for line in out.splitlines())


def test_status_lists_some_of_a_kind_and_all_on_demand(many):
    for seed in range(100, 105):
        failed(many, experiment="table1", seed=seed)
    assert "and 4 more; --all lists them" in answered("status")
    out = answered("status", "--all")
    assert "more" not in out
    assert len(re.findall(r"^ +.* · seed \d+, step 7$", out, re.MULTILINE)) == 24 > MOST_LISTED


def test_status_as_json_holds_every_trial(many):
    (experiment,) = json.loads(answered("status", "--json"))
    counts = {"complete": 96, "running": 3, "failed": 24, "damaged": 0, "interrupted": 0, "waiting": 117}
    assert experiment["counts"] == counts
    assert len(experiment["trials"]) == 240
    assert experiment["workers"] == 4
    assert experiment["seconds_left"] == pytest.approx((117 * 11 + 3 * (7.5 + 1)) / 4)
    running = [trial for trial in experiment["trials"] if trial["state"] == "running"]
    assert {trial["progress"]["pid"] for trial in running} == {4711}


def test_status_tells_several_experiments_apart(many):
    complete(many, experiment="a-longer-name")
    begun(many, experiment="b", seed=1)
    out = answered("status", "runs")
    assert re.search(r"^a-longer-name  1 complete\nb              1 interrupted  stopped, time left unknown\n", out)
    assert re.search(r"^table1         96 complete", out, re.MULTILINE)


def test_a_trial_that_has_said_nothing_yet_is_starting(tmp_path):
    folder = begun(tmp_path)
    with held(folder):
        assert re.search(r"bunny · loop · seed 0 +starting", answered("status", tmp_path))
    assert "1 interrupted  stopped" in answered("status", tmp_path)


def test_a_running_trial_shows_where_it_is(tmp_path):
    folder = begun(tmp_path)
    write_progress(folder, now=datetime.now(UTC) + timedelta(seconds=2), phase="measuring", loss=None, host="a" * 40)
    with held(folder):
        out = answered("status", tmp_path)
        assert re.search(r"measuring +100 s|measuring +2 min", out)
        assert f"{'a' * 11}…:4711" in out
        shown = answered("show", folder)
    assert "running" in shown.splitlines()[0]
    assert re.search(r"at +measuring, step 500 of 2,000", shown)
    assert re.search(rf"runs on +{'a' * 40}, process 4711", shown)


def test_show_a_trial_that_waits(tmp_path):
    write_plan(tmp_path / "small", [{"seed": 3}])
    out = answered("show", place(seed=3).name.rpartition("-")[2], "--runs", tmp_path)
    assert out.startswith("bunny · loop · seed 3  waiting\n")
    assert "files" not in out


def test_show_names_half_written_files_and_warnings(tmp_path):
    folder = complete(tmp_path, seed=1)
    (folder / ".trace.csv.abcd1234").write_text("half")
    out = answered("show", folder)
    assert re.search(r"\.trace\.csv\.abcd1234 +4 B +half-written", out)
    assert re.search(r"warning +one, of", out)


def test_names_that_look_like_markup_are_printed_as_they_are(tmp_path):
    failed(tmp_path, target="[red]odd[red]", message="[bold]it[/] failed", experiment="[x]")
    out = answered("status", tmp_path)
    for text in ("[x]", "[red]odd[red] · loop", "[bold]it[/] failed"):
        assert text in out


def test_a_damaged_record_of_a_failure_is_told_where_it_is(tmp_path):
    (failed(tmp_path) / "failure.json").write_text("{")
    assert "failed: unreadable (1)" in answered("status", tmp_path)
    assert "failure.json: not valid JSON" in answered("show", next(tmp_path.rglob("failure.json")))


def test_run_directories_are_given_as_arguments_or_by_the_option(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    complete(tmp_path / "runs", experiment="a")
    complete(tmp_path / "elsewhere", experiment="b")
    for command in (["status"], ["table", "--format", "csv"]):
        by_argument = answered(*command, "elsewhere")
        assert answered(*command, "--runs", "elsewhere") == by_argument
        assert answered(*command, "runs") == answered(*command) != by_argument
