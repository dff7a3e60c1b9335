import numpy as np
import pytest

from meshfit.config.source_settings import SourceSettings
from meshfit.errors import ConfigError, MeshError, MeshfitWarning
from meshfit.experiment.source import build_source
from meshfit.mesh.geometry import face_areas, signed_volume
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import subdivide
from tests.loops import over


def radii(mesh, centre=(0, 0, 0)):
    return np.linalg.norm(mesh.verts - np.asarray(centre), axis=1)


def test_the_default_source_is_the_refined_unit_icosahedron():
    mesh = build_source(SourceSettings(levels=2), "loop")
    np.testing.assert_allclose(mesh.verts, subdivide(icosahedron(), "loop", 2).verts, atol=1e-15)


def test_projection_gives_the_icosphere_of_the_tutorial():
    mesh = build_source(SourceSettings(levels=4, project="sphere"), "midpoint")
    assert (mesh.num_verts, mesh.num_faces) == (2562, 5120)
    np.testing.assert_allclose(radii(mesh), 1.0, atol=1e-14)
    base = build_source(SourceSettings(mesh="icosphere:level=4", levels=0), "loop")
    np.testing.assert_allclose(base.verts, mesh.verts, atol=1e-14)


def test_radius_and_centre_place_the_control_mesh():
    mesh = build_source(SourceSettings(mesh="cube", levels=0, radius=2.5, centre=(1, 2, 3)), "loop")
    np.testing.assert_allclose(radii(mesh, (1, 2, 3)), 2.5, atol=1e-14)
    kept = build_source(SourceSettings(mesh="bone", levels=0, radius=None, centre=None), "loop")
    assert kept.num_verts == 1513
    assert np.abs(kept.verts).max() > 0


@over("scheme", ["loop", "interp-loop", "doo-sabin"])
def test_sources_of_equal_area_or_volume_are_those_of_the_ball(scheme):
    settings = SourceSettings(mesh="cube", levels=2, radius=2.5, centre=(1, 2, 3))
    for of, wanted in (("area", 4 * np.pi * 2.5**2), ("volume", 4 / 3 * np.pi * 2.5**3)):
        mesh = build_source(settings.model_copy(update={"radius_of": of}), scheme)
        triangles = mesh if isinstance(mesh, Mesh) else mesh.triangulated()
        assert (face_areas(triangles).sum() if of == "area" else signed_volume(triangles)) == pytest.approx(wanted)
        np.testing.assert_allclose(mesh.verts.mean(axis=0), (1, 2, 3), atol=1e-12)


def test_an_open_source_has_no_volume(tmp_path):
    save_mesh(Mesh(icosahedron().verts, icosahedron().faces[:-1]), tmp_path / "open.off")
    settings = SourceSettings(mesh=str(tmp_path / "open.off"), levels=0, radius_of="volume")
    with pytest.warns(MeshfitWarning), pytest.raises(MeshError, match="an open surface has no volume"):
        build_source(settings, "loop")


def test_projection_keeps_centre_and_radius():
    settings = SourceSettings(mesh="octahedron", levels=3, radius=0.5, centre=(1, 0, 0), project="sphere")
    np.testing.assert_allclose(radii(build_source(settings, "interp-loop"), (1, 0, 0)), 0.5, atol=1e-14)


def test_a_target_can_be_decimated_into_a_control_mesh():
    mesh = build_source(SourceSettings(mesh="bone", decimate=200, levels=1), "loop")
    assert mesh.num_faces == pytest.approx(800, abs=16)
    assert Topology.of(mesh).is_watertight


def test_projection_counts_levels_as_the_scheme_does(tmp_path):
    """√3 schemes refine the boundary at every second level, and so they must under projection."""
    half = icosahedron()
    kept = half.faces[(half.verts[half.faces][:, :, 2] > -0.6).all(axis=1)]
    save_mesh(Mesh(half.verts, kept), tmp_path / "open.off")
    settings = SourceSettings(mesh=str(tmp_path / "open.off"), levels=2)
    with pytest.warns(MeshfitWarning):
        plain = build_source(settings, "sqrt3")
    with pytest.warns(MeshfitWarning):
        projected = build_source(settings.model_copy(update={"project": "sphere"}), "sqrt3")
    assert np.array_equal(plain.faces, projected.faces)


@pytest.mark.parametrize("name", ["icosahedrn", "icosphere:level=x", "icosphere:level=-1", "icosphere:depth=2"])
def test_an_unknown_base_is_refused_with_what_is_allowed(name):
    with pytest.raises(ConfigError, match=r"source\.mesh: .*(icosahedron|level)"):
        build_source(SourceSettings(mesh=name), "loop")


@over(
    ("scheme", "wanted", "verts"),
    [
        ("loop", 2562, 2562),
        ("loop", 1500, 2562),  # 642 is farther by its ratio
        ("loop", 1200, 642),
        ("loop", 4, 12),
        ("sqrt3", 2562, 2432),
        ("catmull-clark", 2562, 3842),
        ("sqrt2", 2562, 1922),
    ],
)
def test_wanted_verts_take_as_many_levels_as_come_nearest(scheme, wanted, verts):
    assert build_source(SourceSettings(wanted_verts=wanted), scheme).num_verts == verts


def test_wanted_verts_take_the_place_of_levels_and_neither_changes_the_other():
    by_number, by_levels = (
        build_source(SourceSettings(**asked), "sqrt3") for asked in ({"wanted_verts": 92}, {"levels": 2})
    )
    assert (by_number.verts == by_levels.verts).all()
    assert (by_number.faces == by_levels.faces).all()


def test_verts_that_no_level_reaches_take_the_finest_allowed():
    coarse = SourceSettings(mesh="tetrahedron", wanted_verts=10**9)
    assert (
        build_source(coarse, "sqrt3").num_verts
        == build_source(coarse.model_copy(update={"wanted_verts": None, "levels": 8}), "sqrt3").num_verts
    )
