"""Meshes in any form: all forms give the same mesh, and anything else is refused in one line."""

import numpy as np
import pytest
import torch
import trimesh

import meshfit
from meshfit.errors import MeshError
from meshfit.mesh.any_mesh import as_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import cube, octahedron, quad_cube
from tests.loops import over

VERTS, FACES = octahedron().verts, octahedron().faces
QUADS = quad_cube().corners.reshape(-1, 4)


class PyvistaLike:
    def __init__(self, verts, padded):
        self.points, self.faces = verts, padded


class Open3dLike:
    vertices, triangles = VERTS, FACES


TRIANGLE_FORMS = {
    "a Mesh": octahedron(),
    "arrays": (VERTS, FACES),
    "a list of arrays": [VERTS, FACES],
    "lists": (VERTS.tolist(), FACES.tolist()),
    "unsigned": (VERTS.astype(np.float32), FACES.astype(np.uint32)),
    "tensors": (torch.tensor(VERTS, requires_grad=True), torch.tensor(FACES)),
    "trimesh": trimesh.Trimesh(VERTS, FACES, process=False),
    "pyvista": PyvistaLike(VERTS, np.insert(FACES, 0, 3, axis=1).reshape(-1)),
    "Open3D": Open3dLike,
    "a name": "octahedron",
}


@over("form", TRIANGLE_FORMS.values(), ids=TRIANGLE_FORMS)
def test_every_form_of_triangles_gives_the_same_mesh(form):
    mesh = as_mesh(form)
    assert type(mesh) is Mesh
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_allclose(mesh.verts, VERTS, rtol=0, atol=1e-7)


QUAD_FORMS = {
    "a PolygonMesh": quad_cube(),
    "rows of four": (cube().verts, QUADS),
    "pyvista": PyvistaLike(cube().verts, np.insert(QUADS, 0, 4, axis=1).reshape(-1)),
    "a name": "cube",
}


@over("form", QUAD_FORMS.values(), ids=QUAD_FORMS)
def test_every_form_of_quads_gives_the_same_polygons_or_its_triangles(form):
    mesh = as_mesh(form)
    assert face_rows(mesh) == QUADS.tolist()
    triangles = as_mesh(form, triangles=True)
    assert type(triangles) is Mesh
    assert triangles.num_faces == 12


def test_faces_of_several_sizes_stay_as_they_are():
    house = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]]
    rows = [[0, 1, 2, 3], [3, 2, 4]]
    padded = np.array([4, 0, 1, 2, 3, 3, 3, 2, 4])
    for form in ((house, rows), PyvistaLike(np.array(house), padded)):
        assert face_rows(as_mesh(form)) == rows


def test_pyvista_itself_is_taken_with_its_polygons():
    pyvista = pytest.importorskip("pyvista")
    assert as_mesh(pyvista.Cube().clean()).num_faces == 6
    assert as_mesh(pyvista.Sphere()).num_faces == pyvista.Sphere().n_cells
    with pytest.raises(MeshError, match=r"pyvista ImageData; give its extract_surface\(\)"):
        as_mesh(pyvista.ImageData())


def test_paths_names_and_results_are_taken_by_every_door(tmp_path):
    path = tmp_path / "octahedron.ply"
    meshfit.save_mesh((VERTS, FACES), path)
    for form in (path, str(path), "octahedron", trimesh.Trimesh(VERTS, FACES, process=False)):
        assert meshfit.subdivide(form, "loop").num_faces == 32
        assert meshfit.refine(form, "loop").num_fine == 18
        assert meshfit.frame_of(form, "box").scale == pytest.approx(2 * 3**0.5)
        assert meshfit.creases_by_angle(form, 60).sharpness.shape == (12,)
        assert meshfit.loop_limit(form).shape == (6, 6)
        assert meshfit.loop_limit_normals(form).shape == (6, 3)
        assert meshfit.Problem(form, form).target.num_faces == 8
    result = meshfit.fit(path, "icosahedron", steps=2, samples=100, losses={"edge": 0.0}, device="cpu")
    meshfit.save_mesh(result, tmp_path / "result.obj")
    assert meshfit.load_mesh(tmp_path / "result.obj").num_faces == 8
    assert meshfit.measure(result, result.target, samples=100, points=100).quality.faces == 8


def test_a_file_gives_the_kind_of_faces_that_the_scheme_refines(tmp_path):
    meshfit.save_mesh("cube", tmp_path / "cube.obj")
    assert meshfit.subdivide(tmp_path / "cube.obj", "loop").num_faces == 48
    assert meshfit.subdivide(tmp_path / "cube.obj", "catmull-clark").num_faces == 24


