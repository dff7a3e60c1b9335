"""Every format, read back by a reader of its own kind."""

import csv
import json
import re
import shutil
import statistics
import subprocess
import sys
from io import StringIO

import pytest
from rich.console import Console

from meshfit.errors import ConfigError
from meshfit.measuring.metrics import DEFAULT_METRIC
from meshfit.report.tables.comparison_text import comparison_lines
from meshfit.report.tables.formats import FORMATS
from meshfit.report.tables.formats.data import FIELDS
from meshfit.report.tables.formats.latex import to_latex
from meshfit.report.tables.formats.markdown import to_markdown
from meshfit.report.tables.formats.terminal import TablesView, to_text
from meshfit.report.tables.style import Style, parse_labels
from meshfit.report.tables.table import Row, build_tables, merge_tables, styled
from tests.loops import over
from tests.unit.test_table_model import CLEAR, grid, result


def merged(results, *metrics, **options):
    return merge_tables(build_tables(results, *metrics), **options)


TABLES = merged(grid(CLEAR))
WITH_A_GAP = merged(grid({**CLEAR, ("cow", "loop"): [0.1, 0.2]}))
SCHEMES = ("loop", "interp-loop", "interp-loop:alpha=0.5")
WIDE = merged(grid({(t, s): [0.3, 0.31, 0.35] for t in ("bunny", "mousehead", "cow", "airplane") for s in SCHEMES}))
SWEEP = merged(
    [result for edge in (1.0, 0.1) for result in grid(CLEAR, fit__losses__edge=edge)], DEFAULT_METRIC, "f_score.f1"
)
LOOP_ONLY = {("bunny", "loop"): CLEAR["bunny", "loop"]}
AWKWARD = "a_b%c&d#e{f}[g]|h*i<j>k~l^m$n"


def squeezed(text):
    return re.sub(r"\s+", " ", text)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_says_stand_in_and_gives_both_readings(name):
    text = squeezed(FORMATS[name](TABLES))
    assert "mousehead (stand-in)" in text
    for number in ("0.025621", "0.035352", "0.07518", "0.013013"):
        assert number in text


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_takes_no_tables_and_several(name):
    assert isinstance(FORMATS[name]([]), str)
    two = FORMATS[name](merged(grid(CLEAR) + grid(CLEAR, fit__steps=100)))
    assert "steps=2000" in two.replace("\\", "")
    assert "steps=100" in two.replace("\\", "")


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_a_heading_states_what_the_numbers_are(name):
    text = squeezed(FORMATS[name](TABLES))
    for words in ("Hausdorff distance", "3 seeds", "tutorial frame", "2000 steps", "5000 samples", "icosahedron, 4"):
        assert words in text


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_the_papers_numbers_stand_beside_its_own_metric_only(name):
    assert "paper's bunny" in squeezed(FORMATS[name](TABLES)) or name != "md"
    assert "0.025621" not in FORMATS[name](merged(grid(CLEAR), "hausdorff.forward"))


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_a_missing_cell_is_a_dash_and_fewer_seeds_are_noted(name):
    text = squeezed(FORMATS[name](WITH_A_GAP)).replace("--", "–")
    assert re.search(r"interp-loop .*–", text)
    assert "loop on cow: 2 seeds (0, 1)" in text


@pytest.mark.parametrize("width", [80, 120])
@over("shown", [TABLES, WITH_A_GAP, WIDE], ids=["small", "gap", "wide"])
def test_text_fits_its_width_with_no_cell_broken(width, shown):
    lines = to_text(shown, width).splitlines()
    assert max(map(len, lines)) <= width
    (table,) = shown[0].split()
    for whole in (r"\d\.\d+ \(\d\.\d+\)", r"(?<=  )\[−?\d\.\d+, \d\.\d+\]"):
        assert sum(len(re.findall(whole, line)) for line in lines) == len(table.cells)
    assert not any("…" in line for line in lines)


def test_text_marks_the_best_without_colour():
    lines = [line for line in to_text(TABLES).splitlines() if re.search(r"\) \*", line)]
    assert len(lines) == 1
    assert lines[0].startswith("interp-loop")


