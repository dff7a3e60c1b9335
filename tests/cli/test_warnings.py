"""Warnings: each once, by file, and of trials that fell short of what a fit should do."""

import json
import warnings
from pathlib import Path

import pytest

from meshfit.cli.console import show_warnings
from meshfit.errors import MeshfitWarning
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from tests.cli import answered, invoke, trials_in_this_process
from tests.shapes import torus
from tests.small import config_file

CONFIG = """\
targets: [ellipsoid.ply, twice.obj]
schemes: [loop, interp-loop]
source: {mesh: icosahedron, levels: 1}
fit: {steps: 60, samples: 1000, losses: {laplacian: 0, edge: 0, normal: 0}}
measure: {samples: 200, points: 200}
device: cpu
"""
FARTHER, LARGER = "the fit ended farther from the target than it began: mean distance ", "the source is "


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config_file(tmp_path, CONFIG)
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)))
    faces = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (tmp_path / "twice.obj").write_text(text + "v 9 9 9\n" + faces + "f 1 3 2\n")
    return tmp_path


def run(*arguments):
    with trials_in_this_process():
        ran = invoke("run", "small.yaml", *arguments)
    assert ran.code == 0
    return [line for line in ran.err.splitlines() if line.startswith("warning: ")]


def recorded():
    return [json.loads(path.read_text())["warnings"] for path in sorted(Path("runs").rglob("result.json"))]


def test_each_warning_is_shown_once_and_those_of_a_file_on_one_line(folder):
    line = f"warning: {folder / 'twice.obj'}: dropped 1 duplicate face; dropped 1 unreferenced vertex"
    assert run() == [line]
    assert sum("dropped" in text for texts in recorded() for text in texts) == 4  # both of two trials
    assert run() == [line]
    meshes = invoke("measure", "twice.obj", "ellipsoid.ply")
    assert meshes.err == "warning: twice.obj: dropped 1 duplicate face; dropped 1 unreferenced vertex\n"


def test_a_target_that_is_inside_out_is_named_once(folder):
    ball = load_mesh("ellipsoid.ply")
    save_mesh(Mesh(ball.verts, ball.faces[:, ::-1]), "inverted.ply")
    (line,) = [text for text in run("--targets", "inverted.ply") if "inside out" in text]
    assert line.endswith(
        "inverted.ply: the surface is inside out: closed, with a negative volume; its faces are turned for the fit"
    )


def test_a_fit_that_ended_farther_off_than_it_began_says_so(folder):
    with trials_in_this_process():
        ran = invoke("run", "small.yaml", "--set", "fit.samples=1", "--targets", "ellipsoid.ply")
    note = " ".join(ran.out.split())
    assert "† falls short of its target: on ellipsoid" in note
    assert FARTHER in note
    assert "; raise fit.samples, or lower fit.optimizer.lr" in note
    assert "Verdict: 2 of 2 results doubtful" in ran.out
    for texts in recorded():
        assert [text.partition(" ")[0] for text in texts][-2:] == ["not", "off"]  # not reached, off the target
        assert any(text.startswith(FARTHER) for text in texts)
    logs = [path.read_text() for path in Path("runs").rglob("trial.log")]
    assert all(f"warning: {FARTHER}" in log for log in logs)


@pytest.mark.slow
def test_a_source_several_times_larger_than_the_target_says_so(folder):
    lines = run("--set", "normalise=box", "--targets", "ellipsoid.ply")
    # Each scheme has a source of its own size; the warning of the trial that is read first stands for both.
    assert [line[: len(f"warning: ellipsoid: {LARGER}") + 4] for line in lines] in (
        [f"warning: ellipsoid: {LARGER}2.67"],
        [f"warning: ellipsoid: {LARGER}3.35"],
    )
    assert all(any(text.startswith(LARGER) for text in texts) for texts in recorded())
    assert run("--set", "normalise=box", "--set", "source.radius=0.5", "--targets", "ellipsoid.ply", "--force") == []


def test_a_handle_that_a_first_order_fit_lacks_is_a_shortfall_in_the_notes_of_the_table(folder):
    save_mesh(torus(), folder / "ring.ply")
    with trials_in_this_process():
        ran = invoke("run", "small.yaml", "--targets", "ring.ply", "--set", "schemes=[loop]")
    finding = "topology not matched: the target has 1 handle (0 in the result)"
    assert f"† falls short of its target: on ring, {finding}" in " ".join(ran.out.split())
    assert finding not in ran.err
    (result,) = (json.loads(path.read_text()) for path in Path("runs").rglob("result.json"))
    assert result["shortfalls"] == [finding]
    assert finding in result["warnings"]


def test_a_fit_as_it_should_be_says_nothing(folder):
    assert run("--targets", "ellipsoid.ply") == []
    assert recorded() == [[], []]


def test_warnings_of_libraries_are_not_shown(capsys):
    with show_warnings():
        warnings.warn("of a library", UserWarning, stacklevel=1)
        warnings.warn("a.obj: one", MeshfitWarning, stacklevel=1)
        warnings.warn("a.obj: two", MeshfitWarning, stacklevel=1)
        warnings.warn("a.obj: one", MeshfitWarning, stacklevel=1)
        warnings.warn("b.obj: three", MeshfitWarning, stacklevel=1)
        warnings.warn("b.obj: long; four", MeshfitWarning, stacklevel=1)
        warnings.warn("no file", MeshfitWarning, stacklevel=1)
    expected = ["a.obj: one; two", "b.obj: three", "b.obj: long; four", "no file"]
    assert capsys.readouterr().err.splitlines() == [f"warning: {text}" for text in expected]


def test_a_warning_comes_before_what_is_printed_after_it(folder):
    ran = invoke("subdivide", "twice.obj", "-", "--output-format", "obj")
    lines = ran.err.splitlines()
    assert lines[0].startswith("warning: twice.obj: dropped 1 duplicate face; dropped")
    assert lines[1].startswith("standard output: ")
    assert answered("--version")
