"""What the README shows works as it stands there."""

import re
from fractions import Fraction
from pathlib import Path

import pytest

from meshfit.config.loading import bundled_configs, load_experiment
from meshfit.config.sweeps import variants_of
from meshfit.mesh.io.files import load_mesh
from meshfit.subdivision.scheme import SchemeEntry
from meshfit.subdivision.triangles import table
from tests.cli import invoke

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def blocks(language):
    return [text for name, text in BLOCKS if name == language]


def test_the_python_example_runs_and_writes_a_result(tmp_path, monkeypatch, capsys):
    (example,) = (text for text in blocks("python") if text.startswith("import meshfit"))
    (batch,) = (text for text in blocks("python") if text.startswith("problems ="))
    small = (
        (example + batch).replace('"bunny"', '"bone"').replace("levels=4", "levels=2").replace("steps=500", "steps=5")
    )
    assert (small.count("bone"), small.count("levels=2"), small.count("steps=5")) == (1, 1, 2)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(small, "README.md", "exec"), names)
    assert names["outcomes"][0].mesh.verts.tobytes() == names["result"].mesh.verts.tobytes()
    distance, crossings = capsys.readouterr().out.split()
    assert float(distance) > 0
    assert int(crossings) >= 0
    assert load_mesh(tmp_path / "result.ply").num_verts == 162


def test_the_example_of_a_scheme_is_an_entry_of_the_table():
    (example,) = (text for text in blocks("python") if text.startswith('"my-butterfly"'))
    found = eval("{" + example + "}", vars(table) | {"SchemeEntry": SchemeEntry})
    assert found["my-butterfly"].declare().inserted.wing == Fraction(-1, 20)


def test_the_config_examples_are_configs(tmp_path):
    loaded = []
    for number, example in enumerate(blocks("yaml")):
        (tmp_path / f"{number}.yaml").write_text(example)
        loaded.append(load_experiment(str(tmp_path / f"{number}.yaml")).settings)
    config, grid, named, own = loaded
    assert config.fit.losses.edge == 0.5
    assert len(variants_of(grid)) == 8
    assert [variant.name for variant in variants_of(named)] == ["as it is", "softer", "second engine"]
    assert own.schemes == ("loop", "my-loop", "softer:alpha=0.3")


@pytest.mark.parametrize("line", re.findall(r"^    (meshfit .+?) *(?:#.*)?$", README, flags=re.MULTILINE))
def test_every_command_and_option_shown_exists(line):
    words = line.split()
    shown = invoke(words[1], "--help")
    assert shown.code == 0
    for option in (word for word in words if word.startswith("-")):
        assert f"{option} " in shown.out


def test_every_make_target_and_bundled_config_named_exists():
    targets = re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    for name in re.findall(r"`make ([a-z0-9-]+)`", README):
        assert name in targets
    for name in re.findall(r"meshfit run ([a-z0-9]+)\b(?!\.)", README):
        assert name in bundled_configs()
