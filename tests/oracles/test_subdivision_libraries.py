"""Subdivision by other libraries, each where it is known to follow the same rules.

Valid are: Loop by pymeshlab (all edges split only at threshold 0) on any mesh, by trimesh on closed ones (its boundary
rows sum to more than one where an inner edge joins two boundary verts), by libigl with Warren's weights on any, by VTK
in single precision. The plain butterfly by pymeshlab on closed meshes: its boundary rule is not linear-exact, and it
does nothing special at extraordinary verts. The modified butterfly by VTK on closed meshes. Linear subdivision by all.
Verts come in other orders, so results are matched by place, and then faces are compared under that matching.
"""

import igl
import numpy as np
import pymeshlab
import pytest
import trimesh
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import SOLIDS
from meshfit.subdivision.refine import subdivide
from tests.loops import over
from tests.shapes import mixed_closed, mixed_open, opened, patch, real, torus, without_faces


def opened_cow() -> Mesh:
    """A cow with two holes; the second is of a single face."""
    cow = opened(real("cow", 700), 10)
    return without_faces(cow, np.array([cow.num_faces - 1]))


CLOSED = {
    **SOLIDS,
    "torus": torus,
    "mixed": mixed_closed,
    "cow": lambda: real("cow", 700),
    "mousehead": lambda: real("mousehead", 500),
}
OPEN = {"patch": lambda: patch(5, 4), "mixed": mixed_open, "cow with holes": opened_cow}
closed = over("make", CLOSED.values())
any_mesh = over("make", [*CLOSED.values(), *OPEN.values()])


def assert_same_surface(ours: Mesh, verts: np.ndarray, faces: np.ndarray, tolerance: float) -> None:
    """Equal verts, matched one to one by place, and equal faces, wherever their rows start."""
    assert (ours.num_verts, ours.num_faces) == (len(verts), len(faces))
    size = np.ptp(ours.verts, axis=0).max()
    distance, name = cKDTree(ours.verts).query(verts)
    assert distance.max() < tolerance * size
    assert len(np.unique(name)) == len(verts)
    assert started_at_least(name[faces]) == started_at_least(ours.faces)


def started_at_least(faces: np.ndarray) -> set[tuple[int, ...]]:
    first = np.argmin(faces, axis=1)[:, None]
    return set(map(tuple, np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1).tolist()))


def by_pymeshlab(mesh: Mesh, kind: str, levels: int) -> tuple[np.ndarray, np.ndarray]:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.array(mesh.verts), np.array(mesh.faces)))
    options = {"loopweight": "Loop"} if kind == "loop" else {}
    subdivision = getattr(meshes, f"meshing_surface_subdivision_{kind}")
    subdivision(iterations=levels, threshold=pymeshlab.PercentageValue(0), selected=False, **options)
    found = meshes.current_mesh()
    return found.vertex_matrix(), found.face_matrix()


def by_vtk(mesh: Mesh, kind: str, levels: int) -> tuple[np.ndarray, np.ndarray]:
    pyvista = pytest.importorskip("pyvista")
    rows = np.column_stack([np.full(mesh.num_faces, 3), mesh.faces])
    found = pyvista.PolyData(np.array(mesh.verts), rows.reshape(-1)).subdivide(levels, kind)
    return np.asarray(found.points, dtype=np.float64), found.faces.reshape(-1, 4)[:, 1:].astype(np.int64)


@any_mesh
@over("levels", [1, 2])
def test_loop_is_pymeshlabs(make, levels):
    mesh = make()
    assert_same_surface(subdivide(mesh, "loop", levels), *by_pymeshlab(mesh, "loop", levels), 1e-14)


@closed
@over("levels", [1, 2])
def test_loop_is_trimeshs(make, levels):
    mesh = make()
    found = trimesh.remesh.subdivide_loop(np.array(mesh.verts), np.array(mesh.faces), iterations=levels)
    assert_same_surface(subdivide(mesh, "loop", levels), *found, 1e-14)


@any_mesh
@over("levels", [1, 2])
def test_loop_with_warrens_weights_is_libigls(make, levels):
    mesh = make()
    found = igl.loop(np.array(mesh.verts), np.array(mesh.faces), levels)
    assert_same_surface(subdivide(mesh, "loop:weights=warren", levels), *found, 1e-14)


def test_libigl_tells_the_two_kinds_of_weights_apart():
    """At valence 4 and 5 they differ: without this, the comparisons above could not."""
    for solid in ("octahedron", "icosahedron"):
        mesh = SOLIDS[solid]()
        verts, _ = igl.loop(np.array(mesh.verts), np.array(mesh.faces), 1)
        assert cKDTree(subdivide(mesh, "loop").verts).query(verts)[0].max() > 0.01


@any_mesh
def test_loop_is_vtks(make):
    mesh = make()
    assert_same_surface(subdivide(mesh, "loop", 2), *by_vtk(mesh, "loop", 2), 1e-6)


@closed
@over("levels", [1, 2])
def test_plain_butterfly_is_pymeshlabs(make, levels):
    mesh = make()
    assert_same_surface(subdivide(mesh, "butterfly", levels), *by_pymeshlab(mesh, "butterfly", levels), 1e-14)


@closed
@over("levels", [1, 2])
def test_modified_butterfly_is_vtks(make, levels):
    mesh = make()
    assert_same_surface(subdivide(mesh, "modified-butterfly", levels), *by_vtk(mesh, "butterfly", levels), 1e-6)


@any_mesh
@over("levels", [1, 2])
@pytest.mark.parametrize("library", ["trimesh", "libigl", "pymeshlab", "vtk"])
def test_midpoint_is_everybodys(make, levels, library):
    mesh = make()
    verts, faces = np.array(mesh.verts), np.array(mesh.faces)
    if library == "trimesh":
        found = (verts, faces)
        for _ in range(levels):
            found = trimesh.remesh.subdivide(*found)
    elif library == "libigl":
        found = igl.upsample(verts, faces, levels)
    elif library == "vtk":
        found = by_vtk(mesh, "linear", levels)
    else:
        found = by_pymeshlab(mesh, "midpoint", levels)
    assert_same_surface(subdivide(mesh, "midpoint", levels), *found, 1e-6 if library == "vtk" else 1e-14)


@any_mesh
@pytest.mark.parametrize("spec", ["interp-loop", "interp-loop:valence3=zorin", "modified-butterfly"])
def test_interpolating_schemes_share_verts_and_faces_with_the_others(make, spec):
    """No library has interpolatory Loop; that its faces and old verts are right, the linear ones tell."""
    mesh = make()
    fine = subdivide(mesh, spec)
    verts, faces = trimesh.remesh.subdivide(np.array(mesh.verts), np.array(mesh.faces))
    linear = subdivide(mesh, "midpoint")
    assert_same_surface(Mesh(linear.verts, fine.faces), verts, faces, 1e-14)
    assert np.array_equal(fine.verts[: mesh.num_verts], mesh.verts)
