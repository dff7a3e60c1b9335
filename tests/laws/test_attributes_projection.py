"""Projection of attributes: identity, linear functions, seams that stay sharp, labels."""

import numpy as np

from meshfit.mesh import projection
from meshfit.mesh.attributes import Attributes, Material
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.projection import carried_places, projected_attributes
from meshfit.subdivision.refine import subdivide
from tests.shapes import patch, torus


def cut_at(mesh: Mesh, column: float) -> Mesh:
    """The mesh with its x and y as texture coordinates, 10 more in u from a column on, and a material on each side."""
    right = mesh.verts[mesh.faces][:, :, 0].mean(axis=1) > column
    uv = mesh.verts[mesh.faces][:, :, :2] + np.array([10.0, 0.0]) * right[:, None, None]
    attributes = Attributes(
        vertex={"heat": mesh.verts @ [1.0, 2.0, 0.0], "label": np.arange(mesh.num_verts)},
        face={"material": right.astype(np.int64)},
        corner={"uv": uv.reshape(-1, 2), "smooth": mesh.verts[mesh.faces].reshape(-1, 3)},
        materials=(Material("left"), Material("right")),
    )
    return mesh.with_attributes(attributes)


def random_lattice(columns: int, rows: int) -> Mesh:
    """A flat lattice from (0, 0) to (8, 7), shaken inside."""
    mesh = patch(columns, rows)
    verts = mesh.verts / [columns - 1, rows - 1, 1] * [8, 7, 1]
    inside = ((verts > 0) & (verts < [8, 7, 1]))[:, :2].all(axis=1)
    shake = np.random.default_rng(1).uniform(-1.2, 1.2, (mesh.num_verts, 2)) / [columns, rows] * inside[:, None]
    return Mesh(verts + np.pad(shake, ((0, 0), (0, 1))), mesh.faces)


def test_a_mesh_takes_over_its_own_attributes():
    source = cut_at(torus(9, 8), 0.4)
    found = projected_attributes(source, source.verts, source)
    for have, expected in ((found.vertex, source.attributes.vertex), (found.corner, source.attributes.corner)):
        for name, rows in expected.items():
            assert np.allclose(have[name], rows, atol=1e-12)
    assert np.array_equal(found.vertex["label"], source.attributes.vertex["label"])
    assert np.array_equal(found.face["material"], source.attributes.face["material"])
    assert found.materials == source.attributes.materials


def test_linear_functions_stay_and_seams_are_sharp():
    source = cut_at(patch(9, 8), 4)
    for columns, rows in ((6, 6), (14, 11), (40, 37)):
        mesh = random_lattice(columns, rows)
        found = projected_attributes(mesh, mesh.verts, source)
        x, y = mesh.verts[:, 0], mesh.verts[:, 1]
        assert np.allclose(found.vertex["heat"], x + 2 * y)
        assert np.allclose(found.corner["smooth"], mesh.verts[mesh.faces].reshape(-1, 3), atol=1e-9)
        right = x[mesh.faces].mean(axis=1) > 4
        assert np.array_equal(found.face["material"], right)
        clamped = np.where(right[:, None], np.maximum(x[mesh.faces], 4) + 10, np.minimum(x[mesh.faces], 4))
        uv = found.corner["uv"].reshape(-1, 3, 2)
        assert np.allclose(uv[:, :, 0], clamped, atol=1e-9)
        assert np.allclose(uv[:, :, 1], y[mesh.faces], atol=1e-9)


def test_corners_at_one_vertex_are_equal_unless_a_seam_is_between_them():
    source = cut_at(patch(9, 8), 4)
    mesh = random_lattice(30, 31)
    uv = projected_attributes(mesh, mesh.verts, source).corner["uv"]
    corners = mesh.faces.reshape(-1)
    for vert in range(mesh.num_verts):
        rows = np.unique(uv[corners == vert], axis=0)
        assert len(rows) == len(np.unique(rows[:, 0] > 7))


def test_a_period_is_no_shortcut():
    """Around a torus whose chart is cut once in each direction, no face goes back across the image."""
    fine = subdivide(torus(9, 8), "midpoint", 1)
    i, j = torus(9, 8).faces % 9, torus(9, 8).faces // 9
    uv = np.stack([i, j], axis=2).astype(float)
    for axis, period in ((0, 9), (1, 8)):
        wraps = np.ptp(uv[:, :, axis], axis=1) > period / 2
        low = wraps[:, None] & (uv[:, :, axis] < period / 2)
        uv[low, axis] += period
    source = torus(9, 8).with_attributes(Attributes(corner={"uv": uv.reshape(-1, 2)}))
    expected = subdivide(source, "midpoint", 1).attributes.corner["uv"]
    assert np.allclose(projected_attributes(fine, fine.verts, source).corner["uv"], expected, atol=1e-9)
    turned = Mesh(fine.verts[::-1], fine.num_verts - 1 - fine.faces)  # in another order
    assert np.allclose(projected_attributes(turned, turned.verts, source).corner["uv"], expected, atol=1e-9)


def test_walks_are_made_beside_seams_only(monkeypatch):
    walk, walked = projection._Walk.to, []
    monkeypatch.setattr(projection._Walk, "to", lambda self, *ends: walked.append(ends[0]) or walk(self, *ends))
    source = cut_at(patch(9, 8), 4)
    mesh = random_lattice(80, 70)
    projected_attributes(mesh, mesh.verts, source)
    middles = np.concatenate([starts.points(source) for starts in walked])
    assert 0 < len(middles) < 3 * mesh.num_faces / 10
    at_edge = np.minimum(middles, [8, 7, 0] - middles)[:, :2].min(axis=1) <= 1
    assert ((np.abs(middles[:, 0] - 4) <= 1) | at_edge).all()


def test_carried_places_are_linear_on_each_face():
    before, after = patch(9, 8), random_lattice(13, 12)
    assert np.allclose(carried_places(before, 3 * before.verts + 1, after.verts), 3 * after.verts + 1)
