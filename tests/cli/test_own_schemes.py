"""User-defined schemes on the command line: in configs and files, run, compared, shown, refused."""

import csv
import io
import json
from pathlib import Path

import pytest

from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.cli import answered, invoke, trials_in_this_process
from tests.cli.processes import contents, meshfit
from tests.small import config_file

SMALL = """\
targets: [ellipsoid.ply]
define:
  mine:
    edge: {end: 3/8, opposite: 1/8}
    vertex: 5/8 - (3/8 + cos(2*pi/n)/4)^2
    boundary: cubic-bspline
  softer: {base: mine, alpha: 0.5}
schemes: [loop, mine, softer, own/warren.yaml]
seeds: [0, 1]
source: {mesh: octahedron, levels: 2}
fit: {steps: 10, samples: 100, trace_every: 5}
measure: {samples: 500, points: 500}
device: cpu
"""
WARREN = "edge: {end: 3/8, opposite: 1/8}\nvertex: {3: 9/16, else: 3/8}\nboundary: cubic-bspline\n"


def laid_out(folder):
    config_file(folder, SMALL)
    (folder / "own").mkdir()
    (folder / "own" / "warren.yaml").write_text(WARREN)
    (folder / "softer.yaml").write_text("# of Loop\nbase: loop\nalpha: 0.5\n")
    save_mesh(octahedron(), folder / "solid.ply")
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return laid_out(tmp_path)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A folder in which the config was run, and what that printed."""
    found = laid_out(tmp_path_factory.mktemp("complete"))
    with pytest.MonkeyPatch.context() as patch, trials_in_this_process():
        patch.chdir(found)
        return found, invoke("run", "small.yaml")


def scheme_of(path):
    return Path(path).parents[1].name


def test_a_run_gives_what_the_same_built_in_scheme_gives(complete):
    folder, (code, out, err) = complete
    assert code == 0
    assert "[8/8]" in err
    assert all(name in out for name in ("loop", "mine", "softer", "warren"))
    assert "Difference from loop" in out
    results = contents(folder / "runs", "result.ply")
    by_scheme = {
        name: [content for path, content in sorted(results.items()) if scheme_of(path) == name]
        for name in ("loop", "mine", "softer")
    }
    assert sorted(by_scheme["mine"]) == sorted(by_scheme["loop"])
    assert by_scheme["softer"] != by_scheme["loop"]
    identities = {Path(path).parent.name for path in results}
    assert len(identities) == 8


@pytest.mark.slow
def test_a_resolved_config_runs_on_its_own(complete, tmp_path):
    folder, _ = complete
    config = next((folder / "runs/small/ellipsoid/softer").glob("seed-1-*/config.yaml"))
    (tmp_path / "small.yaml").write_text(config.read_text())
    meshfit("run", "small.yaml", "-q", folder=tmp_path)
    (again,) = contents(tmp_path / "runs", "result.ply").values()
    assert again == (config.parent / "result.ply").read_bytes()
    assert (tmp_path / "runs/small/ellipsoid/softer" / config.parent.name).is_dir()


def test_looking_after_runs(complete):
    folder, _ = complete
    run = folder / "runs"
    assert answered("status", run) == "small  8 complete\n"
    trial = next((run / "small/ellipsoid/mine").glob("seed-0-*"))
    shown = answered("show", trial)
    assert "define:" in shown
    assert "vertex: 5/8 - (3/8 + cos(2*pi/n)/4)^2" in shown
    assert "mine" in answered("table", run, "--baseline", "mine")
    rows = list(csv.DictReader(io.StringIO(answered("table", run, "--format", "csv"))))
    assert [row["scheme"] for row in rows] == ["loop", "mine", "softer", "warren"]
    answered("export", run, "-o", run / "all.csv")
    exported = list(csv.DictReader(io.StringIO((run / "all.csv").read_text())))
    assert {row["define.mine.vertex"] for row in exported} == {"", "5/8 - (3/8 + cos(2*pi/n)/4)^2"}
    (run / "all.csv").unlink()


def test_compare_takes_names_of_a_config_and_files(complete, monkeypatch):
    folder, _ = complete
    monkeypatch.chdir(folder)
    arguments = ("--config", "small.yaml", "--baseline", "own/warren.yaml", "--name", "small")
    out = answered("compare", "mine", "own/warren.yaml", *arguments)
    assert "Difference from warren" in out


@pytest.mark.slow
def test_compare_with_a_bundled_config(folder):
    out = answered("compare", "loop", "softer.yaml:alpha=0.25", "--config", "quickstart", "--dry-run", "--json")
    assert {row["scheme"] for row in json.loads(out)["trials"]} == {"loop", "softer:alpha=0.25"}


def test_subdivide(folder):
    loop, warren = octahedron(), subdivide(octahedron(), "loop:weights=warren", 2)
    answered("subdivide", "solid.ply", "a.ply", "-s", "own/warren.yaml", "-n", 2)
    assert load_mesh("a.ply").verts.tobytes() == warren.verts.tobytes()
    answered("subdivide", "solid.ply", "b.ply", "-s", "mine", "--config", "small.yaml")
    assert load_mesh("b.ply").verts.tobytes() == subdivide(loop, "loop").verts.tobytes()
    for spec in (("softer.yaml:alpha=0.25",), ("softer.yaml", "--alpha", 0.25)):
        answered("subdivide", "solid.ply", "c.ply", "-s", *spec)
        assert load_mesh("c.ply").verts.tobytes() == subdivide(loop, "interp-loop", alpha=0.25).verts.tobytes()


def test_schemes_shows_masks(folder):
    out = answered("schemes", "own/warren.yaml")
    assert out.startswith("warren  warren, approximating\n")
    assert "3/8 each end (2), 1/8 each opposite (2)" in out
    found = json.loads(answered("schemes", "softer:alpha=0.25", "--config", "small.yaml", "--json"))
    assert (found["name"], found["kind"]) == ("softer", "approximating")
    assert found["parameters"]["alpha"] == {
        "default": 0.5,
        "allowed": [0.0, 1.0],
        "meaning": "from mine (0) to interpolatory (1)",
    }
    listed = answered("schemes", "--config", "small.yaml")
    assert all(name in listed for name in ("interp-sqrt3", "mine", "softer", "warren", "your own"))


REFUSED = {
    ("subdivide", "solid.ply", "x.ply", "-s", "gone.yaml"): "gone.yaml: no such file",
    ("subdivide", "solid.ply", "x.ply", "-s", "sofer.yaml"): "sofer.yaml: no such file; did you mean 'softer.yaml'?",
    ("subdivide", "solid.ply", "x.ply", "-s", "mine"): "'mine' is not a scheme: ",
    ("subdivide", "solid.ply", "x.ply", "-s", "mien", "--config", "small.yaml"): "did you mean 'mine'? allowed: midp",
    ("subdivide", "solid.ply", "x.ply", "-s", "own/warren.yaml", "--alpha", "1"): "scheme 'warren' has no parameter",
    ("subdivide", "solid.ply", "x.ply", "-s", "softer.yaml:alpha=2"): "softer: alpha=2 is not allowed: expected",
    ("subdivide", "solid.ply", "x.ply", "-s", "softer.yaml:aplha=1"): "scheme 'softer' has no parameter 'aplha'",
    ("subdivide", "solid.ply", "x.ply", "-s", "bad.yaml"): "bad.yaml, line 1: define.bad.edge.end: '3/', character",
    ("subdivide", "solid.ply", "x.ply", "-s", "at-4.yaml"): "at-4.yaml, line 3: define.at-4.vertex: '1/(n-4)' div",
    ("subdivide", "solid.ply", "x.ply", "-s", "softer.yaml", "--config", "small.yaml"): "'define' has another 'softer'",
    ("schemes", "bad.yaml"): "bad.yaml, line 1: define.bad.edge.end: ",
    ("schemes", "small.yaml"): "small.yaml, line 1: define.small.targets: no such key",
    ("schemes", "mine"): "'mine' is not a scheme",
    ("compare", "loop", "bad.yaml"): "bad.yaml, line 1: define.bad.edge.end: ",
    ("compare", "loop", "gone.yaml"): "gone.yaml: no such file",
    ("compare", "loop", "mine"): "'mine' is not a scheme",
    (
        "run",
        "bad-config.yaml",
    ): "bad-config.yaml, line 1: define.mine.base: 'lop' is not a scheme",
    (
        "run",
        "small.yaml",
        "--set",
        "define={mine: 3}",
    ): "--set: define.mine: expected a mapping of keys to values",
    ("run", "small.yaml", "--set", "schemes=[bad.yaml]"): "bad.yaml, line 1: define.bad.edge.end: ",
    ("run", "small.yaml", "--baseline", "mien"): "'mien' is not a scheme: did you mean 'mine'?",
    (
        "run",
        "small.yaml",
        "--baseline",
        "butterfly",
    ): "baseline 'butterfly' is not among the schemes: allowed: loop",
    ("run", "own/warren.yaml"): "own/warren.yaml, line 1: edge: no such key",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_what_is_refused(folder, arguments):
    (folder / "bad.yaml").write_text(WARREN.replace("3/8, opp", "3/, opp"))
    (folder / "at-4.yaml").write_text("edge: {end: 1/2}\nboundary: linear\nvertex: 1/(n-4)\n")
    (folder / "bad-config.yaml").write_text("define: {mine: {base: lop}}\n")
    ran = invoke(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert REFUSED[arguments] in ran.err.splitlines()[0]
    assert not (folder / "x.ply").exists()
    assert not (folder / "runs").exists()


def test_a_mesh_whose_verts_have_no_weight_is_refused_before_anything_runs(folder):
    (folder / "small.yaml").write_text(SMALL.replace("octahedron", "wheel.obj").replace("cos(2*pi/n)/4", "1/(n-13)"))
    rim = "\n".join(f"v {i} {i * i} 1" for i in range(13))
    faces = "\n".join(f"f 1 {i + 2} {(i + 1) % 13 + 2}" for i in range(13))
    (folder / "wheel.obj").write_text(f"v 0 0 0\n{rim}\n{faces}\n")
    ran = invoke("run", "small.yaml")
    assert (ran.code, ran.out) == (2, "")
    assert "mine: vertex: '5/8 - (3/8 + 1/(n-13))^2' divides by zero at n = 13" in ran.err
    assert not (folder / "runs").exists()
