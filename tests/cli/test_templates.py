"""Experiments and measurements of templates: truth, the table of their metrics, and correspondences."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from meshfit.config.loading import load_experiment
from meshfit.experiment.plan import plan
from meshfit.experiment.running.worker import pack_inputs, unpack_inputs
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.io.point_clouds import load_points
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from tests.cli import answered, invoke, refused, trials_in_this_process
from tests.loops import over

CONFIG = """\
targets: [{targets}]
target: {{truth: "known/{{target}}.xyz"}}
schemes: [loop]
source: {{mesh: template.ply, levels: 1, radius: null, centre: null, project: none}}
fit: {fit}
measure: {{samples: 500, points: 500}}
device: cpu
"""
FIRST_ORDER = "{steps: 2, samples: 100, trace_every: 1}"
GAUSS_NEWTON = """{method: gauss-newton, connectivity: fixed, levels: 1, coarse_steps: 2, tries: 1, level_steps: 1,
  last_steps: 1}"""
FEW = ("--set", "fit={coarse_steps: 2, tries: 1, level_steps: 1, last_steps: 1}", "--set", "measure={samples: 500}")
TEMPLATE = subdivide(octahedron(), "midpoint", 1)
CENTRE = np.array([100.0, 0.0, 0.0])


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    """A template, two targets elsewhere and larger, and where the template's vertices belong on them."""
    monkeypatch.chdir(tmp_path)
    Path("known").mkdir()
    save_mesh(TEMPLATE, "template.ply")
    ball = subdivide(octahedron(), "loop", 3)
    for name, size in (("a", [1.0, 0.8, 0.6]), ("b", [0.6, 1.0, 0.8])):
        save_mesh(ball.with_verts(20 * ball.verts * size + CENTRE), f"{name}.ply")
        np.savetxt(f"known/{name}.xyz", 20 * TEMPLATE.verts * size + CENTRE, fmt="%.17g")
    with trials_in_this_process():
        yield


def config(targets="a.ply, b.ply", fit=FIRST_ORDER):
    Path("c.yaml").write_text(CONFIG.format(targets=targets, fit=fit))
    return "c.yaml"


def records():
    return {path: json.loads(path.read_text()) for path in sorted(Path("runs").rglob("result.json"))}


@over("fit", [FIRST_ORDER, GAUSS_NEWTON])
def test_the_truth_of_each_target_is_a_metric_and_the_table_shows_it(fit, tmp_path, monkeypatch):
    for name in ("template.ply", "a.ply", "b.ply", "known"):
        (tmp_path / name).symlink_to(tmp_path.parent / name)
    monkeypatch.chdir(tmp_path)
    ran = invoke("run", config(fit=fit), "--runs", "runs", "-q")
    assert ran.code == 0, ran.err
    for title in ("vertex error", "99th percentile of the stretch", "new crossing faces", "fitting time (s)"):
        assert title in ran.out.lower(), title
    found = records()
    assert len(found) == 2
    for path, record in found.items():
        result, scale = load_mesh(path.parent / "result.ply"), record["frame"]["scale"]
        truth = load_points(f"known/{record['target']}.xyz")
        # The first vertices of a refined mesh are those of its control mesh.
        apart = np.linalg.norm(result.verts[: len(truth)] - truth, axis=1)
        assert record["vertex_error"]["max"] == pytest.approx(apart.max() / scale)
        assert record["vertex_error"]["vertices"] == TEMPLATE.num_verts < result.num_verts
        assert record["stretch"]["p99"] >= record["stretch"]["p50"] >= 1
        assert record["new_defects"]["crossing_faces"] == 0
        assert (path.parent / "correspondence.csv").is_file() == (fit == GAUSS_NEWTON)
    if fit == FIRST_ORDER:
        assert "vertex_error.rms" in answered("export", "runs/c", "-o", "all.csv") + Path("all.csv").read_text()


