"""Doo–Sabin against pymeshlab, and Catmull–Clark against a plain twin: pymeshlab's has other vertex weights."""

import numpy as np
import pymeshlab
from scipy.spatial import cKDTree

from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import icosahedron
from meshfit.subdivision.refine import subdivide
from tests.laws.naive import same_face_sets
from tests.loops import over
from tests.quads import mixed, prism, quad_cube, quad_patch, quad_torus, quad_wheel

CLOSED = {
    "cube": quad_cube,
    "torus": lambda: quad_torus(6, 5),
    "prism of 3": lambda: prism(3),
    "prism of 5": lambda: prism(5),
    "mixed": mixed,
}
OPEN = {
    "mixed open": lambda: mixed(closed=False),
    "patch": lambda: quad_patch(5, 4),
    "wheel": lambda: quad_wheel(5, 2),
    "one quad": lambda: quad_patch(2, 2),
}


EQUAL = {name: CLOSED[name] for name in ("cube", "prism of 3", "prism of 5")} | {"icosahedron": icosahedron}


@over("make", EQUAL.values())
def test_doo_sabin_is_pymeshlabs(make):
    """In single precision, as triangles, so that only vertices can be compared.

    Only on triangles and affine images of regular polygons: pymeshlab takes the mean of a corner and the face,
    which is Doo and Sabin's rule there and nowhere else. On meshes of mixed valence it may never return.
    """
    mesh = PolygonMesh.of(make())
    meshes = pymeshlab.MeshSet()
    faces = [np.array(row, dtype=np.uint32) for row in face_rows(mesh)]
    meshes.add_mesh(pymeshlab.Mesh(mesh.verts, face_list_of_indices=faces))
    meshes.apply_filter("meshing_surface_subdivision_doo_sabin", iterations=1)
    theirs, ours = meshes.current_mesh().vertex_matrix(), subdivide(mesh, "doo-sabin").verts
    assert len(theirs) == len(ours)
    assert cKDTree(ours).query(theirs)[0].max() < 3e-7 * max(1, np.abs(mesh.verts).max())
    assert cKDTree(theirs).query(ours)[0].max() < 3e-7 * max(1, np.abs(mesh.verts).max())


def twin(mesh: PolygonMesh) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Catmull and Clark's rules, face by face, with Loop's rules for the boundary."""
    points, faces = mesh.verts, face_rows(mesh)
    left = {(a, b): f for f, face in enumerate(faces) for a, b in zip(face, face[1:] + face[:1], strict=True)}
    centre = [points[face].mean(axis=0) for face in faces]
    rim = {a: b for a, b in left if (b, a) not in left}
    back = {b: a for a, b in rim.items()}
    verts = []
    for v in range(mesh.num_verts):
        out = [(a, b) for a, b in left if a == v]
        n = len(out)
        if v in rim:
            verts.append((points[back[v]] + 6 * points[v] + points[rim[v]]) / 8)
            continue
        around = sum(centre[left[edge]] for edge in out) / n
        middles = sum((points[a] + points[b]) / 2 for a, b in out) / n
        verts.append((around + 2 * middles + (n - 3) * points[v]) / n)
    middle = {}
    for a, b in left:
        if (b, a) in middle:
            middle[a, b] = middle[b, a]
            continue
        middle[a, b] = len(verts)
        ends = points[a] + points[b]
        inner = (b, a) in left
        verts.append((ends + centre[left[a, b]] + centre[left[b, a]]) / 4 if inner else ends / 2)
    first = len(verts)
    quads = [
        (v, middle[v, face[(k + 1) % len(face)]], first + f, middle[face[k - 1], v])
        for f, face in enumerate(faces)
        for k, v in enumerate(face)
    ]
    return np.array(verts + centre), quads


@over("make", (CLOSED | OPEN).values())
@over("levels", [1, 2])
def test_catmull_clark(make, levels):
    mesh, ours = make(), subdivide(make(), "catmull-clark", levels)
    for _ in range(levels):
        verts, quads = twin(mesh)
        mesh = PolygonMesh(verts, np.array(quads).reshape(-1), [4] * len(quads))
    distance, name = cKDTree(ours.verts).query(mesh.verts)
    assert distance.max() < 1e-14 * max(1, np.abs(mesh.verts).max()) * 10
    assert len(np.unique(name)) == mesh.num_verts == ours.num_verts
    found = [tuple(int(name[v]) for v in row) for row in face_rows(mesh)]
    assert same_face_sets(found, [tuple(row) for row in face_rows(ours)])
