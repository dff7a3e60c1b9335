"""The control mesh that a run writes, refined by `meshfit subdivide`, is the result that the run writes."""

import numpy as np
import pytest

from meshfit.experiment.plan import plan
from meshfit.experiment.running.batch_runner import run_batch
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.experiment.trial_status import TrialStatus
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.io.files import load_polygons, save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import cube, octahedron, quad_cube
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.cli import invoke
from tests.fits import fit
from tests.laws.naive import started_at_least
from tests.loops import each, over
from tests.quads import mixed, quad_patch, quad_torus, two_quads_that_share_two_edges
from tests.small import experiment

pytestmark = pytest.mark.usefixtures("fewer_target_points", "without_shape_checks")

FIT = {
    "method": "gauss-newton",
    "connectivity": "fixed",
    "variables": "control",
    "levels": 2,
    "tries": 1,
    "coarse_steps": 1,
    "level_steps": 1,
    "last_steps": 1,
}
SPECS = [*TRIANGLE_SCHEMES, *POLYGON_SCHEMES, "interp-loop:alpha=0.3", "interp-catmull-clark:alpha=0.5"]


def trial_folder(folder, scheme, **changes):
    (trial,) = plan([experiment(folder, schemes=[scheme], **changes)])
    store = RunDirectory(folder / "runs")
    (outcome,) = run_batch([trial], store, lambda *_: None)
    assert outcome.status is TrialStatus.COMPLETE, outcome.message
    return store.folder(trial)


def require_refinement(folder, scheme, *options):
    """Check that the refined control mesh has the faces of the result, in their order, and its vertices."""
    fine = folder / "fine.ply"
    assert invoke("subdivide", folder / "control.ply", fine, "-s", scheme, *options).code == 0
    found, result = load_polygons(fine), load_polygons(folder / "result.ply")
    assert [started_at_least(row) for row in face_rows(found)] == [started_at_least(row) for row in face_rows(result)]
    np.testing.assert_allclose(found.verts, result.verts, rtol=0, atol=1e-6 * bounding_box_diagonal(result.verts))


def source_for(scheme):
    if scheme.partition(":")[0] in POLYGON_SCHEMES:
        return quad_torus(6, 5) if "ternary" in scheme else mixed()
    return subdivide(octahedron(), "midpoint", 1)


@each("scheme", SPECS, ("loop", "interp-loop", "sqrt3", "catmull-clark", "sqrt2", "doo-sabin"))
def test_the_control_mesh_refined_by_the_scheme_is_the_result(tmp_path, scheme):
    save_mesh(source_for(scheme), tmp_path / "source.obj")
    source = {"mesh": str(tmp_path / "source.obj"), "levels": 0, "radius": 0.5}
    folder = trial_folder(tmp_path, scheme, source=source, fit=FIT)
    require_refinement(folder, scheme, "-n", 2)
    # A coarse mesh, and not the surface over again.
    assert 2 * load_polygons(folder / "control.ply").num_verts < load_polygons(folder / "result.ply").num_verts


@pytest.mark.parametrize(
    ("scheme", "changes", "options"),
    [
        ("catmull-clark", {"write_frame": "normalised"}, ()),
        ("loop", {"write_frame": "normalised"}, ()),
        ("loop", {"fit": {"limit": True}}, ("--limit",)),
        ("sqrt2", {"source": {"mesh": "cube", "levels": 2}}, ()),
        ("doo-sabin", {"fit": {"connectivity": "remeshed", "verts": 100}}, ()),
        ("interp-loop", {"fit": {"connectivity": "remeshed", "verts": 100}}, ()),
        ("kobbelt", {"fit": {"levels": 0}}, ()),
    ],
    ids=[
        "normalised frame",
        "triangles in the normalised frame",
        "limit",
        "refined",
        "remeshed",
        "triangles remeshed",
        "coarse",
    ],
)
def test_in_either_frame_and_with_other_settings(tmp_path, scheme, changes, options):
    changes = {"source": {"mesh": "cube", "levels": 1, "radius": 0.5}} | changes
    changes["fit"] = FIT | changes.get("fit", {})
    folder = trial_folder(tmp_path, scheme, **changes)
    require_refinement(folder, scheme, "-n", changes["fit"]["levels"], *options)


@pytest.mark.filterwarnings("ignore::meshfit.errors.MeshfitWarning")  # the files are of open surfaces
@each("scheme", ["catmull-clark", "doo-sabin", "interp-sqrt2", "interp-ternary"], ("catmull-clark", "interp-ternary"))
@over("make", [lambda: quad_patch(5, 4), two_quads_that_share_two_edges])
def test_open_surfaces_and_interior_vertices_of_valence_2(tmp_path, scheme, make):
    if scheme == "interp-ternary" and make is two_quads_that_share_two_edges:
        return  # for regular meshes only
    save_mesh(make(), tmp_path / "source.obj")
    source = {"mesh": str(tmp_path / "source.obj"), "levels": 0, "radius": 0.5}
    require_refinement(trial_folder(tmp_path, scheme, source=source, fit=FIT), scheme, "-n", 2)


@over(
    ("make", "scheme", "kind"),
    [
        (quad_cube, "catmull-clark", PolygonMesh),
        (cube, "catmull-clark", Mesh),
        (quad_cube, "loop", Mesh),
        (cube, "loop", Mesh),
    ],
)
def test_the_control_mesh_of_a_fit_from_python(make, scheme, kind):
    mesh = make()
    result = fit(mesh.with_verts(0.5 * mesh.verts), octahedron(), scheme=scheme, device="cpu", **FIT)
    assert type(result.control) is kind
    fine = subdivide(result.control, scheme, 2)
    expected = result.mesh if result.polygons is None else result.polygons
    np.testing.assert_allclose(fine.verts, expected.verts, rtol=0, atol=1e-6)
    assert [started_at_least(row) for row in face_rows(fine)] == [started_at_least(r) for r in face_rows(expected)]
