import csv
import importlib
import json

import pyarrow.csv
import pyarrow.parquet
import pytest

from meshfit.config.experiment import ExperimentSettings
from meshfit.errors import ConfigError, MeshfitWarning, StoreError
from meshfit.experiment.status.results import scan_with_results
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.report.tables.export import HEAD, columns_of, records_of, write_records
from meshfit.report.tables.grouping import flatten
from tests.runs import NOW, begun, complete, failed, write_plan


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    complete(root, seed=0, losses={"edge": 0.1})
    complete(root, seed=1, losses={"edge": 1e-17})
    complete(root, experiment="other", scheme="interp-loop:alpha=0.5", method="gauss-newton")
    failed(root, seed=2, message='it said:\n "no", twice')
    begun(root, seed=3)
    return root


def row_of(runs, seed):
    (row,) = (row for row in records_of(*scan_with_results([runs / "small"], NOW)) if row["seed"] == seed)
    return row


def exported(runs, path):
    rows = records_of(*scan_with_results([runs], NOW))
    write_records(rows, columns_of(rows), path)
    return rows, columns_of(rows)


def read_csv(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_holds_every_metric_every_setting_and_what_else_the_result_says(runs):
    row = row_of(runs, 1)
    result = json.loads((next(runs.glob("small/bunny/loop/seed-1-*")) / "result.json").read_text())
    assert {key: row.get(key) for key in METRICS} == {key: flatten(result).get(key) for key in METRICS}
    for key, value in flatten(result["settings"]).items():
        assert row[key] == (json.dumps(value) if isinstance(value, list) else value)
    assert row["fit.losses.edge"] == 1e-17
    assert row["source.decimate"] is None
    facts = {"experiment": "small", "target": "bunny", "target_title": "the bunny", "scheme": "loop", "seed": 1}
    assert facts.items() <= row.items()
    assert (row["state"], row["variant"], row["identity"]) == ("complete", "", result["identity"])
    assert (row["seconds.fit"], row["peak_memory_mb"], row["frame.scale"]) == (10.0, 400.5, 0.5)
    assert (row["versions.python"], row["platform.system"], row["inputs.target"]) == (
        "3.11.7",
        "Linux",
        NAMED_TARGETS["bunny"].sha256,
    )


def test_failed_trials_have_their_settings_and_why_and_no_metrics(runs):
    row = row_of(runs, 2)
    assert (row["state"], row["seed"], row["failure.kind"], row["failure.step"]) == ("failed", 2, "diverged", 7)
    assert (row["fit.steps"], row["source.levels"], row["scheme"]) == (2000, 4, "loop")
    assert not set(METRICS) & set(row)


def test_what_a_failure_says_of_its_trial_counts(runs):
    path = next(runs.glob("small/*/*/seed-2-*/failure.json"))
    says = {"target": "my.scan", "target_title": "my scan", "scheme": "loop:weights=warren", "variant": "stiff"}
    path.write_text(json.dumps(json.loads(path.read_text()) | says))
    assert says.items() <= row_of(runs, 2).items()


def test_columns_come_in_one_order_whichever_rows_there_are(runs):
    rows = sorted(records_of(*scan_with_results([runs], NOW)), key=lambda row: row["experiment"], reverse=True)
    every = columns_of(rows)
    assert len(set(every)) == len(every)
    assert tuple(every[: len(HEAD) + len(METRICS)]) == (*HEAD, *METRICS)
    for some in (rows[:1], rows[2:3], rows[3:], rows[::-1]):
        found = columns_of(some)
        assert found == [column for column in every if column in found]
    settings = flatten(ExperimentSettings().model_dump(mode="json", exclude={"jobs", "threads", "view"}))
    settings = {
        key: value
        for key, value in settings.items()
        if key not in ("source.creases", "source.alpha", "source.wanted_verts", "source.wrap")
    }
    assert [column for column in columns_of(rows[:1]) if column in settings] == list(settings)
    assert {"fit.connectivity", "fit.optimizer.lr"} <= set(every)
    assert every[-5:] == [f"failure.{key}" for key in ("kind", "message", "step", "attempts", "error")]


def test_csv_gives_back_every_value_to_the_last_digit(runs, tmp_path):
    rows, columns = exported(runs, tmp_path / "out.csv")
    found = read_csv(tmp_path / "out.csv")
    assert list(found[0]) == columns
    for row, texts in zip(rows, found, strict=True):
        for column in columns:
            value, text = row.get(column), texts[column]
            if value is None:
                assert text == ""
            elif isinstance(value, bool):
                assert text == str(value).lower()
            else:
                assert type(value)(text) == value


def test_parquet_gives_back_equal_values_of_the_same_types(runs, tmp_path):
    rows, columns = exported(runs, tmp_path / "out.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    assert table.column_names == columns
    for row, found in zip(rows, table.to_pylist(), strict=True):
        assert found == {column: row.get(column) for column in columns}
        assert all(type(found[column]) is type(row.get(column)) for column in columns)
    types = {field.name: str(field.type) for field in table.schema}
    assert types["hausdorff.symmetric"] == types["fit.losses.edge"] == types["seconds.fit"] == "double"
    assert types["quality.faces"] == types["seed"] == types["fit.steps"] == "int64"
    assert types["quality.watertight"] == types["fit.limit"] == "bool"
    assert types["source.centre"] == types["failure.message"] == "string"


def test_both_formats_say_the_same(runs, tmp_path):
    for name in ("out.csv", "out.parquet"):
        exported(runs, tmp_path / name)
    parquet = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    types = {field.name: field.type for field in parquet.schema}
    options = pyarrow.csv.ConvertOptions(column_types=types, strings_can_be_null=True, null_values=[""])
    parse = pyarrow.csv.ParseOptions(newlines_in_values=True)
    found = pyarrow.csv.read_csv(tmp_path / "out.csv", parse_options=parse, convert_options=options)
    empty_as_null = [{key: value if value != "" else None for key, value in row.items()} for row in parquet.to_pylist()]
    assert found.to_pylist() == empty_as_null


def test_metrics_keep_their_types_where_no_trial_has_any(tmp_path):
    failed(tmp_path / "runs")
    exported(tmp_path / "runs", tmp_path / "out.parquet")
    types = {field.name: str(field.type) for field in pyarrow.parquet.read_schema(tmp_path / "out.parquet")}
    assert (types["hausdorff.symmetric"], types["quality.faces"], types["quality.watertight"]) == (
        "double",
        "int64",
        "bool",
    )


def test_a_whole_number_among_fractions_is_a_fraction(tmp_path):
    rows = [{"fit.new": 1, "seed": 0}, {"fit.new": 0.5, "seed": 1}, {"fit.new": None, "seed": 2}]
    write_records(rows, ["seed", "fit.new"], tmp_path / "out.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "out.parquet")["fit.new"].to_pylist() == [1.0, 0.5, None]


def test_values_of_several_kinds_become_texts(tmp_path):
    rows = [{"new": 1}, {"new": "auto"}, {"new": True}]
    write_records(rows, ["new"], tmp_path / "out.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "out.parquet")["new"].to_pylist() == ["1", "auto", "true"]


def test_planned_facts_fill_in_what_files_do_not_say(runs):
    write_plan(runs / "small", [{"seed": 2, "variant": "stiff"}])
    assert {"variant": "stiff", "target_title": "the bunny"}.items() <= row_of(runs, 2).items()


def test_damaged_files_are_named(runs):
    path = next(runs.glob("small/*/*/seed-2-*/failure.json"))
    path.write_text("{")
    row = row_of(runs, 2)
    assert (row["failure.kind"], row["state"]) == ("unreadable", "failed")
    assert str(path) in row["failure.message"]
    path.with_name("config.yaml").write_text("[")
    with pytest.raises(ConfigError, match=r"config\.yaml: line 1: not valid YAML"):
        records_of(*scan_with_results([runs], NOW))


def test_damaged_results_are_left_out_with_a_warning(runs):
    complete = [record["folder"] for record in records_of(*scan_with_results([runs], NOW))]
    path = next(runs.glob("small/*/*/seed-0-*/result.json"))
    path.write_text("{")
    with pytest.warns(MeshfitWarning, match=r"left out: .*result\.json: not valid JSON"):
        records = records_of(*scan_with_results([runs], NOW))
    assert [record["folder"] for record in records] == [name for name in complete if name != str(path.parent)]


@pytest.mark.parametrize(("name", "found"), [("out.xlsx", "'.xlsx'"), ("out", "no suffix"), ("out.CSV", "'.CSV'")])
def test_other_suffixes_are_refused(tmp_path, name, found):
    with pytest.raises(ConfigError, match=rf"{name}: {found} is not a known format; allowed: \.csv, \.parquet"):
        write_records([], [], tmp_path / name)


def test_without_pyarrow_the_extra_is_named_and_csv_is_written(runs, tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ConfigError, match=r"pip install 'meshfit\[parquet\]'"):
        write_records([], [], tmp_path / "out.parquet")
    exported(runs, tmp_path / "out.csv")
    assert len(read_csv(tmp_path / "out.csv")) == 4


def test_a_file_is_replaced_as_a_whole(runs, tmp_path):
    (tmp_path / "out.csv").write_text("old")
    exported(runs, tmp_path / "out.csv")
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["out.csv"]
    with pytest.raises(StoreError, match=r"out\.csv: cannot be written"):
        exported(runs, tmp_path / "gone/out.csv")