def test_text_states_each_difference():
    text = to_text(TABLES)
    assert re.search(
        r"bunny +P\(better\)  needed\n  interp-loop +−0\.1000 \[−0\.\d+, −0\.\d+\]  significant +1\.00 +2", text
    )
    assert re.search(r"over 2 targets\n  interp-loop +−0\.0\d+ \[−0\.\d+, −0\.\d+\] +significant +0\.72 +\d", text)
    assert "not significant" in text
    one = to_text(merged([result(), result(scheme="interp-loop", value=0.1)]))
    assert "−0.1000" in one
    assert "one seed: no interval" in one


def test_differences_of_single_runs_are_summed_up_in_a_line():
    found = [result(target, scheme) for target in ("bunny", "cow") for scheme in ("loop", "interp-loop")]
    assert "one seed only, so no intervals" in to_markdown(merged(found))


def test_colour_is_left_to_the_console(monkeypatch):
    def printed(**options):
        console = Console(file=StringIO(), force_terminal=True, color_system="standard", width=80, **options)
        console.print(TablesView(TABLES))
        return console.file.getvalue()

    green = re.compile(r"\x1b\[[\d;]*32m")
    assert green.search(printed())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not green.search(printed())


def test_names_are_never_taken_for_markup():
    assert to_text(merged([result(value=0.2, experiment="[red]x[/red]")])).startswith("[red]x[/red]\n")


def test_markdown_has_as_many_columns_in_every_row():
    rows = [line for line in to_markdown(WITH_A_GAP).splitlines() if line.startswith("|")]
    assert [len(re.findall(r"(?<!\\)\|", row)) - 1 for row in rows] == [6, 6, 6, 6]
    assert rows[0].split(" | ")[1:3] == ["bunny", "paper's bunny"]
    assert re.search(r"\*\*0\.210 \(0\.211\) \\\[0\.1\d+, 0\.2\d+\\\]\*\*", rows[3])


def test_markdown_escapes_what_would_be_markup():
    text = to_markdown(merged([result(), result(seed=1, experiment="a|b_c*d")]))
    assert r"a\|b\_c\*d" in text


def test_csv_is_tidy():
    rows = list(csv.DictReader(StringIO(FORMATS["csv"](WITH_A_GAP))))
    assert tuple(rows[0]) == FIELDS
    assert [(row["target"], row["scheme"]) for row in rows] == [
        *((target, scheme) for target in ("bunny", "mousehead", "cow") for scheme in ("loop", "interp-loop")),
        ("", "interp-loop"),
    ]
    first, second, *_, gap, over = rows
    (table,) = WITH_A_GAP[0].split()
    cell = table.cells[DEFAULT_METRIC, "bunny", Row(0, "loop")]
    assert (float(first["mean"]), float(first["mean_low"]), float(first["mean_high"])) == (cell.mean, *cell.interval)
    assert (first["seeds"], first["paper"], first["baseline"]) == ("0 1 2", "0.025621", "")
    assert (second["baseline"], second["significant"], second["best"]) == ("loop", "true", "true")
    assert float(second["low"]) < float(second["difference"]) < float(second["high"]) < 0
    assert (second["improvement"], second["seeds_needed"]) == ("1.0", "2")
    assert (gap["mean"], gap["count"], gap["seeds"]) == ("", "0", "")
    assert (over["target_title"], over["baseline"], over["mean"]) == ("mean over 2 targets", "loop", "")
    assert float(over["low"]) < float(over["difference"]) < float(over["high"])


def test_json_holds_everything():
    (table,) = json.loads(FORMATS["json"](TABLES))["tables"]
    cells = {(cell["target"], cell["scheme"]): cell for cell in table["cells"]}
    assert list(cells["bunny", "loop"]["values_by_seed"].values()) == CLEAR["bunny", "loop"]
    assert cells["bunny", "interp-loop"]["paper"] == {"by column": 0.035352, "by row": 0.07518}
    assert table["settings"]["fit.steps"] == 2000
    assert [difference["significant"] for difference in table["differences"]] == [True, False]
    assert [difference["improvement"] for difference in table["differences"]] == [1.0, pytest.approx(4 / 9)]
    assert [difference["targets"] for difference in table["over_targets"]] == [2]
    assert table["best"] == {"bunny": "interp-loop"}


