"""`meshfit fit`: from file to file, the verdict, many at once, and the ways there."""

import json
import re

import numpy as np
import pytest

import meshfit
from meshfit.cli.scratch import scratch_folder
from meshfit.errors import MeshError
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.solids import octahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide
from tests.cli import invoke, refused, trials_in_this_process
from tests.shapes import torus
from tests.soups import ball, joined, two_balls

FEW = ("--set", "fit={coarse_steps: 3, tries: 1, level_steps: 2, last_steps: 1}")
QUICK = ("--verts", "100", *FEW, "--set", "measure={samples: 500, points: 500}")


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with trials_in_this_process():
        yield


def bumpy(name, offset=0.0, *, inverted=False):
    ball = subdivide(octahedron(), "loop", 3)
    verts = ball.verts * (1 + 0.1 * np.sin(5 * ball.verts[:, :1])) * 20 + offset
    save_mesh(Mesh(verts, ball.faces[:, ::-1] if inverted else ball.faces), name)


def test_the_result_lies_on_the_target_and_nothing_else_is_written(tmp_path):
    bumpy("scan.ply", 1e4)
    ran = invoke("fit", "scan.ply", "-o", "out.obj.gz", *QUICK)
    assert ran.code == 0, ran.err
    distances, sound, size = ran.out.splitlines()[:3]
    assert distances.startswith("distance: worst ")
    assert "1 piece, closed, genus 0" in sound
    assert size.endswith("wrote out.obj.gz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.obj.gz", "scan.ply"]
    result, target = load_mesh("out.obj.gz"), load_mesh("scan.ply")
    np.testing.assert_allclose(result.verts.mean(axis=0), target.verts.mean(axis=0), atol=2)


def test_the_bytes_are_those_of_the_kept_trial_and_json_is_of_the_same_fit(tmp_path):
    bumpy("scan.ply")
    ran = invoke("fit", "scan.ply", "-o", "out.ply", *QUICK, "--keep", "kept", "--json")
    assert ran.code == 0, ran.err
    (result,) = (tmp_path / "kept").rglob("result.ply")
    assert result.read_bytes() == (tmp_path / "out.ply").read_bytes()
    verdict, record = json.loads(ran.out), json.loads((result.parent / "result.json").read_text())
    assert verdict["max_distance"] == record["hausdorff"]["symmetric"] * record["frame"]["scale"]
    assert invoke("show", result.parent).code == 0


def test_a_target_inside_out_is_fitted_as_its_turned_twin():
    bumpy("right.ply")
    bumpy("wrong.ply", inverted=True)
    right, wrong = (invoke("fit", f"{name}.ply", "-o", f"{name}.obj", *QUICK, "--json") for name in ("right", "wrong"))
    worst = [json.loads(ran.out)["max_percent"] for ran in (right, wrong)]
    assert worst[0] == pytest.approx(worst[1], rel=0.05)
    assert "its faces are turned for the fit" in wrong.err
    assert "turned" not in right.err


def test_of_many_a_broken_one_is_named_and_the_others_go_on(tmp_path):
    bumpy("scan.ply")
    (tmp_path / "more").mkdir()
    bumpy("more/scan.ply", 5.0)
    (tmp_path / "broken.ply").write_text("no mesh")
    ran = invoke("fit", "scan.ply", "broken.ply", "more/scan.ply", "-o", "out", "--output-format", "off", *QUICK)
    assert ran.code == 1
    assert "broken.ply" in ran.err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["scan-2.off", "scan.off"]
    assert len(ran.out.splitlines()) == 2
    assert ran.err.splitlines()[-1] == "fitted 2 of 3 targets"


