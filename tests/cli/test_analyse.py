"""`meshfit schemes NAME --analyse` and `--plot`."""

import importlib
import json
from functools import cache
from unittest import mock

import numpy as np
import pytest

from meshfit.subdivision.registry import SCHEMES
from tests.cli import answered, refused

FAST = ("interp-loop", "four-point")
printed = cache(answered)


def by_name(names):
    return pytest.mark.parametrize(
        "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in names]
    )


VERDICTS = {
    "midpoint": "C0 on regular meshes (s2 = 1.500), not C1",
    "loop": "C2 on regular meshes (s2 = 3.500); C1 at valences 3 to 12",
    "interp-loop": "C1 on regular meshes (s2 = 2.441); C1 fails at valence 3",
    "interp-loop:valence3=zorin": "C1 on regular meshes (s2 = 2.441); C1 at valences 3 to 12",
    "butterfly": "C1 on regular meshes (s2 = 2.441); C1 fails at valences 3 and 8 to 12",
    "four-point": "C1 (s2 = 2.441)",
    "sqrt3": "C2 on regular meshes (s2 = 2.936); C1 at valences 3 to 12",
}


@by_name(VERDICTS)
def test_the_verdict_comes_first(name):
    out = printed("schemes", name, "--analyse")
    assert out.startswith(f"{VERDICTS[name]}\n\n{name}  ")


@by_name(SCHEMES)
def test_every_scheme_is_analysed_in_80_columns(name):
    with mock.patch("tests.cli.WIDTH", 80):
        out = answered("schemes", name, "--analyse")
        assert answered("schemes", name) in out
    assert max(map(len, out.splitlines())) <= 80
    assert "Sobolev exponent" in out
    assert "shifts of the basis" in out


def test_what_is_printed_of_interp_loop():
    out = printed("schemes", "interp-loop", "--analyse")
    assert "reproduced to degree 3, generated to degree 3" in out
    assert "3 rings around a vertex; stencils of 1 to 10 vertices" in out
    rows = [line.split() for line in out.splitlines()]
    assert ["3", "0.2500", "4", "0.2664", "0", "–", "regular", "no"] in rows
    assert ["7", "0.5264", "2", "0.3390", "2", "unbounded", "regular", "yes"] in rows
    warning = "|λ| = 0.2664 of mode 0 exceeds 0.2500 of mode 1; it holds there for alpha < 0.8636"
    assert f"warning: C1 fails at valence 3: {warning}\n" in out


def test_the_same_as_json():
    found = json.loads(answered("schemes", "interp-loop", "--analyse", "--json"))
    assert found["name"] == "interp-loop"
    assert found["masks"]
    analysis = found["analysis"]
    assert analysis["verdict"] == VERDICTS["interp-loop"]
    assert analysis["s2"] == pytest.approx(2.4408, abs=1e-4)
    assert (analysis["domain"], analysis["continuity"], analysis["support"]["radius"]) == ("triangles", 1, 3)
    assert [row["valence"] for row in analysis["valences"]] == list(range(3, 13))
    three = analysis["valences"][0]
    assert (three["c1"], three["c1_below_alpha"]) == (False, pytest.approx(0.86364, abs=1e-5))
    assert three["rest"] == {
        "modulus": pytest.approx(0.2664, abs=1e-4),
        "real": pytest.approx(0.2069, abs=1e-4),
        "imaginary": pytest.approx(0.168, abs=1e-3),
        "mode": 0,
    }
    assert "analysis" not in json.loads(answered("schemes", "interp-loop", "--json"))


def test_the_same_bytes_each_time():
    for options in ((), ("--json",)):
        assert answered("schemes", "four-point", "--analyse", *options) == answered(
            "schemes", "four-point", "--analyse", *options
        )


def test_an_analysis_is_of_one_scheme(tmp_path):
    assert "--analyse is for one scheme: name it" in refused("schemes", "--analyse")
    assert "--plot is for one scheme: name it" in refused("schemes", "--plot", tmp_path / "x.png")
    assert "'lop' is not a scheme" in refused("schemes", "lop", "--analyse")


@pytest.mark.slow
def test_a_figure_is_written(tmp_path):
    pictures = pytest.importorskip("PIL.Image")
    pytest.importorskip("pyvista")
    path = tmp_path / "loop.png"
    assert answered("schemes", "loop", "--plot", path).endswith(f"wrote {path}\n")
    image = np.asarray(pictures.open(path).convert("L"), dtype=float)
    assert image.shape == (1124, 1400)
    for half in (image[100:562], image[562:]):
        for quarter in np.split(half, 2, axis=1):
            assert 0.02 < (quarter < 250).mean() < 0.9
    assert image[:, 0].min() > 250


def test_the_figure_of_a_curve_has_two_panels(tmp_path):
    pictures = pytest.importorskip("PIL.Image")
    path = tmp_path / "curve.png"
    answered("schemes", "four-point", "--plot", path)
    image = np.asarray(pictures.open(path).convert("L"), dtype=float)
    assert image.shape == (604, 1400)
    for half in np.split(image[100:], 2, axis=1):
        assert 0.01 < (half < 250).mean() < 0.9
    content = path.read_bytes()
    out = answered("schemes", "four-point", "--analyse", "--plot", path, "--json")
    assert json.loads(out)["analysis"]["continuity"] == 1
    assert path.read_bytes() == content


def test_figures_that_cannot_be_written(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    assert ".jpeg" in refused("schemes", "loop", "--plot", tmp_path / "x.jpeg")
    assert "no folder" in refused("schemes", "loop", "--plot", tmp_path / "missing" / "x.png")
    (tmp_path / "folder.png").mkdir()
    there = importlib.import_module

    def missing(name, package=None):
        if name.partition(".")[0] == "matplotlib":
            raise ImportError(name)
        return there(name, package)

    monkeypatch.setattr(importlib, "import_module", missing)
    message = refused("schemes", "loop", "--plot", tmp_path / "x.png")
    assert "pictures need matplotlib, which is not installed: pip install 'meshfit[report]'" in message
    assert answered("schemes", "four-point", "--analyse").startswith(VERDICTS["four-point"])