def latex_body(text):
    return text[text.index(r"\begin{tabular}") : text.index(r"\end{tabular}")]


def test_latex_is_a_booktabs_table_with_caption_and_label():
    text = to_latex(TABLES)
    rows = [line for line in latex_body(text).splitlines() if line.endswith((r"\\", r"\\*"))]
    assert r"\begin{tabular}{lrrrr}" in text
    assert [row.count("&") for row in rows] == [4] * 6  # headings, means and intervals, in two lines each
    assert re.search(r"\\textbf\{0\.210 \(0\.211\)\} .*\n.*\\textbf\{\{\[\}0\.1\d+, 0\.2\d+\{\]\}\}", text)
    assert text.isascii() or not re.search(r"[^\x00-\x7f]", re.sub(r"%.*", "", text))
    begun = re.findall(r"\\begin\{(\w+)\}", text)
    assert sorted(begun) == sorted(re.findall(r"\\end\{(\w+)\}", text)) == ["table", "tabular"]
    assert text.startswith("% needs booktabs: \\usepackage{booktabs}\n")
    assert r"\label{tab:table1-hausdorff-symmetric-1}" in text


FIVE = merged(grid({(t, s): [0.31, 0.32, 0.36] for t in ("bunny", *"abcd") for s in ("loop", "interp-loop")}))


def in_style(tables, *labels, **style):
    return styled(tables, Style(**style), labels)


@over("cells", ["mean", "mean-sd", "mean-ci", "full"])
def test_five_targets_are_in_one_tabular(cells):
    text = to_latex(in_style(FIVE, cells=cells))
    assert text.count(r"\begin{tabular}") == 1
    assert all(f" & {name}" in text for name in ("bunny", *"abcd"))
    packages = text.partition("\n")[0].partition(": ")[0].removeprefix("% needs ").split(", ")
    assert ("graphicx" in packages) == (r"\resizebox" in text)


def test_cells_contain_what_is_asked_for_in_every_format():
    sample = [0.31, 0.32, 0.36]
    mean, spread = statistics.mean(sample), statistics.stdev(sample)
    for name in ("rich", "md", "latex"):
        texts = {cells: FORMATS[name](in_style(FIVE, cells=cells)).replace(r"$\pm$", "±") for cells in CELLS}
        assert f"{mean:.3f} ± {spread:.3f}" in texts["mean-sd"]
        assert "(0.32" not in texts["mean-ci"]
        assert "0.26" in texts["mean-ci"]  # the lower end of the interval
        assert "0.26" not in texts["mean"] + texts["mean-sd"]
        assert "paper's bunny" not in squeezed("".join(texts[cells] for cells in CELLS[:3]).replace("\\", " "))
    for cells, fields in {"mean": {"mean"}, "mean-sd": {"mean", "spread"}, "full": {*NUMBERS}}.items():
        (row, *_) = csv.DictReader(StringIO(FORMATS["csv"](in_style(FIVE, cells=cells))))
        (cell, *_) = json.loads(FORMATS["json"](in_style(FIVE, cells=cells)))["tables"][0]["cells"]
        assert fields == NUMBERS & row.keys()
        assert fields == {*NUMBERS} & cell.keys()


CELLS = ["mean", "mean-sd", "mean-ci", "full"]
NUMBERS = {"mean", "spread", "median"}


def test_labels_and_digits_and_transposing_are_the_same_in_every_format():
    tables = in_style(FIVE, "interp-loop=Interp. Loop", "a=Alpha", cells="mean", digits=2, transpose=True, notes="none")
    for name in ("rich", "md", "latex"):
        text = FORMATS[name](tables)
        assert "interp-loop" not in text
        assert re.search(r"scheme|target", text)[0] == "target"
        assert re.search(r"Alpha\W+0\.33\W+0\.33\b", text)
    rows = list(csv.DictReader(StringIO(FORMATS["csv"](tables))))
    assert [row["scheme_title"] for row in rows] == ["loop"] * 5 + ["Interp. Loop"] * 5
    assert {row["mean"] for row in rows} == {"0.33"}
    (table,) = json.loads(FORMATS["json"](tables))["tables"]
    assert table["scheme_titles"] == {"loop": "loop", "interp-loop": "Interp. Loop"}
    assert {cell["mean"] for cell in table["cells"]} == {0.33}