REFUSED = {
    "None": (None, "got None"),
    "a dict": ({"verts": VERTS, "faces": FACES}, r"got a dict \(verts, faces\); give \(verts, faces\)"),
    "a number": (3, "got an int"),
    "vertices alone": (VERTS, r"got an array of shape \(6, 3\); give it with its faces"),
    "three parts": ((VERTS, FACES, FACES), r"expected a pair \(verts, faces\), got a tuple of ndarray"),
    "flat verts": ((VERTS[:, :2], FACES), r"verts: expected rows of three numbers, got an array of shape \(6, 2\)"),
    "text verts": (([["a", "b", "c"]], FACES), "verts: expected rows of three numbers, got an array of type <U1"),
    "float faces": ((VERTS, FACES * 1.0), "faces: expected vertex numbers, which are integers, got float64$"),
    "swapped": ((FACES, VERTS), r"look swapped: give \(verts, faces\)"),
    "out of range": ((VERTS, FACES + 3), "face 0 has vertex 7, but vertices are numbered 0 to 5$"),
    "from one": ((VERTS, FACES + 1), "yours begin at 1: subtract 1"),
    "negative": ((VERTS, FACES - 1), "face 0 has vertex -1"),
    "a Mesh out of range": (Mesh(VERTS, FACES + 3), "face 0 has vertex 7"),
    "two corners": ((VERTS, FACES[:, :2]), "face 0: expected 3 or more corners, got 2"),
    "flat faces": ((VERTS, [0, 1, 2]), r"faces: expected rows of vertex numbers, .*got an array of shape \(3,\)"),
    "a bad row": ((VERTS, [[0, 1, 2], [0, 1, 2.5, 3]]), "face 1: expected a row of vertex numbers"),
    "not finite": ((np.where(VERTS > 0, np.nan, VERTS), FACES), "vertex 0 has a coordinate that is not finite"),
    "curves": (meshfit.Curves.through(VERTS), "curves have no faces"),
    "a scene": (trimesh.Scene(), r"got a trimesh Scene; give its to_mesh\(\)"),
    "points": (trimesh.PointCloud(VERTS), "got a trimesh PointCloud; it has no faces"),
    "no such name": ("buny", "did you mean 'bunny'"),
}


@over(("form", "message"), REFUSED.values(), ids=REFUSED)
def test_anything_else_is_refused_in_one_line(form, message):
    for take in (as_mesh, lambda form: meshfit.save_mesh(form, "never.ply")):
        with pytest.raises(MeshError, match=message) as caught:
            take(form)
        assert "\n" not in str(caught.value)


def test_arguments_in_the_wrong_order_are_told():
    with pytest.raises(MeshError, match=r"got an Mesh|got a Mesh; the order is save_mesh\(mesh, path\)"):
        meshfit.save_mesh("octahedron", octahedron())
    with pytest.raises(MeshError, match="expected Curves, got Mesh; save_mesh writes meshes"):
        meshfit.save_curves(octahedron(), "curves.obj")
    with pytest.raises(MeshError, match=r"^source: expected .*got None"):
        meshfit.fit(None, octahedron())
    with pytest.raises(MeshError, match=r"^source: 'spher' is neither a name nor a file: did you mean 'sphere'\?"):
        meshfit.fit("spher", octahedron())
    with pytest.raises(MeshError, match=r"^target: expected .*got None"):
        meshfit.measure(octahedron(), None)


@over(
    ("thing", "text"),
    [
        (octahedron(), "Mesh(6 verts, 8 faces, box 2 × 2 × 2)"),
        (Mesh([], []), "Mesh(0 verts, 0 faces)"),
        (quad_cube(), "PolygonMesh(8 verts, 6 quads, box 1.155 × 1.155 × 1.155)"),
        (PolygonMesh.of(octahedron()), "PolygonMesh(6 verts, 8 triangles, box 2 × 2 × 2)"),
        (
            PolygonMesh(np.eye(5)[:, :3], [0, 1, 2, 3, 4], [5]),
            "PolygonMesh(5 verts, 1 face of 5 corners, box 1 × 1 × 1)",
        ),
        (PolygonMesh([], [], []), "PolygonMesh(0 verts, 0 faces)"),
        (meshfit.Curves.through(np.eye(3)), "Curves(3 verts, 1 chain, 2 segments)"),
        (meshfit.Frame((1 / 3, 0.0, -2.0), 1e4 / 3), "Frame(centre=(0.333333, 0, -2), scale=3333.33)"),
        (meshfit.creases_by_angle(octahedron(), 60), "Creases(12 sharp edges of 12, 0 corners)"),
        (meshfit.Trace(), f"Trace(0 rows: {', '.join(meshfit.Trace().columns)})"),
    ],
)
def test_reprs_are_short_and_say_what_counts(thing, text):
    assert repr(thing) == text