def test_a_truth_for_other_vertices_fails_its_target_before_any_fit():
    np.savetxt("known/b.xyz", np.zeros((5, 3)))
    line = refused("run", config("b.ply"), "--runs", "runs")
    assert "target.truth" in line
    assert "b.xyz: 5 vertices; expected 18 or 66" in line
    assert not list(Path().rglob("result.json"))
    Path("known/b.xyz").unlink()
    ran = invoke("run", config(), "--runs", "runs")
    assert ran.code == 1
    assert "b.xyz" in ran.err
    assert [record["target"] for record in records().values()] == ["a"]
    text = refused("run", config(), "--set", "target.truth='{place}.xyz'")
    assert "{place} stands for nothing; allowed: {target}, {scheme}" in text
    for change, remedy in (
        ("fit={method: gauss-newton}", "set fit.connectivity: fixed"),
        ("source={mesh: wrap}", "set source.mesh to a file"),
    ):
        assert remedy in refused("run", config(), "--set", "fit={method: gauss-newton}", "--set", change)


def test_the_truth_travels_to_remote_workers_and_its_content_is_part_of_the_identity(tmp_path):
    trial = plan([load_experiment(config(targets="a.ply"))])[0]
    store = RunDirectory(tmp_path / "worker")
    there = unpack_inputs(trial, pack_inputs(trial, RunDirectory(tmp_path / "runs")), store, tmp_path / "inputs")
    sent = Path(there.current_path(trial.truth))
    assert sent.is_relative_to(tmp_path / "inputs")
    assert sent.read_bytes() == Path("known/a.xyz").read_bytes()
    np.savetxt("known/a.xyz", TEMPLATE.verts)
    assert plan([load_experiment(config(targets="a.ply"))])[0].identity != trial.identity
    other_tool = config(targets="a.ply", fit="{method: external, tool: pycpd, options: {alpha: 0.2}}")
    assert plan([load_experiment(other_tool)])[0].truth == trial.truth


def test_a_correspondence_is_written_beside_the_result():
    arguments = ("--source", "template.ply", "--connectivity", "fixed", "--register", "off", *FEW, "-q")
    known = ("--set", "target.truth=known/a.xyz", "--correspondence", "pairs.csv")
    ran = invoke("fit", "a.ply", "-o", "out.ply", *arguments, *known)
    assert ran.code == 0, ran.err
    header, *rows = csv.reader(Path("pairs.csv").read_text().splitlines())
    assert header == ["source_vertex", "target_face", "target_u", "target_v", "target_w", "distance"]
    values, result, target = np.array(rows, dtype=np.float64), load_mesh("out.ply"), load_mesh("a.ply")
    assert len(values) == result.num_verts
    apart = np.linalg.norm(result.verts - load_points("known/a.xyz"), axis=1)
    rms, diagonal = np.sqrt((apart**2).mean()), np.linalg.norm(np.ptp(target.verts, axis=0))
    words = f"vertex error: rms {rms:.4g}", f"({100 * rms / diagonal:.2g} % of the diagonal), worst {apart.max():.4g}"
    assert all(word in ran.out for word in words), ran.out
    points = np.einsum("nk,nkd->nd", values[:, 2:5], target.verts[target.faces[values[:, 1].astype(int)]])
    assert np.linalg.norm(points - result.verts, axis=1) == pytest.approx(values[:, 5], abs=1e-4)


@over(
    ("arguments", "text"),
    [
        (("--correspondence", "pairs.csv"), "give --register near-rigid, or --connectivity fixed"),
        (("--correspondence", "pairs.ply", "--connectivity", "fixed"), "expected a CSV file"),
        (("--correspondence", "none/pairs.csv", "--connectivity", "fixed"), "there is no folder none"),
        (("--correspondence", "./a.csv", "--connectivity", "fixed", "--source", "a.csv"), ""),
    ],
)
def test_correspondences_that_cannot_be_written_are_refused(arguments, text):
    assert text in refused("fit", "a.ply", "-o", "out.ply", *arguments)


