"""Every format, read back by a reader of its own kind."""

import csv
import json
import re
import shutil
import subprocess
import sys
from io import StringIO

import pytest
from rich.console import Console

from meshfit.report.formats import FORMATS
from meshfit.report.formats.csv_text import FIELDS
from meshfit.report.formats.latex import to_latex
from meshfit.report.formats.markdown import to_markdown
from meshfit.report.formats.rich_text import TablesView, to_text
from meshfit.report.table import build_tables
from tests.unit.test_table import CLEAR, grid, result

TABLES = build_tables(grid(CLEAR))
WITH_A_GAP = build_tables(grid({**CLEAR, ("cow", "loop"): [0.1, 0.2]}))
SCHEMES = ("loop", "interp-loop", "interp-loop:alpha=0.5")
WIDE = build_tables(
    grid({(t, s): [0.3, 0.31, 0.35] for t in ("bunny", "mousehead", "cow", "airplane") for s in SCHEMES})
)
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
    two = FORMATS[name](build_tables(grid(CLEAR) + grid(CLEAR, fit__steps=100)))
    assert "fit.steps=2000" in two.replace("\\", "")
    assert "fit.steps=100" in two.replace("\\", "")


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_a_heading_states_what_the_numbers_are(name):
    text = squeezed(FORMATS[name](TABLES))
    for words in ("Hausdorff distance", "3 seeds", "tutorial frame", "2000 steps", "5000 samples", "icosahedron, 4"):
        assert words in text


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_the_papers_numbers_stand_beside_its_own_metric_only(name):
    assert "paper's bunny" in squeezed(FORMATS[name](TABLES)) or name == "rich"
    assert "0.025621" not in FORMATS[name](build_tables(grid(CLEAR), "hausdorff.forward"))


@pytest.mark.parametrize("name", ["rich", "md", "latex"])
def test_a_missing_cell_is_a_dash_and_fewer_seeds_are_noted(name):
    text = squeezed(FORMATS[name](WITH_A_GAP)).replace("--", "–")
    assert re.search(r"interp-loop .*–", text)
    assert "loop on cow: 2 seeds (0, 1)" in text


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("tables", [TABLES, WITH_A_GAP, WIDE], ids=["small", "gap", "wide"])
def test_text_fits_its_width_with_no_cell_broken(width, tables):
    lines = to_text(tables, width).splitlines()
    assert max(map(len, lines)) <= width
    whole = r"\d\.\d+ ± \d\.\d+"
    assert sum(len(re.findall(whole, line)) for line in lines) == len(tables[0].cells)
    assert not any("…" in line for line in lines)


def test_text_marks_the_best_without_colour():
    lines = [line for line in to_text(TABLES).splitlines() if re.search(r"± \S+ +\*", line)]
    assert len(lines) == 1
    assert lines[0].startswith("interp-loop")


def test_text_states_each_difference():
    text = to_text(TABLES)
    assert re.search(r"bunny\n  interp-loop +−0\.1000 \[−0\.\d+, −0\.\d+\] +significant", text)
    assert "not significant" in text
    one = to_text(build_tables([result(), result(scheme="interp-loop", value=0.1)]))
    assert "−0.1000" in one
    assert "one seed: no interval" in one


def test_differences_of_single_runs_are_summed_up_in_a_line():
    found = [result(target, scheme) for target in ("bunny", "cow") for scheme in ("loop", "interp-loop")]
    assert "one seed, so no interval" in to_markdown(build_tables(found))


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
    tables = build_tables([result(value=0.2, experiment="[red]x[/red]")])
    assert to_text(tables).startswith("[red]x[/red]\n")


def test_markdown_has_as_many_columns_in_every_row():
    rows = [line for line in to_markdown(WITH_A_GAP).splitlines() if line.startswith("|")]
    assert [len(re.findall(r"(?<!\\)\|", row)) - 1 for row in rows] == [6, 6, 6, 6]
    assert rows[0].split(" | ")[1:3] == ["bunny", "paper's bunny"]
    assert "**0.2100 ± 0.0095**" in rows[3]


def test_markdown_escapes_what_would_be_markup():
    text = to_markdown(build_tables([result(), result(seed=1, experiment="a|b_c*d")]))
    assert r"a\|b\_c\*d" in text


def test_csv_is_tidy():
    rows = list(csv.DictReader(StringIO(FORMATS["csv"](WITH_A_GAP))))
    assert tuple(rows[0]) == FIELDS
    assert [(row["target"], row["scheme"]) for row in rows] == [
        (target, scheme) for target in ("bunny", "mousehead", "cow") for scheme in ("loop", "interp-loop")
    ]
    first, second, *_, gap = rows
    assert float(first["mean"]) == WITH_A_GAP[0].cells["bunny", "loop"].mean
    assert (first["seeds"], first["paper"], first["baseline"]) == ("0 1 2", "0.025621", "")
    assert (second["baseline"], second["significant"], second["best"]) == ("loop", "true", "true")
    assert float(second["low"]) < float(second["difference"]) < float(second["high"]) < 0
    assert (gap["mean"], gap["count"], gap["seeds"]) == ("", "0", "")


def test_json_holds_everything():
    (table,) = json.loads(FORMATS["json"](TABLES))["tables"]
    cells = {(cell["target"], cell["scheme"]): cell for cell in table["cells"]}
    assert list(cells["bunny", "loop"]["values_by_seed"].values()) == CLEAR["bunny", "loop"]
    assert cells["bunny", "interp-loop"]["paper"] == {"by column": 0.035352, "by row": 0.07518}
    assert table["settings"]["fit.steps"] == 2000
    assert [difference["significant"] for difference in table["differences"]] == [True, False]
    assert table["best"] == {"bunny": "interp-loop"}


def latex_body(text):
    return text[text.index(r"\toprule") : text.index(r"\bottomrule")]


def test_latex_is_a_booktabs_table_with_caption_and_label():
    text = to_latex(TABLES)
    rows = [line for line in latex_body(text).splitlines() if line.endswith(r"\\")]
    assert r"\begin{tabular}{lrrrr}" in text
    assert [row.count("&") for row in rows] == [4, 4, 4]
    assert r"\textbf{0.2100 $\pm$ 0.0095}" in text
    assert text.isascii() or not re.search(r"[^\x00-\x7f]", re.sub(r"%.*", "", text))
    begun = re.findall(r"\\begin\{(\w+)\}", text)
    assert sorted(begun) == sorted(re.findall(r"\\end\{(\w+)\}", text)) == ["table", "tabular"]
    assert r"\label{tab:table1-hausdorff-symmetric-1}" in text


def test_latex_escapes_what_would_be_a_command():
    text = to_latex(build_tables([result(experiment=AWKWARD)]))
    assert r"\caption{a\_b\%c\&d\#e\{f\}{[}g{]}\textbar{}h*i\textless{}j" in text
    bare = re.sub(r"\\[&%$#_{}\\]", "", text)
    assert bare.count("{") == bare.count("}")
    assert not re.search(r"[_#]", bare.replace("\\label", ""))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_compiles(tmp_path):
    tables = to_latex([*WITH_A_GAP, *build_tables([result(experiment=AWKWARD)])])
    text = "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\n" + tables + "\\end{document}\n"
    (tmp_path / "t.tex").write_text(text, encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]


def test_reports_import_nothing_heavy():
    code = (
        "import sys, meshfit.report.formats, meshfit.report.expected; "
        "sys.exit(bool({'torch', 'trimesh', 'pymeshlab', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
