"""`meshfit subdivide` on curves, and what `schemes` and `compare` say of schemes on them."""

import json

import numpy as np
import pytest

from meshfit.mesh.curves import Curves
from meshfit.mesh.io.files import load_curves, save_curves, save_mesh
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.curves.table import CURVE_SCHEMES
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.cli import answered, refused

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nl 1 2 3 4 1\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "square.obj").write_text(SQUARE)
    save_curves(Curves.through([[0, 0, 0], [1, 2, 0], [3, 0, 1]]), tmp_path / "arc.ply")
    save_mesh(octahedron(), tmp_path / "solid.ply")
    return tmp_path


@pytest.mark.parametrize("name", CURVE_SCHEMES)
@pytest.mark.parametrize(("source", "segments", "closed"), [("square.obj", 4, True), ("arc.ply", 2, False)])
@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_curves_are_refined(folder, name, source, segments, closed, suffix):
    said = answered("subdivide", source, f"out{suffix}", "-s", name, "-n", 4)
    fine = segments * (3 if name.startswith("ternary") else 2) ** 4
    verts = fine if closed else fine + 1
    assert said == f"out{suffix}: {segments} segments → {fine} segments, {verts} vertices\n"
    found, expected = load_curves(f"out{suffix}"), subdivide(load_curves(source), name, 4)
    assert found.closed.tolist() == [closed]
    assert np.array_equal(found.verts[found.corners], expected.verts[expected.corners])


def test_parameters(folder):
    answered("subdivide", "arc.ply", "a.obj", "-s", "four-point", "--tension", 0.1)
    answered("subdivide", "arc.ply", "b.obj", "-s", "four-point:tension=0.1")
    assert (folder / "a.obj").read_bytes() == (folder / "b.obj").read_bytes()
    answered("subdivide", "arc.ply", "c.obj", "-s", "interp-bspline", "--alpha", 0.25, "-n", 2)
    expected = subdivide(load_curves("arc.ply"), "interp-bspline", 2, alpha=0.25)
    found = load_curves("c.obj")
    assert np.array_equal(found.verts[found.corners], expected.verts[expected.corners])


REFUSED = {
    ("solid.ply", "out.obj", "-s", "four-point"): "solid.ply: no curves in it; PLY holds them as 'edge' elements; "
    f"schemes on surfaces: {', '.join(TRIANGLE_SCHEMES)}",
    ("square.obj", "out.obj"): "square.obj: expected a surface, got curves of 4 segments and 4 vertices, and no faces; "
    f"schemes on curves: {', '.join(CURVE_SCHEMES)}",
    ("gone.obj", "out.obj", "-s", "four-point"): "gone.obj: no such file",
    ("square.obj", "out.glb", "-s", "four-point"): "out.glb: unknown curve format '.glb'; allowed: .obj",
    ("square.obj", "out.obj", "-s", "four-point", "--tension", "1"): "four-point: tension=1.0 is not allowed: expected",
    (
        "square.obj",
        "out.obj",
        "-s",
        "interp-bspline",
        "--alpha",
        "",
    ): "--alpha: interp-bspline refines curves; expected one number, got ''",
    ("square.obj", "out.obj", "-s", "four-point", "--alpha", "1"): "scheme 'four-point' has no parameter 'alpha'",
    ("square.obj", "out.obj", "-s", "cubic-bspline", "-n", "11"): "Invalid value for '--levels'",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_what_is_refused(folder, arguments):
    assert refused("subdivide", *arguments).startswith(f"error: {REFUSED[arguments]}")
    assert not list(folder.glob("out.*"))


def test_experiments_are_of_surfaces(folder, completed):
    said = refused("compare", "loop", "four-point", "--dry-run")
    assert said.startswith("error: schemes[1]: four-point refines curves, and experiments fit surfaces; allowed: mid")
    assert "four-point" not in completed("meshfit compare ")
    assert "loop" in completed("meshfit compare ")


def test_masks_of_curves_are_shown(folder):
    shown = answered("schemes", "four-point")
    assert "refines                        curves" in shown
    assert "-1/16, 9/16, 9/16, -1/16 at -1 … 2 along it" in shown
    assert "7/16, 5/8, -1/16 at 0 … 2 along it" in shown
    assert "1/16, 7/8, 1/16 at -1 … 1 along it" in answered("schemes", "interp-bspline:alpha=0.5")
    ternary = answered("schemes", "ternary-bspline")
    assert "1/27, 16/27, 10/27 at -1 … 1 along it" in ternary
    assert "10/27, 16/27, 1/27 at 0 … 2 along it" in ternary


def test_domains_are_listed(folder):
    rows = json.loads(answered("schemes", "--json"))
    assert {row["name"] for row in rows if row["domain"] == "curves"} == set(CURVE_SCHEMES)
    lines = answered("schemes").splitlines()
    headings = [line.strip() for line in lines if line.startswith("on ")]
    assert headings[0] == "on triangles"
    assert headings[-1] == "on curves"