def test_results_are_measured_against_truth_and_source():
    result = TEMPLATE.with_verts(20 * TEMPLATE.verts * np.array([1.0, 0.8, 0.6]) + CENTRE)
    save_mesh(result, "result.ply")
    save_mesh(result.with_verts(result.verts + np.array([0, 3, 4])), "moved.obj")
    few = ("--samples", 500)
    both = ("--source", "template.ply", "--truth", "known/a.xyz")
    found = json.loads(answered("measure", "result.ply", "a.ply", *few, *both, "--json"))
    assert found["vertex_error"]["max"] == pytest.approx(0, abs=1e-4)
    assert found["stretch"]["scale"] == pytest.approx(16, abs=0.1)
    table = answered("measure", "result.ply", "moved.obj", "--target", "a.ply", *few, *both)
    assert "stretch" in table
    assert "5" in table.splitlines()[-1]
    printed = answered("measure", "result.ply", "a.ply", *few, *both)
    assert "stretch is that of the source made 16" in printed
    ran = invoke("measure", "moved.obj", "a.ply", *few, "--truth", "known/a.xyz", "--fail-above", "vertex_error=10%")
    assert ran.code == 1
    assert "vertex_error.rms is 5, above the limit" in ran.err
    assert "vertex_error.rms requires --truth FILE" in refused("measure", "a.ply", "b.ply", "--metric", "vertex_error")
    assert "stretch.p99 requires --source FILE" in refused("measure", "a.ply", "b.ply", "--fail-above", "stretch=2")
    line = refused("measure", "a.ply", "b.ply", *few, "--truth", "known/a.xyz")
    assert "known/a.xyz: 18 vertices, but a.ply has 258; give a place for each of them" in line
    assert "source has 258 vertices" in refused("measure", "result.ply", "a.ply", *few, "--source", "a.ply")


def test_vertices_that_cleaning_drops_keep_their_truth():
    """The file has one that no face uses."""
    extra = np.concatenate([[[9.0, 9.0, 9.0]], 20 * TEMPLATE.verts + CENTRE])
    save_mesh(Mesh(extra, TEMPLATE.faces + 1), "result.off")
    np.savetxt("known/off.xyz", extra)
    ran = invoke("measure", "result.off", "a.ply", "--samples", 500, "--truth", "known/off.xyz", "--json")
    assert json.loads(ran.out)["vertex_error"]["max"] == pytest.approx(0, abs=1e-9)


def test_errors_of_landmarks_used_and_held_out_are_measured():
    result = TEMPLATE.with_verts(20 * TEMPLATE.verts + np.array([100, 3, 4]))
    save_mesh(result, "result.ply")
    goals = np.round(20 * TEMPLATE.verts[:5] + CENTRE, 9)
    rows = [f"{k},{k},{x},{y},{z},{'no' if k == 4 else 'yes'}" for k, (x, y, z) in enumerate(goals)]
    header = "name,source_vertex,target_x,target_y,target_z,use"
    Path("pairs.csv").write_text("\n".join([header, *rows]) + "\n")
    ball = subdivide(octahedron(), "loop", 3)
    save_mesh(ball.with_verts(20 * ball.verts + CENTRE), "ball.ply")
    arguments = ("measure", "result.ply", "ball.ply", "--samples", 500, "--landmarks", "pairs.csv", "--json")
    for more in ((), ("--source", "template.ply")):
        found = json.loads(invoke(*arguments, *more).out)["landmark_error"]
        errors = [found[key] for key in ("rms", "max", "left_out_rms", "left_out_max")]
        assert errors == pytest.approx([5] * 4)
        assert (found["used"], found["left_out"]) == (4, 1)
    line = refused("measure", "result.ply", "ball.ply", "--metric", "landmark_error")
    assert "landmark_error.rms requires --landmarks FILE" in line
