"""Attributes through subdivision: constants, positions, linear functions, parents, labels, skins and seams."""

import warnings
from contextlib import nullcontext

import numpy as np
import pytest

from meshfit.errors import MeshfitWarning
from meshfit.mesh.attributes import Attributes, Material
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.creases import Creases
from meshfit.subdivision.limit import loop_limit, on_loop_limit
from meshfit.subdivision.refine import refine, subdivide
from meshfit.subdivision.registry import SCHEMES, SURFACES
from tests.loops import over
from tests.quads import quad_patch, quad_torus
from tests.shapes import mixed_closed, patch, torus

NAMES = [name for name, entry in SCHEMES.items() if entry.domain in SURFACES]
CUTTING = {"sqrt3", "lin-luo-sqrt3", "interp-sqrt3", "doo-sabin", "sqrt2", "interp-sqrt2"}
WITHIN_FACES = [name for name in NAMES if name not in CUTTING]
# Next to a boundary that is linear instead of by their own rule, these have other values one vertex further in.
SEAM_FELT = {"interp-catmull-clark", "kobbelt", "ternary", "interp-ternary"}


def coarse(name: str, *, closed: bool = True) -> Mesh | PolygonMesh:
    """A small regular mesh of the scheme's domain; flat if it is open."""
    if SCHEMES[name].domain == "triangles":
        return torus(7, 6) if closed else patch(6, 5)
    return quad_torus(7, 6) if closed else quad_patch(6, 5)


def corners_of(mesh: Mesh | PolygonMesh) -> np.ndarray:
    return PolygonMesh.of(mesh).corners


def carrying(mesh, **attributes):
    return mesh.with_attributes(Attributes(**attributes))


def random_rows(count: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, width))


@over("name", NAMES)
def test_geometry_is_the_same_with_and_without(name):
    mesh = coarse(name)
    dressed = carrying(
        mesh,
        vertex={"heat": random_rows(mesh.num_verts, 1)},
        face={"group": np.arange(mesh.num_faces)},
        corner={"uv": mesh.verts[corners_of(mesh)][:, :2]},
        groups=tuple(map(str, range(mesh.num_faces))),
    )
    plain, fine = subdivide(mesh, name, 2), subdivide(dressed, name, 2)
    assert plain.verts.tobytes() == fine.verts.tobytes()
    assert corners_of(plain).tobytes() == corners_of(fine).tobytes()
    assert not plain.attributes
    assert fine.attributes.groups == dressed.attributes.groups


@over("name", NAMES)
def test_vertex_data_equal_to_positions_refine_to_positions_and_corners_with_them(name):
    for closed in (True, False):
        mesh = coarse(name, closed=closed)
        corners = corners_of(mesh)
        dressed = carrying(mesh, vertex={"rest": mesh.verts}, corner={"uv": mesh.verts[corners]})
        fine = subdivide(dressed, name, 2)
        assert np.array_equal(fine.attributes.vertex["rest"], fine.verts)
        assert np.array_equal(fine.attributes.corner["uv"], fine.verts[corners_of(fine)])


@over("name", NAMES)
def test_constants_stay(name):
    mesh = coarse(name)
    num_corners = len(corners_of(mesh))
    color, joints = np.tile(np.uint8([250, 3, 77, 255]), (mesh.num_verts, 1)), np.tile([4, 1], (mesh.num_verts, 1))
    dressed = carrying(
        mesh,
        vertex={
            "color": color,
            "label": np.full(mesh.num_verts, 7),
            "joints": joints.astype(np.uint16),
            "weights": np.tile(np.float32([0.75, 0.25]), (mesh.num_verts, 1)),
        },
        face={"material": np.full(mesh.num_faces, 1)},
        corner={"uv": np.full((num_corners, 2), 0.3, dtype=np.float32)},
        materials=(Material("a"), Material("b")),
    )
    found = subdivide(dressed, name, 2).attributes
    for rows, expected in (
        (found.vertex["color"], color[0]),
        (found.vertex["label"], np.array(7)),
        (found.vertex["joints"], np.uint16([4, 1])),
        (found.face["material"], np.array(1)),
    ):
        assert rows.dtype == expected.dtype
        assert (rows == expected).all()
    assert found.corner["uv"].dtype == found.vertex["weights"].dtype == np.float32
    assert np.allclose(found.corner["uv"], 0.3)
    assert np.allclose(found.vertex["weights"], [0.75, 0.25])


