"""Doo–Sabin against pymeshlab, and Catmull–Clark, Doo–Sabin and √2 against plain twins.

pymeshlab's Catmull–Clark has other vertex weights.
"""

import numpy as np
import pymeshlab
from scipy.spatial import cKDTree

from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.refine import subdivide
from tests.laws.naive import same_face_sets
from tests.loops import over
from tests.quads import VALENCE_2, lens, mixed, prism, quad_cube, quad_patch, quad_torus, quad_wheel

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


# The two faces of a lens have one mean, so that positions do not tell vertices apart.
APART = {name: make for name, make in VALENCE_2.items() if name not in ("pillow", "lens of 5")}


@over("make", (CLOSED | OPEN | APART).values())
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


def doo_sabin_twin(mesh: PolygonMesh) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Doo and Sabin's rules on a closed mesh; a vertex of two faces leaves an edge in place of a face."""
    faces = face_rows(mesh)
    name = {corner: k for k, corner in enumerate((f, v) for f, face in enumerate(faces) for v in face)}
    left = {(a, b): f for f, face in enumerate(faces) for a, b in zip(face, face[1:] + face[:1], strict=True)}
    before = {(f, b): a for (a, b), f in left.items()}
    verts = []
    for face in faces:
        n = len(face)
        for k in range(n):
            weights = [(3 + 2 * np.cos(2 * np.pi * (i - k) / n)) / (4 * n) + (i == k) / 4 for i in range(n)]
            verts.append(sum(w * mesh.verts[v] for w, v in zip(weights, face, strict=True)))
    fine = [tuple(name[f, v] for v in face) for f, face in enumerate(faces)]
    fine += [(name[f, b], name[f, a], name[left[b, a], a], name[left[b, a], b]) for (a, b), f in left.items() if a < b]
    for v in range(mesh.num_verts):
        ring = [next(f for f, face in enumerate(faces) if v in face)]
        while (following := left[v, before[ring[-1], v]]) != ring[0]:
            ring.append(following)
        fine += [tuple(name[f, v] for f in ring)] if len(ring) > 2 else []
    return np.array(verts), fine


def sqrt2_twin(mesh: PolygonMesh) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """The rules of √2 on a closed mesh: a quad for every edge, with the means of its two faces as corners."""
    faces = face_rows(mesh)
    left = {(a, b): f for f, face in enumerate(faces) for a, b in zip(face, face[1:] + face[:1], strict=True)}
    near = [[b for a, b in left if a == v] for v in range(mesh.num_verts)]
    verts = [(point + mesh.verts[ring].mean(axis=0)) / 2 for point, ring in zip(mesh.verts, near, strict=True)]
    verts += [mesh.verts[face].mean(axis=0) for face in faces]
    first = mesh.num_verts
    return np.array(verts), [(a, first + left[b, a], b, first + f) for (a, b), f in left.items() if a < b]


CLOSED_AT_2 = ("pillow", "lens of 5", "cut torus", "merged", "cube with a vertex in an edge")
TWINS = {"doo-sabin": doo_sabin_twin, "sqrt2": sqrt2_twin}


@over("scheme", TWINS)
@over("make", [*CLOSED.values(), *(VALENCE_2[name] for name in CLOSED_AT_2)])
@over("levels", [1, 2])
def test_doo_sabin_and_sqrt2(scheme, make, levels):
    """Vertices come in the order of corners, and of old vertices and faces; so do those of the twins."""
    mesh = make()
    for _ in range(levels):
        ours, (verts, rows) = subdivide(mesh, scheme), TWINS[scheme](mesh)
        np.testing.assert_allclose(ours.verts, verts, rtol=0, atol=1e-14)
        assert same_face_sets(rows, [tuple(row) for row in face_rows(ours)])
        mesh = ours


def test_a_pillow_becomes_a_cube_under_doo_sabin():
    fine = PolygonTopology.of(subdivide(VALENCE_2["pillow"](), "doo-sabin"))
    assert (fine.num_verts, fine.num_edges, fine.sizes.tolist()) == (8, 12, [4] * 6)
    assert fine.valence.tolist() == [3] * 8


@over("scheme", [spec for spec in POLYGON_SCHEMES if "ternary" not in spec])
@over("sides", [4, 6])
def test_a_symmetric_lens_stays_symmetric(scheme, sides):
    """Turned by one side and mirrored between its faces, a lens of an even number of sides lies where it was."""
    mesh, turn = lens(sides), 2 * np.pi / sides
    symmetry = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, -1]])
    fine = subdivide(mesh, scheme, 3)
    assert cKDTree(fine.verts).query(fine.verts @ symmetry)[0].max() < 1e-13