@pytest.mark.slow
def test_inputs_of_one_name_are_kept_apart(tmp_path):
    for number, name in enumerate(("a", "b")):
        (tmp_path / name).mkdir()
        bumpy("scan.ply", 1000.0 * number)
        (tmp_path / "scan.ply").rename(tmp_path / name / "scan")
    ran = invoke("fit", "a/scan", "b/scan", "-o", "out/", "--format", "ply", "-q", *QUICK)
    assert (ran.code, ran.err) == (0, "")
    centres = [load_mesh(f"out/{name}.ply").verts.mean() for name in ("scan", "scan-2")]
    assert centres == pytest.approx([0, 1000], abs=5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "out"]


def test_folders_of_killed_processes_are_removed_and_those_in_use_are_not(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with scratch_folder() as used:
        (abandoned := tmp_path / "meshfit-run-killed").mkdir()
        (abandoned / ".lock").touch()
        (abandoned / "result.ply").touch()
        (starting := tmp_path / "meshfit-run-starting").mkdir()
        with scratch_folder() as other:
            assert {used, other, starting} == set(tmp_path.iterdir())
    assert [starting] == list(tmp_path.iterdir())


def test_a_source_from_the_target_and_fixed_faces():
    bumpy("scan.ply")
    assert invoke("fit", "scan.ply", "-o", "a.ply", "--source", "target", *QUICK).code == 0
    faces = ("--connectivity", "fixed", "--register", "off", *QUICK[2:])
    assert invoke("fit", "scan.ply", "-o", "b.ply", "--source", "scan.ply", *faces).code == 0
    np.testing.assert_array_equal(load_mesh("b.ply").faces, load_mesh("scan.ply").faces)


@pytest.mark.slow
def test_a_template_is_registered_whatever_its_unit():
    scan = decimate(load_target("mousehead"), 1200)
    save_mesh(scan, "scan.ply")
    save_mesh(scan.with_verts(1000 * scan.verts[:, [1, 2, 0]] + 5000), "template.ply")
    ran = invoke("fit", "scan.ply", "-o", "a.ply", "--source", "template.ply", "--connectivity", "fixed")
    assert ran.code == 0, ran.err
    assert "warning" not in ran.err
    assert "note: registration: " in ran.out
    worst = np.abs(load_mesh("a.ply").verts - scan.verts).max()
    assert worst < 0.02 * np.ptp(scan.verts, axis=0).max()


def test_only_a_source_of_its_own_is_registered():
    bumpy("scan.ply")
    bumpy("template.ply")
    assert "--source FILE" in refused("fit", "scan.ply", "-o", "b.ply", "--register", "rigid")
    assert "--source template.ply" in refused("fit", "template.ply", "scan.ply", "-o", "b.ply")


def test_what_cannot_be_written_is_refused_before_the_fit():
    bumpy("scan.ply")
    assert "no folder missing" in refused("fit", "scan.ply", "-o", "missing/out.ply")
    assert "overwrite" in refused("fit", "scan.ply", "-o", "scan.ply")
    assert "out.xyz" in refused("fit", "scan.ply", "-o", "out.xyz")
    assert "--measure" in refused("fit", "-", "--format", "ply", "-o", "out.ply", "--measure")


def test_other_ways_lead_to_the_command():
    bumpy("my scan.ply")
    command = "meshfit fit 'my scan.ply' -o 'my scan-fitted.ply'"
    for line in (["my scan.ply"], ["run", "my scan.ply"], ["wrap", "my scan.ply"]):
        assert command in refused(*line)
    assert "meshfit fit bunny -o bunny-fitted.ply" in refused("fti")


def test_what_is_no_mesh_is_told_its_own_command(tmp_path):
    message = "error: accurate is a config, not a mesh; to run it: meshfit run accurate"
    assert refused("fit", "accurate", "-o", "out.ply") == message
    assert refused("fit", "accurate").startswith(f"{message}. See ")
    assert refused("accurate").endswith("a config, not a command; to run it: meshfit run accurate")
    bumpy("scan.ply")
    (tmp_path / "folder").mkdir()
    (tmp_path / "own.yaml").write_text("targets: [cow]\n")
    for words in (["own.yaml"], ["fit", "own.yaml", "-o", "out.ply"]):
        assert "own.yaml is a config, " in refused(*words)
        assert refused(*words).rstrip().endswith("; to run it: meshfit run own.yaml")
    assert refused("fit", "folder", "-o", "out.ply").rstrip().endswith("meshfit fit folder/* -o fitted/")
    assert refused("folder").rstrip().endswith("to show its trials: meshfit status folder")
    assert "several targets need a folder" in refused("fit", "scan.ply", "cow", "-o", "out.ply")
    assert not (tmp_path / "out.ply").exists()


@pytest.mark.slow
def test_holes_that_are_filled_on_purpose_are_one_note():
    whole = ball(level=2)
    middles = whole.verts[whole.faces].mean(axis=1)
    bowl = Mesh(whole.verts, whole.faces[np.abs(middles[:, 2]) < 0.7])
    save_mesh(bowl, "bowl.ply")
    ran = invoke("fit", "bowl.ply", "-o", "out.ply", "--source", "closed", *QUICK)
    notes = [line for line in (ran.out + ran.err).splitlines() if line.startswith(("note: ", "warning: "))]
    assert [re.sub(r"\d+ % ", "", note) for note in notes if "boundary edges" not in note] == [
        "note: filled as set: 2 openings of the target, of the surface"
    ]


def test_a_torus_keeps_its_handle_and_the_reason_is_recorded(tmp_path):
    ring = torus(24, 16)
    mixed = np.random.default_rng(1).random(ring.num_faces) < 0.2
    save_mesh(Mesh(ring.verts, np.where(mixed[:, None], ring.faces[:, ::-1], ring.faces)), "ring.ply")
    ran = invoke("fit", "ring.ply", "-o", "out.ply", "--keep", "kept", "--json", *QUICK)
    verdict = json.loads(ran.out)
    assert verdict["result_topology"] == "1 piece, closed, genus 1"
    assert (verdict["made_from"], verdict["shortfalls"]) == ("target", [])
    assert verdict["reason"].startswith("sound")
    assert verdict["max_percent"] < 5
    (log,) = (tmp_path / "kept").rglob("*.log")
    assert "source: from the target (sound: " in log.read_text()


@pytest.mark.slow
def test_a_handle_that_the_result_lacks_is_named_with_what_to_do():
    save_mesh(torus(24, 16), "ring.ply")
    ran = invoke("fit", "ring.ply", "-o", "ball.ply", "--source", "sphere", *QUICK)
    assert "1 handle (0 in the result); try --source target" in " ".join(ran.out.split())


@pytest.mark.slow
def test_the_bunny_is_met_and_the_bytes_are_those_of_run(tmp_path):
    ran = invoke("fit", "bunny", "-o", "bunny.ply", "--json")
    verdict = json.loads(ran.out)
    assert verdict["max_percent"] < 0.3
    assert verdict["crossing_faces"] == verdict["flipped_faces"] == 0
    bumpy("scan.ply")
    assert invoke("fit", "scan.ply", "-o", "out.ply", *QUICK).code == 0
    settings = ("--set", "fit.verts=100", *QUICK[2:])
    assert invoke("run", "accurate", "--targets", "scan.ply", "--schemes", "loop", *settings).code == 0
    (result,) = (tmp_path / "runs").rglob("result.ply")
    assert result.read_bytes() == (tmp_path / "out.ply").read_bytes()


def test_the_materials_of_a_source_are_written_beside_an_obj(tmp_path):
    bumpy("scan.ply")
    save_mesh(subdivide(octahedron(), "midpoint", 2), "plain.obj")
    lines = (tmp_path / "plain.obj").read_text().replace("f ", "usemtl red\nf ", 1)
    (tmp_path / "source.obj").write_text(f"mtllib look.mtl\n{lines}")
    (tmp_path / "look.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "out").mkdir()
    options = ("--source", "source.obj", "--connectivity", "fixed", "--register", "off", *QUICK[2:])
    ran = invoke("fit", "scan.ply", "-o", "out/fitted.obj", *options)
    assert ran.code == 0, ran.err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["fitted.mtl", "fitted.obj"]
    (material,) = load_mesh("out/fitted.obj").attributes.materials
    assert (material.name, material.color) == ("red", (1.0, 0.0, 0.0, 1.0))


def test_a_result_that_cannot_be_written_is_kept_and_its_place_is_said(monkeypatch, tmp_path):
    bumpy("scan.ply")
    (tmp_path / "out").mkdir()

    def save_once(mesh, path, **options):
        if str(path).startswith("out"):
            raise MeshError(f"{path}: no space left on the device")
        save_mesh(mesh, path, **options)

    monkeypatch.setattr("meshfit.mesh.io.files.save_mesh", save_once)
    ran = invoke("fit", "scan.ply", "-o", "out/fitted.obj", *QUICK)
    kept = re.search(r"the result is kept in (\S+)", ran.err.replace("\n", " "))
    assert ran.code != 0
    assert kept is not None
    assert load_mesh(kept[1]).num_faces > 50


def test_options_at_fault_are_named():
    message = refused("fit", "bone", "cow", "-o", "out/", "--set", "fit.nosuch=1")
    assert message.startswith("error: --set: fit.nosuch: no such key")
    message = refused("fit", "bone", "cow", "-o", "out/", "--scheme", "nosuch")
    assert message.startswith("error: --scheme: 'nosuch' is not a scheme")
    bumpy("scan.ply")
    for option in ("--scheme", "--source"):
        assert refused("fit", "scan.ply", "-o", "out.obj", option, "foo").startswith(f"error: {option}: 'foo' is n")


def test_an_outer_surface_is_fitted_as_one_skin(tmp_path):
    save_mesh(two_balls(2), "parts.ply")
    ran = invoke("fit", "parts.ply", "-o", "skin.ply", "--surface", "outer", *QUICK, "--keep", "kept", "--json")
    assert ran.code == 0, ran.err
    verdict = json.loads(ran.out)
    assert verdict["surface"] == "outer"
    assert verdict["result_topology"] == verdict["target_topology"] == "1 piece, closed, genus 0"
    assert verdict["crossing_faces"] == 0
    assert not verdict["shortfalls"]
    (log,) = (tmp_path / "kept").rglob("*.log")
    assert re.search(r"target: its outer surface, [\d,]+ faces; 2\d\.\d% of its area is hidden", log.read_text())
    measured = json.loads(invoke("measure", "skin.ply", "parts.ply", "--surface", "outer", "--json").out)
    assert measured["surface"] == "outer"
    assert measured["hausdorff"]["symmetric"] < 0.2
    assert json.loads(invoke("measure", "skin.ply", "parts.ply", "--json").out)["hausdorff"]["symmetric"] > 0.8
    assert invoke("show", *(tmp_path / "kept").rglob("seed-*")).code == 0


@pytest.mark.slow
def test_the_library_fits_an_outer_surface_to_the_same_bytes(tmp_path):
    save_mesh(joined(ball(level=2), ball(radius=0.5, level=1)), "parts.ply")
    ran = invoke("fit", "parts.ply", "-o", "skin.ply", "--surface", "outer", *QUICK, "--set", "fit.noise=0")
    assert ran.code == 0, ran.err
    settings = meshfit.GaussNewtonSettings(coarse_steps=3, tries=1, level_steps=2, last_steps=1, verts=100, noise=0)
    with pytest.warns(meshfit.MeshfitWarning, match="2 separate components"):
        fitted = meshfit.fit("auto", "parts.ply", settings, surface="outer", device="cpu")
    np.testing.assert_array_equal(load_mesh("skin.ply").verts, fitted.mesh.verts)
    both = invoke("fit", "parts.ply", "-o", "both.ply", *QUICK, "--json")
    assert json.loads(both.out)["result_topology"].startswith("2 pieces, closed")
