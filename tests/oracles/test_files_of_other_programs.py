"""Files that other programs write are read as the mesh that was written, and they read ours."""

import igl
import numpy as np
import pymeshlab
import pytest
import trimesh

from meshfit.mesh.io.files import load_mesh, load_polygons, save_mesh
from meshfit.mesh.mesh import Mesh
from tests.loops import over
from tests.quads import mixed
from tests.shapes import CLOSED

SHAPE = CLOSED["mixed"]()
SINGLE = Mesh(SHAPE.verts.astype(np.float32), SHAPE.faces)


def corners(mesh):
    """The corners of each face, turned so that the smallest comes first, the faces in order."""
    rounds = [np.roll(mesh.verts[mesh.faces], turn, axis=1).reshape(-1, 9).tolist() for turn in range(3)]
    return np.array(sorted(min(turns) for turns in zip(*rounds, strict=True)))


def with_trimesh(path, **options):
    mesh = trimesh.Trimesh(SINGLE.verts, SINGLE.faces, process=False)
    if options.pop("colours", False):
        mesh.visual.vertex_colors = np.arange(4 * len(mesh.vertices)).reshape(-1, 4) % 256
    if options.pop("face_colours", False):
        mesh.visual.face_colors = np.arange(4 * len(mesh.faces)).reshape(-1, 4) % 256
    content = mesh.export(file_type=options.pop("kind", path.suffix[1:]), **options)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def with_meshlab(path, **options):
    meshes = pymeshlab.MeshSet()
    names = ("v_color_matrix", "v_normals_matrix", "v_scalar_array", "f_color_matrix", "f_normals_matrix")
    values = (np.full((SINGLE.num_verts, 4), 0.5), SINGLE.verts, np.arange(SINGLE.num_verts) / 3.0)
    faces = (np.full((SINGLE.num_faces, 4), 0.25), np.ones((SINGLE.num_faces, 3)))
    meshes.add_mesh(pymeshlab.Mesh(SINGLE.verts, SINGLE.faces, **dict(zip(names, values + faces, strict=True))))
    meshes.save_current_mesh(str(path), **options)


def with_igl(path, **_):
    igl.write_triangle_mesh(str(path), SINGLE.verts, SINGLE.faces)


def with_vtk(path, *, text=False):
    pyvista = pytest.importorskip("pyvista")
    pyvista.PolyData.from_regular_faces(SINGLE.verts, SINGLE.faces).save(path, binary=not text)


EVERYTHING = {"save_vertex_color": True, "save_vertex_quality": True, "save_face_color": True}
WRITERS = [
    ("a.obj", with_trimesh, {"include_normals": True}),
    ("a.obj", with_trimesh, {"colours": True}),
    ("a.ply", with_trimesh, {"encoding": "ascii", "vertex_normal": True, "colours": True}),
    ("a.ply", with_trimesh, {"vertex_normal": True, "face_colours": True}),
    ("a.stl", with_trimesh, {}),
    ("a.stl", with_trimesh, {"kind": "stl_ascii"}),
    ("a.off", with_trimesh, {}),
    ("a.obj", with_meshlab, {"save_vertex_color": True, "save_vertex_normal": True}),
    ("a.ply", with_meshlab, EVERYTHING),
    ("a.ply", with_meshlab, {"binary": False, **EVERYTHING}),
    ("a.stl", with_meshlab, {}),
    ("a.stl", with_meshlab, {"binary": False}),
    ("a.off", with_meshlab, {"save_vertex_color": True, "save_face_color": True}),
    ("a.obj", with_igl, {}),
    ("a.off", with_igl, {}),
    ("a.ply", with_igl, {}),
    ("a.stl", with_igl, {}),
    ("a.ply", with_vtk, {}),
    ("a.ply", with_vtk, {"text": True}),
    ("a.stl", with_vtk, {}),
    ("a.stl", with_vtk, {"text": True}),
    ("a.obj", with_vtk, {}),
]


@over(("name", "write", "options"), WRITERS)
def test_files_of_other_programs(tmp_path, name, write, options):
    write(tmp_path / name, **options)
    found = load_mesh(tmp_path / name, attributes=False)
    assert (found.num_verts, found.num_faces) == (SINGLE.num_verts, SINGLE.num_faces)
    np.testing.assert_allclose(corners(found), corners(SINGLE), rtol=1e-5, atol=1e-6)


@over("suffix", [".obj", ".ply", ".off", ".stl"])
def test_other_programs_read_ours(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    save_mesh(SHAPE, path)
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    found = meshes.current_mesh()
    of_trimesh = trimesh.load_mesh(path, process=False)
    parts = [
        (found.vertex_matrix(), found.face_matrix()),
        igl.read_triangle_mesh(str(path)),
        (of_trimesh.vertices, of_trimesh.faces),
    ]
    for verts, faces in parts:
        np.testing.assert_allclose(corners(Mesh(verts, faces)), corners(SHAPE), rtol=1e-5, atol=1e-6)


def test_polygons_that_meshlab_reads_and_writes(tmp_path):
    mesh = mixed()
    for suffix in (".obj", ".off", ".ply"):
        save_mesh(mesh, tmp_path / f"a{suffix}")
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(tmp_path / f"a{suffix}"))
        meshes.save_current_mesh(str(tmp_path / "b.obj"))
        found = load_polygons(tmp_path / "b.obj")
        assert found.num_verts == mesh.num_verts
        assert suffix == ".ply" or sorted(found.sizes.tolist()) == sorted(mesh.sizes.tolist())