def test_notes_none_leave_the_table_and_short_ones_the_exceptions():
    for name in ("rich", "md", "latex"):
        short, none = (squeezed(FORMATS[name](in_style(WITH_A_GAP, notes=notes))) for notes in ("short", "none"))
        assert "loop on cow: 2 seeds" in short
        assert "2 seeds" not in none
        assert "Seeds needed" not in short
        assert "≈" not in none.replace(r"$\approx$", "≈")


def test_a_label_of_nothing_is_refused_and_one_of_a_variant_with_parameters_is_taken():
    with pytest.raises(ConfigError, match="did you mean 'loop'"):
        in_style(FIVE, "lop=x")
    with pytest.raises(ConfigError, match="expected NAME=LABEL"):
        in_style(FIVE, "loop")
    name = "interp-loop:alpha=0.5"
    assert parse_labels([f"{name}=A = B"], ["interp-loop", name]) == {name: "A = B"}


def test_latex_escapes_what_would_be_a_command():
    text = to_latex(merged([result(experiment=AWKWARD)]))
    assert r"\caption{a\_b\%c\&d\#e\{f\}{[}g{]}\textbar{}h*i\textless{}j" in text
    bare = re.sub(r"\\[&%$#_{}\\]", "", text)
    assert bare.count("{") == bare.count("}")
    assert not re.search(r"[_#]", bare.replace("\\label", ""))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_compiles(tmp_path):
    names = [f"interp-loop:alpha=0.{k}" for k in range(1, 8)]
    many = grid({(target, scheme): [0.3123, 0.3145, 0.35] for target in ("bunny", *"abcd") for scheme in names})
    long = [one for weight in range(1, 40) for one in grid(CLEAR, fit__losses__edge=weight / 10)]
    tables = to_latex([*WITH_A_GAP, *SWEEP, *merged([result(experiment=AWKWARD)]), *merged(many), *merged(long)])
    text = (
        "\\documentclass{article}\\usepackage{booktabs,graphicx,longtable}\\begin{document}\n"
        + tables
        + "\\end{document}\n"
    )
    (tmp_path / "t.tex").write_text(text, encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "too large" not in done.stdout
    assert "Overfull" not in done.stdout


ONE_SCHEME = merged([one for steps in (10, 9, 100) for one in grid(LOOP_ONLY, fit__steps=steps)])


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_variations_are_rows_and_a_setting_that_is_varied_says_so(name):
    text = squeezed(FORMATS[name](ONE_SCHEME))
    assert text.index("steps=9") < text.index("steps=10") < text.index("steps=100")
    assert "Fit: varied steps of sgd" in text
    assert "scheme loop" in text
    both = squeezed(FORMATS[name](SWEEP)).replace("{", "").replace("}", "")
    assert re.search(r"edge=0\.1.{1,20}loop .*edge=0\.1.{1,20}interp-loop|edge=0\.1.{1,20}loop .*interp-loop ", both)


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_beside_variations_the_papers_numbers_are_in_a_note_alone(name):
    text = squeezed(FORMATS[name](ONE_SCHEME))
    assert "by column, the likelier: bunny loop 0.025621" in text
    assert text.count("0.025621") == 2


@pytest.mark.parametrize("name", ["csv", "json"])
def test_data_formats_list_every_table_by_itself(name):
    text = FORMATS[name](SWEEP)
    if name == "json":
        found = [
            (table["metric"]["name"], table["settings"]["fit.losses.edge"]) for table in json.loads(text)["tables"]
        ]
    else:
        rows = csv.DictReader(StringIO(text))
        found = list(dict.fromkeys((row["metric"], float(row["table"].partition("edge=")[2])) for row in rows))
    assert found == [(metric, edge) for edge in (0.1, 1.0) for metric in (DEFAULT_METRIC, "f_score.f1")]


def test_cells_that_do_not_differ_are_marked_and_the_mark_is_explained():
    text = to_text(TABLES)
    assert [line.split()[0] for line in text.splitlines() if ") ≈" in line] == ["interp-loop"]
    assert "≈ not significantly different from loop" in text
    assert "≈ not significantly different from the row it is compared with" in to_text(SWEEP)
    clear = merged(grid({cell: sample for cell, sample in CLEAR.items() if cell[0] == "bunny"}))
    assert "≈" not in to_text(clear)


def test_a_difference_is_stated_in_full_in_a_line():
    lines = comparison_lines(TABLES[0])
    bounds = r"\[[−+]0\.\d+, [−+]0\.\d+\]"
    patterns = [
        rf"interp-loop vs loop on bunny: −0\.1000 {bounds}, significant, P\(better\) 1\.00, 2 seeds needed",
        rf"interp-loop vs loop on mousehead \(stand-in\): \+0\.002 {bounds}, not significant, P\(better\) 0\.44, "
        r"1,\d+ seeds needed",
        rf"interp-loop vs loop over 2 targets: −0\.049 {bounds}, significant, P\(better\) 0\.72, 3 seeds needed",
    ]
    assert all(re.fullmatch(pattern, line) for pattern, line in zip(patterns, lines, strict=True)), lines


def test_differences_of_variations_name_what_is_held_against_what():
    starts = {line.partition(" on ")[0].partition(" over ")[0] for line in comparison_lines(SWEEP[0])}
    assert starts == {
        f"{metric}: {rivals}"
        for metric in ("Hausdorff distance", "F-score")
        for rivals in (
            "interp-loop vs loop at edge=0.1",
            "interp-loop vs loop at edge=1.0",
            "edge=1.0 vs edge=0.1 with loop",
        )
    }
    assert comparison_lines(ONE_SCHEME[0])[0].startswith("steps=10 vs steps=9 on bunny: ")


def test_more_seeds_than_anyone_has_are_said_so_and_no_difference_needs_none():
    noisy = {("bunny", "loop"): [0.1, 0.2, 0.3], ("bunny", "interp-loop"): [0.2, 0.3, 0.1003]}
    assert comparison_lines(merged(grid(noisy))[0])[0].endswith("more than 10,000 seeds needed")
    equal = {("bunny", "loop"): [0.1, 0.2], ("bunny", "interp-loop"): [0.1, 0.2]}
    assert comparison_lines(merged(grid(equal))[0])[0].endswith("not significant, P(better) 0.50")


def test_where_neither_direction_is_better_nothing_is_said_of_it():
    assert "P(better)" not in to_text(merged(grid(CLEAR), "quality.euler_number"))


def test_markdown_has_columns_for_variation_and_scheme():
    rows = [line for line in to_markdown(SWEEP).splitlines() if line.startswith("|")]
    assert rows[0].startswith("| variation | scheme | bunny: Hausdorff distance | bunny: F-score |")
    assert [row.split(" | ")[:2] for row in rows[2:4]] == [["| edge=0.1", "loop"], ["| edge=0.1", "interp-loop"]]


def test_latex_has_targets_above_metrics_and_variations_above_schemes():
    lines = [line.strip() for line in latex_body(to_latex(SWEEP)).splitlines()]
    assert r"& \multicolumn{2}{c}{bunny} & \multicolumn{2}{c}{mousehead (stand-in)} \\" in lines
    assert r"\cmidrule(lr){2-3} \cmidrule(lr){4-5}" in lines
    assert r"\multicolumn{5}{l}{\emph{edge=0.1}} \\" in lines
    rows = [line for line in lines if re.search(r"\\\\$", line) and "multicolumn" not in line]
    assert {row.count("&") for row in rows} == {4}


@pytest.mark.parametrize("width", [40, 60, 80, 120])
@over("shown", [SWEEP, ONE_SCHEME], ids=["sweep", "one scheme"])
def test_sweeps_fit_their_width_too(width, shown):
    assert max(map(len, to_text(shown, width).splitlines())) <= width


def test_reports_import_nothing_heavy():
    code = (
        "import sys, meshfit.report.tables.formats, meshfit.report.tables.expected; "
        "sys.exit(bool({'torch', 'trimesh', 'pymeshlab', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
