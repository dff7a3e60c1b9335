"""Attributes through fits: those of the source's own faces byte by byte, else projected; shapes stay as they were."""

from functools import cache

import numpy as np
import pytest

import meshfit
from meshfit.fitting.callbacks import Interrupted
from meshfit.fitting.gauss_newton import target
from meshfit.mesh.attributes import Attributes, Material
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import icosahedron, quad_cube
from meshfit.subdivision.limit import on_loop_limit
from meshfit.subdivision.refine import subdivide
from tests.checkpoints import through_a_file
from tests.fits import fit
from tests.loops import over

MATERIALS = (Material("low"), Material("high"))
FIRST_ORDER = {"steps": 3, "samples": 50, "device": "cpu"}
GAUSS_NEWTON = {
    "method": "gauss-newton",
    "device": "cpu",
    "verts": 200,
    "levels": 1,
    "coarse_steps": 6,
    "tries": 1,
    "level_steps": 1,
    "last_steps": 1,
}


@pytest.fixture(autouse=True)
def fewer_points(monkeypatch):
    monkeypatch.setattr(target, "_POINTS", 2_000)


def dressed(mesh, *, seam: bool = True):
    """The mesh with data of every kind: its positions as vertex data, and a chart of longitude and height."""
    polygons = PolygonMesh.of(mesh)
    x, y, z = mesh.verts[polygons.corners].T
    u = np.arctan2(y, x) / (2 * np.pi) + 0.5
    if seam:
        face = np.repeat(np.arange(mesh.num_faces), polygons.sizes)
        wraps = np.maximum.reduceat(u, polygons.starts) - np.minimum.reduceat(u, polygons.starts) > 0.5
        u = u + (wraps[face] & (u < 0.5))
    middle = np.add.reduceat(z, polygons.starts)
    attributes = Attributes(
        vertex={"rest": mesh.verts, "label": np.arange(mesh.num_verts)},
        face={"material": (middle > 0).astype(np.int64)},
        corner={"uv": np.stack([u, z], axis=1)},
        materials=MATERIALS,
    )
    return mesh.with_attributes(attributes)


@cache
def ball(levels: int, radius: float = 1.0) -> Mesh:
    mesh = subdivide(icosahedron(), "midpoint", levels)
    return Mesh(radius * mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True), mesh.faces)


@cache
def ellipsoid() -> Mesh:
    return Mesh(ball(3).verts * np.array([1.0, 0.8, 0.6]), ball(3).faces)


def assert_equal(found: Attributes, expected: Attributes) -> None:
    for have, wanted in (
        (found.vertex, expected.vertex),
        (found.face, expected.face),
        (found.corner, expected.corner),
    ):
        assert have.keys() == wanted.keys()
        for name, rows in wanted.items():
            assert have[name].tobytes() == rows.tobytes()
    assert found.materials == expected.materials


def assert_same_shape(one, other):
    assert one.mesh.verts.tobytes() == other.mesh.verts.tobytes()
    assert one.mesh.faces.tobytes() == other.mesh.faces.tobytes()


def test_a_first_order_fit_keeps_everything():
    source = ball(1, 0.5)
    plain, found = (fit(mesh, ellipsoid(), **FIRST_ORDER) for mesh in (source, dressed(source)))
    assert_same_shape(plain, found)
    assert not plain.mesh.attributes
    assert_equal(found.mesh.attributes, dressed(source).attributes)


def test_polygons_keep_theirs_and_their_triangles_too():
    source = dressed(subdivide(quad_cube(), "catmull-clark", 1))
    found = fit(source, ellipsoid(), **FIRST_ORDER)
    assert_equal(found.polygons.attributes, source.attributes)
    assert_equal(found.mesh.attributes, found.polygons.triangulated().attributes)
    assert len(found.mesh.attributes.corner["uv"]) == 3 * found.mesh.num_faces


@pytest.mark.filterwarnings("ignore:align='pca'. another pose")  # a ball fits at any turn
def test_placement_and_normalisation_keep_everything():
    source = dressed(ball(1, 0.5))
    for align in ("center", "pca", "sphere"):
        found = meshfit.fit(source, ellipsoid(), align=align, **FIRST_ORDER)
        assert_equal(found.mesh.attributes, source.attributes)


@over(
    ("scheme", "changes"),
    [
        ("loop", {}),
        ("loop", {"variables": "control", "limit": True}),
        ("catmull-clark", {}),
    ],
)
def test_fixed_faces_carry_the_refined_attributes_of_the_source(scheme, changes):
    source = ball(1, 0.3) if scheme == "loop" else subdivide(quad_cube(), "catmull-clark", 1)
    options = GAUSS_NEWTON | {"connectivity": "fixed", "register": "off", "scheme": scheme} | changes
    found = fit(dressed(source), ellipsoid(), **options)
    expected = subdivide(dressed(source), scheme, 1)
    if "limit" in changes:
        expected = on_loop_limit(expected)
    assert_equal((found.polygons or found.mesh).attributes, expected.attributes)
    if changes:
        assert_equal(found.control.attributes, dressed(source).attributes)


@pytest.mark.parametrize("changes", [{}, pytest.param({"variables": "control"}, marks=pytest.mark.slow)])
def test_remeshed_faces_take_over_the_attributes_of_the_source(changes):
    source = ball(2, 0.3)
    options = GAUSS_NEWTON | {"scheme": "loop", "coarse_steps": 12} | changes
    found = fit(dressed(source), ellipsoid(), **options)
    if not changes:
        assert_same_shape(fit(source, ellipsoid(), **options), found)
    for mesh in (found.mesh, *([found.control] if changes else [])):
        attributes = mesh.attributes
        # The ellipsoid is the ball, scaled: each place on the source is about the place on the result, scaled back.
        back = mesh.verts / np.array([1.0, 0.8, 0.6])
        back = 0.3 * back / np.linalg.norm(back, axis=1, keepdims=True)
        away = np.linalg.norm(attributes.vertex["rest"] - back, axis=1)
        assert away.max() < 0.15
        assert np.median(away) < 0.06
        size = np.ptp(attributes.corner["uv"].reshape(-1, 3, 2), axis=1)
        far = np.abs(mesh.verts[:, 2])[mesh.faces].max(axis=1) < 0.4
        assert far.sum() > 50
        assert size[far, 0].max() < 0.3  # no face goes back across the image
        assert attributes.materials == MATERIALS
        assert set(np.unique(attributes.face["material"])) == {0, 1}


@pytest.mark.slow
def test_an_interrupted_fit_resumes_to_the_same_attributes():
    source, saved = dressed(ball(2, 0.3)), []
    options = GAUSS_NEWTON | {"scheme": "loop"}
    expected = fit(source, ellipsoid(), **options)

    def stop(step):
        if step.done == 7:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit(source, ellipsoid(), on_step=stop, save=saved.append, **options)
    found = fit(source, ellipsoid(), resume=through_a_file(saved[-1]), **options)
    assert_same_shape(expected, found)
    assert_equal(found.mesh.attributes, expected.mesh.attributes)
