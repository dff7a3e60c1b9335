"""The examples in the README and the documentation work as they are written."""

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import meshfit
from meshfit.config.loading import bundled_configs, load_experiment
from meshfit.config.sweeps import variants_of
from meshfit.mesh.io.files import load_mesh
from meshfit.subdivision.scheme import SchemeEntry
from meshfit.subdivision.triangles import table
from tests.cli import invoke

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
}


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page], flags=re.MULTILINE | re.DOTALL)


def commands(page):
    """Command lines in code blocks, without comments."""
    fenced = "\n".join(blocks(page, "bash"))
    indented = "\n".join(re.findall(r"^    (meshfit .+)$", PAGES[page], flags=re.MULTILINE))
    return re.findall(r"^(meshfit .+?) *(?:#.*)?$", f"{fenced}\n{indented}", flags=re.MULTILINE)


@pytest.mark.parametrize("page", [page for page in PAGES if any("import meshfit" in b for b in blocks(page, "python"))])
def test_the_python_examples_run_and_write_a_result(page, tmp_path, monkeypatch, capsys):
    example, *batch = blocks(page, "python")
    small = example.replace('"bunny"', '"bone"').replace("levels=4", "levels=2").replace("steps=500", "steps=5")
    assert [small.count(text) for text in ("bone", "levels=2", "steps=5")] == [1, 1, 1]
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(small, page, "exec"), names)
    distance, crossings = capsys.readouterr().out.split()
    assert float(distance) > 0
    assert int(crossings) >= 0
    assert load_mesh(tmp_path / "result.ply").num_verts == 162
    for more in batch:
        exec(compile(more.replace("steps=500", "steps=5"), page, "exec"), names)
        assert len(names["outcomes"]) == 8
        apart = [np.abs(mesh.verts - names["result"].mesh.verts).max() for mesh in names["meshes"]]
        assert max(apart) < 0.3 * names["frame"].scale


def test_the_example_of_a_scheme_is_an_entry_of_the_table():
    (example,) = (
        text for text in blocks("docs/development/extending.md", "python") if text.startswith('"my-butterfly"')
    )
    entries = eval("{" + example + "}", vars(table) | {"SchemeEntry": SchemeEntry})
    assert entries["my-butterfly"].declare().inserted.wing == Fraction(-1, 20)


def test_notebooks_are_kept_without_outputs_and_use_public_names():
    """`make docs` runs them."""
    notebooks = sorted((ROOT / "docs").rglob("*.ipynb"))
    assert notebooks
    for path in notebooks:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        assert not any(cell["outputs"] or cell["execution_count"] for cell in code), path
        text = "\n".join("".join(cell["source"]) for cell in code)
        compile(text, path, "exec")
        assert set(re.findall(r"\bmeshfit\.(\w+)", text)) <= set(dir(meshfit))


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "yaml")])
def test_the_config_examples_are_configs(page, tmp_path):
    for number, example in enumerate(blocks(page, "yaml")):
        config = tmp_path / f"{number}.yaml"
        config.write_text(example, encoding="utf-8")
        settings = load_experiment(str(config)).settings
        if page.endswith("sweeps.md"):
            expected = 8 if "zip" in example else 200 if "ranges" in example else 3
            assert len(variants_of(settings)) == expected


def test_every_command_and_option_shown_exists():
    shown = {line: page for page in PAGES for line in commands(page)}
    assert len(shown) > 40
    help_texts = {}
    for line, page in shown.items():
        words = line.split()
        if words[1] not in help_texts:
            answer = invoke(words[1], "--help")
            assert answer.code == 0, f"{page}: {line}"
            help_texts[words[1]] = answer.out
        for option in (word for word in words if word.startswith("-")):
            assert f"{option} " in help_texts[words[1]], f"{page}: {line}"


def test_every_make_target_and_bundled_config_named_exists():
    targets = re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    for page, text in PAGES.items():
        for name in re.findall(r"`make ([a-z0-9-]+)", text):
            assert name in targets, f"{page}: make {name}"
        for name in re.findall(r"meshfit run ([a-z0-9-]+)\b(?!\.)", text):
            assert name in bundled_configs(), f"{page}: meshfit run {name}"


def test_every_path_named_exists():
    for page, text in PAGES.items():
        named = re.findall(r"`((?:meshfit|tests|configs|data)/[\w./-]*\w/?)`", text)
        walked = [f"meshfit/{path}" for path in re.findall(r"^([a-z_/]+\.py) ", text, flags=re.MULTILINE)]
        for name in (*named, *walked):
            assert (ROOT / name).exists() or "NAME" in name, f"{page}: {name}"


def test_every_picture_shown_exists_and_is_described():
    shown = [(page, *found) for page, text in PAGES.items() for found in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", text)]
    assert len(shown) > 15
    for page, words, name in shown:
        picture = ROOT / "data" / name[name.index("pictures/") :] if "pictures/" in name else ROOT / name
        assert picture.is_file(), f"{page}: {name}"
        assert len(words) > 5, f"{page}: {name}"


def test_the_page_of_sources_fits_the_targets_that_its_script_writes():
    pytest.importorskip("PIL")
    from tests.benchmarks.target_pictures import KINDS

    page = PAGES["docs/guide/which-source.md"]
    assert set(re.findall(r"targets/(\w+)\.(?:ply|xyz)\b", page)) == {kind.file or name for name, kind in KINDS.items()}
    assert set(re.findall(r"kinds/(\w+)\.png", page)) == set(KINDS)
