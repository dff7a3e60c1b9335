"""Mirror symmetry: partners are found wherever a mesh lies, and a registration keeps a template symmetric."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshfit import fit
from meshfit.errors import ConfigError, MeshError
from meshfit.fitting.registration.guidance import Guidance
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mirror_symmetry import MirrorPlane, mirror_partners, symmetrised
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.solids import octahedron
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.sphere import icosphere
from tests.loops import over

KEYS = {"method": "gauss-newton", "connectivity": "fixed", "register": "near-rigid", "device": "cpu"}


def animal(level, *, wart=0.0):
    """Return a body with two ears and a snout, symmetric in x but for a wart."""
    ball = icosphere(level)
    x, y, z = ball.verts.T
    ears = 0.35 * np.exp(-8 * ((np.abs(x) - 0.6) ** 2 + (y - 0.5) ** 2 + (z - 0.6) ** 2))
    snout = 0.2 * np.exp(-6 * (x**2 + (y + 0.6) ** 2 + (z - 0.4) ** 2))
    growth = wart * np.exp(-6 * ((x - 0.8) ** 2 + y**2 + (z + 0.4) ** 2))
    return ball.with_verts(ball.verts * (1 + ears + snout + growth)[:, None] * [1.0, 0.8, 1.3])


def moved(mesh, turn=(0.3, 0.5, -0.4), scale=3.0, shift=(1.0, 2.0, 3.0)):
    return mesh.with_verts(Rotation.from_rotvec(turn).apply(np.array(mesh.verts)) * scale + shift)


def asymmetry(verts, partner):
    return float(np.abs(symmetrised(verts, partner) - verts).max() / np.linalg.norm(np.ptp(verts, axis=0)))


@over("turn", [(0.0, 0.0, 0.0), (0.3, 0.5, -0.4), (2.0, -1.0, 1.0)])
def test_partners_are_mirror_images_wherever_the_mesh_lies(turn):
    mesh = animal(3)
    partner = mirror_partners(moved(mesh, turn))
    np.testing.assert_allclose(mesh.verts[partner], mesh.verts * [-1, 1, 1], atol=1e-12)
    np.testing.assert_array_equal(partner[partner], np.arange(mesh.num_verts))


def test_of_several_planes_that_across_x_is_taken():
    for stretch in ([3.0, 2.0, 1.0], [1.0, 2.0, 2.0], [1.0, 1.0, 1.0]):
        verts = subdivide(octahedron(), "loop", 2).verts * stretch
        mesh = Mesh(verts, subdivide(octahedron(), "loop", 2).faces)
        np.testing.assert_allclose(verts[mirror_partners(mesh)], verts * [-1, 1, 1], atol=1e-12)


def test_symmetrised_is_the_nearest_symmetric_shape():
    mesh = animal(2)
    partner = mirror_partners(mesh)
    noise = np.random.default_rng(0).normal(0, 0.01, mesh.verts.shape)
    plane = MirrorPlane(np.array([1.0, 0, 0]), 0.0)
    even = symmetrised(mesh.verts + noise, partner, plane)
    np.testing.assert_allclose(plane.reflected(even)[partner], even, atol=1e-15)
    # What is left is antisymmetric, so orthogonal to every symmetric displacement.
    left = mesh.verts + noise - even
    assert abs(float((left * even).sum())) < 1e-12
    # Without a plane, that of the shape is found.
    np.testing.assert_allclose(symmetrised(moved(mesh).verts, partner), moved(mesh).verts, atol=1e-12)


def test_what_is_not_symmetric_is_refused_with_the_worst_vertex():
    mesh = animal(2, wart=0.5)
    with pytest.raises(MeshError, match=r"^not mirror-symmetric: \d+ of 162 vertices have no partner .*; the mirror"):
        mirror_partners(mesh)
    slightly = animal(2, wart=0.02)
    np.testing.assert_array_equal(mirror_partners(slightly), mirror_partners(animal(2)))


@pytest.mark.slow
def test_a_symmetric_template_stays_symmetric_on_a_target_that_is_not():
    source, target = animal(3), animal(3, wart=0.05)
    found = fit(source, target, levels=0, symmetric=True, **KEYS).mesh
    assert asymmetry(found.verts, mirror_partners(source)) < 1e-12
    assert asymmetry(target.verts, mirror_partners(source)) > 0.005


@pytest.mark.slow
@over("register", ["near-rigid", "soft"])
def test_so_does_each_level_wherever_the_target_lies_and_noise_is_averaged(register):
    source, truth = animal(2), moved(animal(3), turn=(0.1, 0.0, 0.1), scale=1.1, shift=(0.0, 0.1, 0.0))
    noise = np.random.default_rng(0).normal(0, 0.01, truth.verts.shape)
    keys = KEYS | {"levels": 1, "register": register}
    plain, even = (
        fit(source, truth.with_verts(truth.verts + noise), symmetric=symmetric, **keys).mesh
        for symmetric in (False, True)
    )
    partner = mirror_partners(subdivide(source, "loop", 1))
    assert asymmetry(even.verts, partner) < 1e-9 < 1e-4 < asymmetry(plain.verts, partner)
    errors = [np.sqrt((point_distances(truth, mesh.verts) ** 2).mean()) for mesh in (plain, even)]
    assert errors[1] < 0.9 * errors[0]


def test_fixed_and_rigid_parts_must_be_symmetric_too():
    mesh = animal(2)
    one_side = mesh.verts[:, 0] > 0.5
    with pytest.raises(MeshError, match=r"^symmetric: fixed: \d+ vertices differ from their mirror images$"):
        Guidance(fixed=one_side).mirrored(mesh)
    with pytest.raises(MeshError, match=r"^symmetric: rigid: the mirror image of part 0 has the labels 0, 3$"):
        Guidance(rigid=np.where(one_side, 3, 0)).mirrored(mesh)
    eyes = np.where(one_side, 3, np.where(mesh.verts[:, 0] < -0.5, 7, 0))
    assert Guidance(rigid=eyes, fixed=np.abs(mesh.verts[:, 0]) < 0.1).mirrored(mesh).mirror is not None


def test_only_a_registration_keeps_a_source_symmetric():
    with pytest.raises(ValueError, match="symmetric: only a registration keeps a source symmetric"):
        GaussNewtonSettings(symmetric=True)
    with pytest.raises(ConfigError, match="symmetric: only a registration"):
        fit(animal(2), animal(2), method="gauss-newton", symmetric=True)
