"""Tables that account for every planned trial: those without a result, each with its reason, in every format."""

import csv
import io
import json

import pytest

from tests.cli import invoke
from tests.runs import complete, failed, place, write_plan

PLAN = [{"target": target, "seed": seed} for target in ("bunny", "cow") for seed in (0, 1, 2)]


@pytest.fixture
def runs(tmp_path):
    """Two complete trials, and one each that diverged, was killed, has a damaged result, and has not run."""
    root = tmp_path / "runs"
    for seed in (0, 1):
        complete(root, seed=seed)
    failed(root, seed=2)
    failed(root, "killed", "the process that ran it was killed", None, target="cow", seed=0)
    folder = complete(root, target="cow", seed=1)
    (folder / "result.json").write_bytes(b"")
    write_plan(root / "small", PLAN)
    return root


def table(runs, *options):
    return invoke("table", runs, *options)


def test_a_table_counts_and_names_trials_without_a_result(runs):
    code, out, err = table(runs)
    assert code == 1
    assert "Trials: 2 of 6 complete, 1 diverged, 1 killed, 1 damaged, 1 not run" in out
    assert "none complete" in out
    assert "‡ over fewer runs than planned" in out
    flat = " ".join(out.split())
    for text in (
        "Missing, diverged: 1 run, loop on the bunny (seed 2); the fit diverged at step 7; log: ",
        "Missing, killed: 1 run, loop on the cow (seed 0); the process that ran it was killed; log: ",
        "Missing, damaged: 1 run, loop on the cow (seed 1); not valid JSON",
        "Missing, not run: 1 run, loop on the cow (seed 2)",
    ):
        assert text in flat
    assert str(runs / place(seed=2) / "trial.log") in "".join(out.split())
    assert "--partial" in err
    assert table(runs, "--partial")[0] == 0


def test_an_export_counts_the_trials_that_it_leaves_out(runs, tmp_path):
    code, out, _ = invoke("export", runs, "-o", tmp_path / "all.csv")
    assert code == 0
    assert "all.csv: 4 trials" in " ".join(out.split())
    assert "left out, without a result: 1 not run, 1 damaged\n" in out


def test_every_format_accounts_for_them(runs):
    (cell, missing), *_ = [
        (row, row["missing"])
        for row in csv.DictReader(io.StringIO(table(runs, "-f", "csv")[1]))
        if row["target"] == "cow"
    ]
    assert (cell["count"], cell["planned"]) == ("0", "3")
    assert missing == "seed 0: killed; seed 1: damaged; seed 2: not run"
    (content,) = json.loads(table(runs, "-f", "json")[1])["tables"]
    assert content["trials"] == {"planned": 6, "complete": 2, "diverged": 1, "killed": 1, "damaged": 1, "not run": 1}
    assert content["cells"][0]["missing"]["2"]["state"] == "diverged"
    for name, mark in (("latex", r"\ddag"), ("md", "‡")):
        code, out, _ = table(runs, "-f", name, "--notes", "short")
        assert code == 1
        assert mark in out
        assert "Trials: 2 of 6 complete" in out
        assert "Missing, not run" in out


def test_a_failed_point_of_a_sweep_has_a_row_of_its_own(runs):
    path = runs / "small" / "plan.json"
    plan = json.loads(path.read_text(encoding="utf-8"))
    done = json.loads((runs / place() / "result.json").read_text(encoding="utf-8"))
    settings = {key: value for key, value in done["settings"].items() if key not in ("targets", "schemes", "seeds")}
    other = settings | {"fit": settings["fit"] | {"steps": 7}}
    plan["origins"] = [{"schema_version": 2, "settings": each, "inputs": {}} for each in (settings, other)]
    for entry in plan["trials"]:
        entry |= {"origin": 0, "variant": "a", "file": entry["target"], "sha256": done["inputs"]["target"]}
    last = plan["trials"][0] | {"origin": 1, "variant": "seven steps", "folder": "bunny/loop/seed-0-0000000000"}
    path.write_text(json.dumps(plan | {"trials": [*plan["trials"], last]}), encoding="utf-8")
    out = table(runs, "-f", "csv")[1]
    rows = [row for row in csv.DictReader(io.StringIO(out)) if row["variant"] == "seven steps"]
    assert [(row["target"], row["missing"]) for row in rows if row["missing"]] == [("bunny", "seed 0: not run")]
    assert "seven steps" in table(runs, "--partial")[1]


def test_a_table_without_any_complete_trial_says_why(tmp_path):
    failed(tmp_path, seed=0)
    code, out, _ = table(tmp_path)
    assert code == 1
    assert "Trials: 0 of 1 complete, 1 diverged" in out


def test_impossible_numbers_make_a_result_damaged(runs):
    folder = runs / place(seed=1)
    record = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    for group, key, value in (("hausdorff", "symmetric", -0.1), ("f_score", "f1", 1.5), ("quality", "verts", "many")):
        changed = record | {group: record[group] | {key: value}}
        (folder / "result.json").write_text(json.dumps(changed), encoding="utf-8")
        code, out, err = table(runs)
        assert code == 1
        assert "Trials: 1 of 6 complete" in out
        assert f"{group}.{key}" in err
