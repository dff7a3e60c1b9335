"""Output that goes to other programs: closed pipes, control characters, and cells that a spreadsheet would run."""

import csv
import io
import json
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from meshfit.cli.completions import limits, listed_measured, listed_metrics
from meshfit.errors import ConfigError
from meshfit.measuring.metrics import METRICS, metric_named
from meshfit.printable import csv_cell, printable, printable_html, printable_json, require_printable
from meshfit.report.figures.layout import write_drawing
from meshfit.report.html.environment import template_environment
from meshfit.report.tables.formats.latex import escape as to_latex
from meshfit.report.tables.formats.markdown import escape as to_markdown
from tests.cli import answered, invoke, refused
from tests.cli.processes import ENVIRONMENT
from tests.loops import over
from tests.runs import complete

ESCAPE = "\x1b[31mred\x9b0m\u202e"


@over("arguments", [["schemes"], ["--help"], ["schema"]])
def test_a_pipe_that_is_closed_is_no_failure(arguments):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "meshfit", *arguments]
    done = subprocess.run(command, env=ENVIRONMENT, stdout=write, stderr=subprocess.PIPE, check=False, timeout=60)
    os.close(write)
    assert (done.returncode, done.stderr.decode()) == (0, "")


def test_a_run_goes_on_when_nobody_reads_its_progress(tmp_path):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "meshfit", "measure", "missing.ply", "bone", "-t", "bone", "--csv", "-"]
    command += ["--samples", "500", "--metric", "hausdorff"]
    done = subprocess.run(
        command, cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=write, check=False, timeout=60
    )
    os.close(write)
    rows = done.stdout.decode().splitlines()
    assert (done.returncode, rows[0]) == (1, "result,hausdorff.symmetric,error")
    assert [row.partition(",")[0] for row in rows[1:]] == ["missing.ply", "bone"]


def renamed(runs, **names):
    path = next(runs.glob("*/*/*/seed-0-*/result.json"))
    path.write_text(json.dumps(json.loads(path.read_text()) | names))


def test_names_from_files_are_printed_without_control_characters(tmp_path):
    """A run directory may come from elsewhere, and a terminal would obey what is in its names."""
    for scheme in ("loop", "interp-loop"):
        complete(tmp_path / "runs", scheme=scheme)
    renamed(tmp_path / "runs", target_title=f"the {ESCAPE}", experiment=f"small{ESCAPE}", variant=ESCAPE)
    outputs = [answered("table", tmp_path / "runs", "--format", name) for name in ("rich", "md", "csv", "latex")]
    answered("export", tmp_path / "runs", "-o", tmp_path / "all.csv")
    for text in (*outputs, (tmp_path / "all.csv").read_text(encoding="utf-8")):
        assert not set(text) & set("\x1b\x9b\u202e")
        assert "[31mred" in text.replace("{[}", "[").replace("\\[", "[")
    assert "\x1b" not in answered("table", tmp_path / "runs", "--format", "json")


def test_names_with_control_characters_are_refused(tmp_path):
    config = tmp_path / "my.yaml"
    config.write_text('targets: [bone]\nschemes: [loop]\nsweep: {variants: {"a\\eb": {fit.steps: 1}}}\n')
    message = refused("run", config, "--dry-run")
    assert message.endswith(r"variant 'a\x1bb' has control or invisible characters; remove them")
    config.write_text("targets: [bone]\nschemes: [loop]\n")
    config.rename(tmp_path / "a\x1bb.yaml")
    assert refused("run", tmp_path / "a\x1bb.yaml", "--dry-run") == (
        r"error: experiment 'a\x1bb' has control or invisible characters; rename its config, or give --name"
    )
    require_printable("Lochmüller – ∂Ω ✓", "label")
    with pytest.raises(ConfigError, match=r"label 'a\\nb' has control or invisible characters"):
        require_printable("a\nb", "label")


def test_text_is_printable_and_stays_as_it_is_where_it_was():
    assert printable("a\tb\n", keep="\n\t") == "a\tb\n"
    assert printable("a\tb\n") == r"a\tb\n"
    assert printable("\u2028\x7f\u202e") == r"\u2028\x7f\u202e"
    for text in ("plain", "Lochmüller", "日本語", "e\u0301", "a\u00a0b", "🐄", "👩\u200d🚀", "می\u200cخواهم"):
        assert printable(text) == text


MARKS = "\u200b\u200c\u200d\u200e\u200f\u061c\u2028\u2029\u202a\u202e\u2060\u2066\u2069\ufeff\u00ad\U000e0041"


@pytest.mark.parametrize("way", [printable, printable_html, csv_cell, printable_json, to_latex, to_markdown])
def test_invisible_marks_are_escapes_on_each_way_out(way):
    """They would hide a part of a name, turn it round, or make two names look the same."""
    written = way(f"a{MARKS}b")
    assert not set(written) & set(MARKS)
    assert ("u200b" in written, "ufeff" in written) == (True, True)
    with pytest.raises(ConfigError, match=r"name 'a\\u200bb' has control or invisible characters"):
        require_printable("a\u200bb", "name")