@over("name", NAMES)
def test_faces_inherit_from_a_parent_that_they_lie_in_or_touch(name):
    mesh = coarse(name)
    dressed = carrying(mesh, face={"material": np.arange(mesh.num_faces)})
    fine = subdivide(dressed, name, 1)
    parent = fine.attributes.face["material"]
    topology = PolygonTopology.of(PolygonMesh.of(mesh))
    touched = np.zeros((mesh.num_verts, mesh.num_faces), dtype=bool)
    touched[topology.tail, topology.face] = True
    matrix = refine(Topology.of(mesh) if isinstance(mesh, Mesh) else topology, name, 1).matrix.toarray()
    polygons = PolygonMesh.of(fine)
    for face, start, size in zip(parent, polygons.starts, polygons.sizes, strict=True):
        weights = matrix[polygons.corners[start : start + size]].sum(axis=0) / size
        assert touched[np.argmax(weights), face] or weights[touched[:, face]].sum() > 0.5
    children = np.bincount(parent, minlength=mesh.num_faces)
    if name in WITHIN_FACES or "sqrt3" in name:  # each in as many as any other
        assert (children == children[0]).all()
    assert children.min() > 0 or name.endswith("sqrt2")


@pytest.mark.parametrize("levels", [1, 2])
@over("name", WITHIN_FACES)
def test_charts_do_not_see_each_other(name, levels):
    """Inside a chart, coordinates are those of the chart as a mesh of its own; along its seams, they are linear."""
    mesh = coarse(name)
    polygons = PolygonMesh.of(mesh)
    number = np.arange(mesh.num_faces)
    right = (number // 6 % 7 if isinstance(mesh, Mesh) else number % 7) >= 3  # columns of the lattice
    of_corner = np.repeat(right, polygons.sizes)
    uv = random_rows(mesh.num_verts, 2)[polygons.corners] + 10 * of_corner[:, None]
    fine = PolygonMesh.of(subdivide(carrying(mesh, face={"side": right}, corner={"uv": uv}), name, levels))
    found = fine.attributes.corner["uv"]
    for side in (False, True):
        chart = PolygonMesh(
            np.pad(random_rows(mesh.num_verts, 2) + 10 * side, ((0, 0), (0, 1))),
            polygons.corners[of_corner == side],
            polygons.sizes[right == side],
        )
        used = np.unique(chart.corners)
        chart = PolygonMesh(chart.verts[used], np.searchsorted(used, chart.corners), chart.sizes)
        own = Mesh(chart.verts, chart.corners.reshape(-1, 3)) if isinstance(mesh, Mesh) else chart
        linear = PolygonMesh.of(subdivide(own, linear_name(name), levels))
        fixed = {}
        if name == "interp-loop":
            topology = Topology.of(own)
            fixed = {"creases": Creases.of(topology, corners=np.flatnonzero(topology.boundary_verts))}
        twin = PolygonMesh.of(subdivide(own, name, levels, **fixed))
        mine = found[np.repeat(fine.attributes.face["side"] == side, fine.sizes)]
        assert len(mine) == len(twin.corners)
        topology = PolygonTopology.of(twin)
        seam = topology.boundary_verts[twin.corners]
        assert seam.any()
        assert np.allclose(mine[seam], linear.verts[linear.corners][seam, :2], atol=1e-12)
        if levels == 1 and name not in SEAM_FELT:  # later levels feel the seam
            assert np.allclose(mine[~seam], twin.verts[twin.corners][~seam, :2], atol=1e-12)


def linear_name(name: str):
    """Linear interpolation on the scheme's split."""
    from meshfit.subdivision.refine import linear_scheme
    from meshfit.subdivision.registry import resolve

    return linear_scheme(resolve(name))


@over("name", WITHIN_FACES)
def test_a_seam_around_a_torus_keeps_texture_linear_across_it(name):
    """Coordinates that jump by one across a seam stay where positions on the flat lattice put them."""
    mesh = coarse(name)
    polygons = PolygonMesh.of(mesh)
    i, j = polygons.corners % 7, polygons.corners // 7
    uv = np.stack([i, j], axis=1).astype(np.float64)
    for column, period in ((0, 7), (1, 6)):
        wraps = np.maximum.reduceat(uv[:, column], polygons.starts) - np.minimum.reduceat(
            uv[:, column], polygons.starts
        )
        low = np.repeat(wraps > period / 2, polygons.sizes) & (uv[:, column] < period / 2)
        uv[low, column] += period
    fine = PolygonMesh.of(subdivide(carrying(mesh, corner={"uv": uv}), name, 2))
    found = fine.attributes.corner["uv"]
    size = np.maximum.reduceat(found, fine.starts) - np.minimum.reduceat(found, fine.starts)
    part = 1 / 9 if "ternary" in name or name == "kobbelt-ternary" else 1 / 4
    assert np.allclose(size, part, atol=1e-9)  # all faces are one lattice cell divided evenly


@pytest.mark.parametrize("levels", [1, 2])
@over("name", sorted(CUTTING))
def test_schemes_that_make_faces_across_seams_end_coordinates_at_the_seam(name, levels):
    """On a flat patch with a jump of 10 in u at x = 2, each face has coordinates of one side, clamped there."""
    mesh = coarse(name, closed=False)
    polygons = PolygonMesh.of(mesh)
    middle = np.add.reduceat(mesh.verts[polygons.corners, 0], polygons.starts) / polygons.sizes
    right = np.repeat(middle > 2, polygons.sizes)
    uv = mesh.verts[polygons.corners, :2] + np.array([10.0, 0.0]) * right[:, None]
    silent = name.endswith("sqrt2") and levels == 2
    with nullcontext() if silent else pytest.warns(MeshfitWarning, match="this scheme makes faces across seams"):
        fine = PolygonMesh.of(subdivide(carrying(mesh, corner={"uv": uv}), name, levels))
    u, v = fine.attributes.corner["uv"].T
    x, y, _ = fine.verts[fine.corners].T
    on_right = u > 7
    face = np.repeat(np.arange(fine.num_faces), fine.sizes)
    assert (np.bincount(face[on_right], minlength=fine.num_faces) % np.bincount(face) == 0).all()
    assert u[~on_right].max() == 2
    assert u[on_right].min() >= 12
    inside = np.isin(face, np.flatnonzero(np.maximum.reduceat(np.abs(x - 2.5), fine.starts) < 1.5))
    clamped = np.where(on_right, np.maximum(x, 2) + 10, np.minimum(x, 2))
    assert np.abs(u - clamped)[inside].max() < 0.2
    assert np.abs(v - y)[inside & (np.abs(y - 2) < 0.5)].max() < 0.2


def test_a_dart_and_a_pole_stay_in_place():
    """A latitude–longitude chart: the pole has one value for each face, and the ring below it stays in its row."""
    around, rows = 8, 5
    u, v = np.meshgrid(np.arange(around), np.arange(1, rows), indexing="xy")
    angle, height = 2 * np.pi * u / around, np.pi * v / rows
    ring = np.stack([np.sin(height) * np.cos(angle), np.sin(height) * np.sin(angle), np.cos(height)], axis=2)
    verts = np.concatenate([[[0, 0, 1.0]], ring.reshape(-1, 3)])
    faces, uv = [], []
    for i in range(around):
        a, b = 1 + i, 1 + (i + 1) % around
        faces.append([0, a, b])
        uv += [[i + 0.5, 0], [i, 1], [i + 1, 1]]
        for k in range(rows - 2):
            c, d = a + around, b + around
            faces += [[a, c, d], [a, d, b]]
            uv += [[i, k + 1], [i, k + 2], [i + 1, k + 2], [i, k + 1], [i + 1, k + 2], [i + 1, k + 1]]
            a, b = c, d
    mesh = Mesh(verts, faces, Attributes(corner={"uv": np.array(uv, dtype=float)}))
    fine = subdivide(mesh, "loop", 1)
    rows_of = fine.attributes.corner["uv"]
    at_pole = rows_of[fine.faces.reshape(-1) == 0]
    assert (at_pole[:, 1] == 0).all()
    on_ring = rows_of[np.isin(fine.faces.reshape(-1), np.arange(1, 1 + around))]
    assert (on_ring[:, 1] == 1).all()
    assert np.array_equal(np.unique(on_ring[:, 0]), np.arange(around + 1))
    wide = rows_of.reshape(-1, 3, 2)
    assert np.ptp(wide, axis=1).max() < 0.6  # no face goes back across the whole image


def test_colours_are_clipped_and_labels_taken_from_the_nearest():
    mesh = torus(7, 6)
    black_and_white = random_rows(mesh.num_verts, 3).round()
    labels = np.arange(mesh.num_verts, dtype=np.int32)
    dressed = carrying(
        mesh,
        vertex={"color": black_and_white, "raw": black_and_white, "label": labels},
        corner={"color": (255 * black_and_white).astype(np.uint8)[corners_of(mesh)]},
    )
    found = subdivide(dressed, "butterfly", 1)
    assert found.attributes.vertex["raw"].min() < 0
    assert np.array_equal(found.attributes.vertex["color"], found.attributes.vertex["raw"].clip(0, 1))
    expected = np.rint(255 * found.attributes.vertex["raw"]).clip(0, 255)
    assert np.array_equal(found.attributes.corner["color"], expected[corners_of(found)])
    label = found.attributes.vertex["label"]
    assert np.array_equal(label[: mesh.num_verts], labels)
    matrix = refine(Topology.of(mesh), "butterfly", 1).matrix.toarray()
    assert np.allclose(matrix[np.arange(len(label)), label], matrix.max(axis=1))


def test_the_skin_keeps_the_strongest_joints():
    mesh = torus(7, 6)
    generator = np.random.default_rng(3)
    joints = np.stack([generator.permutation(9)[:4] for _ in range(mesh.num_verts)]).astype(np.uint8)
    weights = generator.dirichlet(np.ones(4), mesh.num_verts)
    fine = subdivide(carrying(mesh, vertex={"joints": joints, "weights": weights}), "butterfly", 2).attributes.vertex
    dense = np.zeros((mesh.num_verts, 9))
    dense[np.arange(mesh.num_verts)[:, None], joints] = weights
    expected = (refine(Topology.of(mesh), "butterfly", 2).matrix @ dense).clip(0)
    kept = np.sort(expected, axis=1)[:, ::-1][:, :4]
    assert np.allclose(fine["weights"], kept / kept.sum(axis=1, keepdims=True))
    rows = np.arange(len(expected))[:, None]
    assert np.allclose(expected[rows, fine["joints"]], kept)
    assert fine["joints"].dtype == np.uint8


def test_creases_hold_in_charts_too():
    """A seam away from a crease changes nothing near the crease."""
    mesh = torus(7, 6)
    edges = [(i + 7 * 3, (i + 1) % 7 + 7 * 3) for i in range(7)]
    creases = Creases.of(Topology.of(mesh), edges)
    values = mesh.verts[corners_of(mesh)]
    cut = values.copy()
    cut[0] += 5.0  # a face away from the crease
    plain, apart = (
        subdivide(carrying(mesh, corner={"uv": uv}), "loop", 2, creases=creases).attributes.corner["uv"]
        for uv in (values, cut)
    )
    assert np.array_equal(plain, subdivide(mesh, "loop", 2, creases=creases).verts[refined_faces(mesh, creases)])
    same = np.isclose(plain, apart, atol=1e-12).all(axis=1)
    on_crease = np.isin(refined_faces(mesh, creases), np.arange(21, 28))
    assert same[on_crease].all()
    assert not same.all()


def refined_faces(mesh, creases):
    return subdivide(mesh, "loop", 2, creases=creases).faces.reshape(-1)


def test_the_limit_takes_vertex_and_corner_data_along():
    mesh = torus(7, 6)
    values = mesh.verts[corners_of(mesh)]
    cut = values.copy()
    cut[:3] += 5.0
    dressed = carrying(mesh, vertex={"rest": mesh.verts}, corner={"uv": values, "uv1": cut})
    limit = on_loop_limit(dressed)
    assert np.array_equal(limit.verts, loop_limit(mesh) @ mesh.verts)
    assert np.array_equal(limit.attributes.vertex["rest"], limit.verts)
    assert np.array_equal(limit.attributes.corner["uv"], limit.verts[corners_of(mesh)])
    assert np.array_equal(limit.attributes.corner["uv1"][:3], cut[:3])
    far = ~np.isin(corners_of(mesh), mesh.faces[np.isin(mesh.faces, mesh.faces[0]).any(axis=1)])
    assert far.any()
    assert np.allclose(limit.attributes.corner["uv1"][far], limit.attributes.corner["uv"][far])


def test_one_alpha_per_vertex_holds_in_charts_too():
    mesh = torus(7, 6)
    alpha = np.linspace(0, 1, mesh.num_verts)
    values = mesh.verts[corners_of(mesh)]
    cut = values.copy()
    cut[:3] += 5.0
    fine = subdivide(carrying(mesh, corner={"uv": cut, "rest": values}), "interp-loop", 2, alpha=alpha)
    found, rest = (fine.attributes.corner[name] for name in ("uv", "rest"))
    assert np.array_equal(rest, fine.verts[corners_of(fine)])
    assert np.isclose(found, rest, atol=1e-12).all(axis=1).mean() > 0.5


def test_no_levels_and_mixed_polygons():
    mesh = carrying(mixed_closed(), vertex={"heat": np.arange(mixed_closed().num_verts) / 3})
    assert np.array_equal(subdivide(mesh, "catmull-clark", 0).attributes.vertex["heat"], mesh.attributes.vertex["heat"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fine = subdivide(mesh, "catmull-clark", 2)
    assert len(fine.attributes.vertex["heat"]) == fine.num_verts
