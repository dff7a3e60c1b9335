"""`meshfit measure`: one result or several, files of distances, limits, and what other programs read of them."""

import csv
import io
import json
from pathlib import Path

import igl
import numpy as np
import pymeshlab
import pytest
import trimesh
import vtk
from vtk.util import numpy_support

from meshfit.measuring.deviation import deviation
from meshfit.measuring.metrics import MEASURED
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.io.files import load_mesh, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.subdivision.refine import subdivide
from tests.cli import answered, invoke, refused
from tests.loops import over

FEW = ("--samples", 500)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cube of half-side 1, and cubes of half-sides 1 + 0.1 n around it; a sphere; a cube without a face."""
    monkeypatch.chdir(tmp_path)
    unit = cube().with_verts(np.sign(cube().verts))
    save_mesh(unit, "cube.ply")
    for n in (1, 2):
        save_mesh(subdivide(unit.with_verts((1 + 0.1 * n) * unit.verts), "midpoint", 1), f"larger{n}.ply")
    save_mesh(subdivide(icosahedron(), "loop", 2), "smooth.ply")
    save_mesh(Mesh(unit.verts, unit.faces[1:]), "open.ply")
    (tmp_path / "bad.ply").write_text("nothing\n")
    return tmp_path


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_distances_in_a_file_are_those_of_libigl_with_their_side():
    blob = subdivide(icosahedron(), "loop", 2)
    save_mesh(blob.with_verts(blob.verts * (1.2 + 0.4 * np.sin(5 * blob.verts[:, :1]))), "blob.ply")
    ran = invoke("measure", "blob.ply", "cube.ply", "--write", "errors.ply", *FEW)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.endswith("\nwrote errors.ply: distances, negative inside the target\n")
    result, target = load_mesh("blob.ply"), load_mesh("cube.ply")
    found, tolerance = deviation(result, target), 1e-12 * bounding_box_diagonal(target.verts)
    assert found.signed
    for points, distances in ((result.verts, found.verts), (result.verts[result.faces].mean(axis=1), found.faces)):
        squared = igl.point_mesh_squared_distance(np.ascontiguousarray(points), target.verts, target.faces)[0]
        outside = (np.abs(points) > 1).any(axis=1)
        assert outside.any()
        assert not outside.all()
        assert np.abs(distances - np.where(outside, 1, -1) * np.sqrt(squared)).max() <= tolerance
    raw = trimesh.load("errors.ply", process=False).metadata["_ply_raw"]
    for element, values in (("vertex", found.verts), ("face", found.faces)):
        for name in ("distance", "quality"):
            assert raw[element]["data"][name].dtype == np.float64
            assert np.array_equal(raw[element]["data"][name].reshape(-1), values)


def test_other_programs_read_the_file_of_distances():
    answered("measure", "larger1.ply", "cube.ply", "--write", "errors.ply", *FEW)
    result, expected = load_mesh("larger1.ply"), deviation(load_mesh("larger1.ply"), load_mesh("cube.ply"))
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("errors.ply")
    mesh = meshes.current_mesh()
    assert np.allclose(mesh.vertex_scalar_array(), expected.verts, atol=1e-7)
    assert np.allclose(mesh.face_scalar_array(), expected.faces, atol=1e-7)
    assert np.allclose(mesh.vertex_matrix(), result.verts)
    reader = vtk.vtkPLYReader()
    reader.SetFileName("errors.ply")
    reader.Update()
    surface = reader.GetOutput()
    assert (surface.GetNumberOfPoints(), surface.GetNumberOfPolys()) == (result.num_verts, result.num_faces)
    assert np.array_equal(load_mesh("errors.ply").faces, result.faces)


def test_vtk_reads_the_distances_of_a_vtp_file():
    answered("measure", "larger1.ply", "cube.ply", "--write", "errors.vtp", *FEW)
    result, expected = load_mesh("larger1.ply"), deviation(load_mesh("larger1.ply"), load_mesh("cube.ply"))
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName("errors.vtp")
    reader.Update()
    surface = reader.GetOutput()
    for data, values in ((surface.GetPointData(), expected.verts), (surface.GetCellData(), expected.faces)):
        assert np.array_equal(numpy_support.vtk_to_numpy(data.GetScalars()), values)
        assert data.GetScalars().GetName() == "distance"
    found = load_mesh("errors.vtp", attributes=False)
    assert np.array_equal(found.verts, result.verts)
    assert np.array_equal(found.faces, result.faces)


def test_distances_from_an_open_target_have_no_side_and_another_name():
    ran = invoke("measure", "larger1.ply", "open.ply", "--write", "errors.ply.gz", *FEW)
    assert (ran.code, ran.out.splitlines()[-1]) == (
        0,
        "wrote errors.ply.gz: distances, unsigned, since the target is open",
    )
    unit = load_mesh("cube.ply")
    found = deviation(load_mesh("larger1.ply"), Mesh(unit.verts, unit.faces[1:]))
    assert not found.signed
    assert found.verts.min() >= 0
    assert load_mesh("errors.ply.gz").num_faces == len(found.faces)
    assert invoke("measure", "larger1.ply", "open.ply", "--write", "errors.ply", *FEW).code == 0
    raw = trimesh.load("errors.ply", process=False).metadata["_ply_raw"]
    assert set(raw["vertex"]["properties"]) == {"x", "y", "z", "unsigned_distance", "quality"}
    assert np.array_equal(raw["vertex"]["data"]["unsigned_distance"].reshape(-1), found.verts)


def test_the_table_of_one_result_ends_with_the_farthest_points():
    out = answered("measure", "larger2.ply", "cube.ply", *FEW)
    assert out.startswith("larger2.ply against cube.ply\nmetric")
    for metric in MEASURED.values():
        assert f"\n{metric.title} " in out
    assert "\nfarthest from the target: 0.3464 at (" in out
    assert (
        "\n500 samples and 30,000 points per surface, F-scores at τ = 0.01732, 0.5 % of the target's diagonal\n" in out
    )
    out = answered("measure", "smooth.ply", "cube.ply", *FEW)
    assert "edge chamfer distance                      –" in out
    assert out.endswith("–: the result has no creases of 30° or more\n")


def test_csv_of_one_result_has_one_row_per_metric():
    found = json.loads(answered("measure", "larger1.ply", "cube.ply", "--json", *FEW))
    rows = rows_of(answered("measure", "larger1.ply", "cube.ply", "--csv", "-", *FEW))
    values = {row["metric"]: row for row in rows}
    assert [name for name in values if name in MEASURED] == list(MEASURED)
    for name, metric in MEASURED.items():
        group, _, key = name.partition(".")
        assert values[name]["unit"] == metric.unit
        assert json.loads(values[name]["value"]) == found[group][key]
    assert {(row["result"], row["target"]) for row in rows} == {("larger1.ply", "cube.ply")}
    assert [float(values[f"farthest.forward.position.{axis}"]["value"]) for axis in "xyz"] == (
        found["farthest"]["forward"]["position"]
    )
    assert values["hausdorff.samples"]["value"] == "500"
    chosen = rows_of(answered("measure", "larger1.ply", "cube.ply", "--csv", "-", "--metric", "hausdorff,edges", *FEW))
    assert [row["metric"] for row in chosen] == ["hausdorff.symmetric", "edges.f1"]


def test_several_results_are_rows_and_one_that_fails_stops_no_other():
    ran = invoke("measure", "larger1.ply", "bad.ply", "larger2.ply", "-t", "cube.ply", "--csv", "all.csv", *FEW)
    assert (ran.code, ran.err) == (1, "error: bad.ply: cannot be read as PLY: it does not start with 'ply'\n")
    lines = [line.split()[:3] for line in ran.out.splitlines()]
    assert lines[0] == ["against", "cube.ply"]
    assert ["larger1.ply", "0.1732", "5.000"] in lines
    assert ["larger2.ply", "0.3464", "10.000"] in lines
    assert ["bad.ply", "failed", "failed"] in lines
    rows = rows_of(Path("all.csv").read_text(encoding="utf-8"))
    assert [row["result"] for row in rows] == ["larger1.ply", "bad.ply", "larger2.ply"]
    assert [bool(row["error"]) for row in rows] == [False, True, False]
    assert float(rows[2]["hausdorff.symmetric"]) == pytest.approx(0.2 * 3**0.5, rel=1e-12)
    assert rows[1]["hausdorff.symmetric"] == ""
    ran = invoke("measure", "larger1.ply", "missing.ply", "--target", "cube.ply", "--json", *FEW)
    found = json.loads(ran.out)
    assert (ran.code, found["target"], found["normalise"]) == (1, "cube.ply", "none")
    assert found["results"][0]["hausdorff"]["symmetric"] == pytest.approx(0.1 * 3**0.5, rel=1e-12)
    assert "no such file" in found["results"][1]["error"]
    assert invoke("measure", "larger1.ply", "larger2.ply", "-t", "cube.ply", *FEW).code == 0
    assert "bad.ply" in refused("measure", "larger1.ply", "larger2.ply", "-t", "bad.ply")


def test_a_narrow_terminal_cuts_no_number(monkeypatch):
    monkeypatch.setattr("tests.cli.WIDTH", 40)
    out = answered("measure", "larger1.ply", "larger2.ply", "-t", "cube.ply", *FEW)
    assert max(map(len, out.splitlines())) <= 40
    for text in ("0.1732", "0.3464", "5.000", "10.000"):
        assert text in out.split()


@over(
    ("limit", "message"),
    [
        ("hausdorff=0.17", "hausdorff.symmetric is 0.1732, above the limit 0.17"),
        ("hausdorff=0.1732", "hausdorff.symmetric is 0.173205"),
        (
            "hausdorff.symmetric = 4.9%",
            "hausdorff.symmetric is 0.1732, above the limit 0.169741, 4.9 % of the",
        ),
        ("edges.chamfer=1e-1", "edges.chamfer is 0.28"),
        ("quality.verts=20", "quality.verts is 26, above the limit 20"),
    ],
)
def test_a_value_above_its_limit_fails_in_one_line(limit, message):
    ran = invoke("measure", "larger1.ply", "cube.ply", "--fail-above", limit, *FEW)
    assert ran.code == 1
    assert ran.err.startswith(f"error: larger1.ply: {message}")
    assert ran.err.count("\n") == 1
    assert "Hausdorff distance" in ran.out


def test_values_within_their_limits_pass_and_each_that_is_not_is_named():
    passing = ("--fail-above", "hausdorff=0.174", "--fail-above", "hausdorff=5.1%", "--fail-above", "quality.verts=26")
    below = ("--fail-below", "f_score=0", "--fail-below", "quality.watertight=1")
    assert invoke("measure", "larger1.ply", "cube.ply", *passing, *below, *FEW).code == 0
    ran = invoke(
        "measure", "larger1.ply", "larger2.ply", "-t", "cube.ply", *FEW, "--json",
        "--fail-above", "hausdorff=0.2", "--fail-above", "distance=1e-3", "--fail-below", "f_score=0.9",
    )  # fmt: skip
    assert ran.code == 1
    assert len(json.loads(ran.out)["results"]) == 2
    names = [line.split()[1:3] for line in ran.err.splitlines()]
    assert names == [
        ["larger1.ply:", "distance.mean"],
        ["larger1.ply:", "f_score.f1"],
        ["larger2.ply:", "hausdorff.symmetric"],
        ["larger2.ply:", "distance.mean"],
        ["larger2.ply:", "f_score.f1"],
    ]
    ran = invoke("measure", "smooth.ply", "cube.ply", "--fail-above", "edges.chamfer=1", *FEW)
    assert (ran.code, ran.err) == (
        1,
        "error: smooth.ply: edges.chamfer has no value to compare with 1: the result has no creases of 30° or more\n",
    )


@over(
    ("arguments", "message"),
    [
        (["cube.ply"], "no target: give it after the result: meshfit measure cube.ply TARGET"),
        (["cube.ply", "cube.ply", "cube.ply"], "3 meshes without --target: give the target of several results by"),
        (["cube.ply", "-t", "cube.ply", "--write", "x.obj"], "--write x.obj: distances are written as PLY"),
        (["a.ply", "b.ply", "-t", "cube.ply", "--write", "x.ply"], "--write takes one result, got 2"),
        (["smooth.ply", "cube.ply", "--write", "./smooth.ply"], "--write ./smooth.ply: would overwrite a mesh that is"),
        (["smooth.ply", "cube.ply", "--csv", "cube.ply"], "--csv cube.ply: would overwrite a mesh that is measured; "),
        (["smooth.ply", "cube.ply", "--csv", "x.obj"], "--csv x.obj: expected a name for CSV, got one for a mesh; "),
        (["smooth.ply", "cube.ply", "--csv", "."], "--csv .: a directory; give the path of a file, such as errors.csv"),
        (["cube.ply", "cube.ply", "--csv", "-", "--json"], "standard output can have only one of --csv - and --json"),
        (["cube.ply", "cube.ply", "--metric", "seconds.fit"], "'seconds.fit' is not a metric of a measurement: "),
        (["cube.ply", "cube.ply", "--tau", "many"], "--tau many: expected a number above 0, or N% of"),
        (["cube.ply", "cube.ply", "--crease-angle", "200"], "crease_angle: expected "),
        (["cube.ply", "cube.ply", "--fail-above", "hausdorff"], "'hausdorff': expected METRIC=NUMBER, such as"),
        (["cube.ply", "cube.ply", "--fail-above", "hausdorff=nan"], "'hausdorff=nan': expected METRIC=NUMBER"),
        (["cube.ply", "cube.ply", "--fail-above", "hausdorf=1"], "'hausdorf=1': 'hausdorf' is not a metric of a"),
        (["cube.ply", "cube.ply", "--fail-above", "hausdorff=0.5mm"], "'hausdorff=0.5mm': unknown unit 'mm': mesh"),
        (["cube.ply", "cube.ply", "--fail-above", "f_score=1"], "'f_score=1': f_score.f1 is better when it is larger"),
        (["cube.ply", "cube.ply", "--fail-below", "hausdorff=1"], "'hausdorff=1': hausdorff.symmetric is better when"),
        (["cube.ply", "cube.ply", "--fail-above", "quality.verts=1%"], "'quality.verts=1%': % is of the target's"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments, message):
    assert refused("measure", *arguments).startswith(f"error: {message}")


def test_tau_and_crease_angle_are_options():
    found = json.loads(answered("measure", "larger1.ply", "cube.ply", "--json", "--tau", "5%", *FEW))
    assert found["f_score"]["tau"] == pytest.approx(0.05 * 12**0.5)
    assert (found["f_score"]["f1"], found["edges"]["f1"]) == (pytest.approx(1, abs=1e-3), 1)
    assert "\nF-scores at τ = 0.25, 7.22 % of the target's diagonal\n" in answered(
        "measure", "larger1.ply", "cube.ply", "--tau", "0.25", "--metric", "hausdorff.forward,edges.f1", *FEW
    )
    assert "τ" not in answered("measure", "larger1.ply", "cube.ply", "--metric", "hausdorff.forward", *FEW)
    found = json.loads(answered("measure", "larger1.ply", "cube.ply", "--json", "--crease-angle", "91", *FEW))
    assert found["edges"]["reason"] == "neither mesh has creases of 91° or more"


def test_scores_do_not_depend_on_the_unit_of_the_files():
    names = []
    for unit in (1, 1024):
        for name in ("larger1", "cube"):
            mesh = load_mesh(f"{name}.ply")
            save_mesh(mesh.with_verts(unit * mesh.verts), f"{name}-{unit}.ply")
        names.append((f"larger1-{unit}.ply", f"cube-{unit}.ply"))
    small, large = (json.loads(answered("measure", *pair, "--json", "--tau", "3%", *FEW)) for pair in names)
    assert 0 < small["f_score"]["f1"] == large["f_score"]["f1"] < 1
    for pair, unit in zip(names, (1, 1024), strict=True):
        found = json.loads(answered("measure", *pair, "--json", *FEW))
        assert found["f_score"]["tau"] == pytest.approx(0.005 * unit * 12**0.5)
        found = json.loads(answered("measure", *pair, "--normalise", "tutorial", "--json", *FEW))
        assert found["f_score"]["tau"] == MeasureSettings().f_score_tau


def test_a_target_that_is_inside_out_is_turned_which_is_said():
    cube = load_mesh("cube.ply")
    save_mesh(Mesh(cube.verts, cube.faces[:, ::-1]), "inside-out.ply")
    ran = invoke("measure", "larger1.ply", "inside-out.ply", "--json", *FEW)
    assert ran.err == (
        "warning: inside-out.ply: the surface is inside out: closed, with a negative volume; "
        "its faces are turned for the measurement\n"
    )
    assert json.loads(ran.out)["normal_consistency"]["signed"] > 0.9
    ran = invoke("measure", "inside-out.ply", "larger1.ply", "--json", *FEW)
    assert ran.err.endswith("inside-out.ply: the surface is inside out: closed, with a negative volume\n")
    assert json.loads(ran.out)["normal_consistency"]["signed"] < -0.9


def test_meshes_in_different_frames_are_measured_and_warned_of():
    cube = load_mesh("cube.ply")
    save_mesh(Mesh(60 * cube.verts + [500, 0, 0], cube.faces), "scan.ply")
    save_mesh(Mesh(60 * cube.verts, cube.faces), "elsewhere.ply")
    ran = invoke("measure", "larger1.ply", "scan.ply", *FEW)
    assert (ran.code, ran.err.count("\n")) == (0, 1)
    assert ran.err == (
        "warning: larger1.ply and scan.ply differ in size 54.5-fold: sizes 2.2 × 2.2 × 2.2 and 120 × 120 × 120, "
        "centres (0, 0, 0) and (500, 0, 0); the result seems to be in the target's tutorial frame; "
        "`meshfit save TRIAL -o FILE` writes it in that of the target's file\n"
    )
    ran = invoke("measure", "elsewhere.ply", "scan.ply", "--normalise", "box", "--json", *FEW)
    assert ran.code == 0
    assert "elsewhere.ply and scan.ply do not overlap: sizes 120 × 120 × 120 and 120 × 120 × 120" in ran.err
    assert "--normalise maps both alike, and `meshfit save TRIAL -o FILE` writes the result of a trial" in ran.err
    assert json.loads(ran.out)["hausdorff"]["symmetric"] > 1
    assert invoke("measure", "larger1.ply", "cube.ply", *FEW).err == ""