def test_names_keep_their_characters_in_latex_and_markdown():
    assert to_latex(r"a_b&c%d#e$f{g}h~i^j\k`") == (
        r"a\_b\&c\%d\#e\$f\{g\}h\textasciitilde{}i\textasciicircum{}j\textbackslash{}k\textasciigrave{}"
    )
    assert to_markdown("a|b`c<d&lt;$e$") == r"a\|b\`c\<d\&lt;\$e\$"


def test_cells_that_a_spreadsheet_would_run_begin_with_an_apostrophe():
    for text in ("=1+1", "+A1", "-A1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "\uff1d1", '=HYPERLINK("x")'):
        assert csv_cell(text).startswith("'")
    for value, cell in (
        (-0.5, "-0.5"),
        ("-0.5", "-0.5"),
        ("+1e-3", "+1e-3"),
        (True, "true"),
        (None, ""),
        ("a=b", "a=b"),
    ):
        assert csv_cell(value) == cell


def test_tables_and_exports_quote_such_cells(tmp_path):
    complete(tmp_path / "runs")
    renamed(tmp_path / "runs", target_title="=cmd|' /C calc'!A0")
    answered("export", tmp_path / "runs", "-o", tmp_path / "all.csv")
    table = answered("table", tmp_path / "runs", "--format", "csv")
    for text in (table, (tmp_path / "all.csv").read_text(encoding="utf-8")):
        rows = list(csv.DictReader(io.StringIO(text)))
        assert rows[0]["target_title"] == "'=cmd|' /C calc'!A0"


def test_metrics_are_given_one_by_one_or_in_a_list(tmp_path):
    complete(tmp_path / "runs")
    table = ("table", tmp_path / "runs", "--format", "csv")
    listed = answered(*table, "--metric", "hausdorff, distance.rms,", "--metric", "f_score")
    single = ("--metric", "hausdorff.symmetric", "--metric", "distance.rms", "--metric", "f_score.f1")
    assert listed == answered(*table, *single)
    assert "'size' is not a metric: " in refused(*table, "--metric", "hausdorff,size")
    answered("expect", tmp_path / "runs", "-o", tmp_path / "expected.json", "--metric", "hausdorff,edges")
    expected = json.loads((tmp_path / "expected.json").read_text())
    assert [table["metric"] for table in expected["tables"]] == ["hausdorff.symmetric", "edges.f1"]
    message = refused("chart", tmp_path / "runs", "-o", tmp_path / "x.pdf", "--metric", "hausdorff,edges")
    assert message == "error: --metric hausdorff,edges: expected one metric here, got several"


def test_time_and_memory_are_metrics_and_settings_are_not(tmp_path):
    for scheme, seconds in (("loop", 10.0), ("interp-loop", 20.0)):
        complete(tmp_path / "runs", scheme=scheme, fit_seconds=seconds)
    out = answered("table", tmp_path / "runs", "--metric", "seconds.fit,seconds.measure,peak_memory_mb")
    for text in ("fitting time (s)", "measuring time (s)", "peak memory (MB)"):
        assert text in " ".join(out.split()).lower().replace("(mb)", "(MB)")
    assert "10.00" in out
    message = refused("table", tmp_path / "runs", "--metric", "f_score.tau")
    assert message.startswith("error: 'f_score.tau' is the setting measure.f_score_tau, not a metric: did you mean")


def test_a_value_that_is_missing_is_a_dash(tmp_path):
    folder = complete(tmp_path / "runs")
    result = json.loads((folder / "result.json").read_text())
    result["edges"]["chamfer"] = None
    (folder / "result.json").write_text(json.dumps(result))
    assert "–" in answered("table", tmp_path / "runs", "--metric", "edges.chamfer")
    assert invoke("show", folder).code == 0


def test_completion_offers_metrics_and_no_settings():
    offered = [name for name, _ in listed_metrics("hausdorff.symmetric,")]
    assert offered == [f"hausdorff.symmetric,{name}" for name in METRICS]
    assert not {"hausdorff.samples", "chamfer.points", "f_score.tau"} & METRICS.keys()
    assert [name for name, _ in listed_measured("a,seconds")] == []
    assert [name for name, _ in limits("hausdorff.s")] == ["hausdorff.symmetric="]
    assert {metric_named(name.partition(".")[0]) for name in METRICS} > {"hausdorff.symmetric", "edges.f1"}


@given(
    st.recursive(
        st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
    )
)
def test_json_keeps_every_text_and_has_no_control_characters(content):
    text = printable_json(content)
    assert json.loads(text) == content
    assert printable(text, keep="\n") == text


@given(st.text(alphabet=st.sampled_from("a<&\x1b\x07\x9b\u202e\ud800\n é")))
def test_pages_have_no_control_characters(text):
    page = template_environment().from_string("<p title='{{ text }}'>{{ text }}").render(text=text)
    assert printable(page, keep="\n\t") == page
    assert page.count("<") == 1


@pytest.mark.filterwarnings("ignore:Glyph")
def test_drawings_have_no_control_characters(tmp_path):
    figure = Figure()
    figure.text(0.5, 0.5, ESCAPE)
    write_drawing(figure, tmp_path / "a.svg", 100)
    drawn = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert printable(drawn, keep="\n\t") == drawn
