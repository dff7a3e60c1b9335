"""Angles below 1 degree are removed where faces may change, with the surface where it was."""

import numpy as np
import torch

from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.step_limiting import faults_of
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.remeshing.self_intersections import intersecting_faces
from meshfit.remeshing.thin_faces import without_thin_faces
from meshfit.subdivision.sphere import icosphere
from tests.loops import over
from tests.shapes import patch, torus


def least_angle(mesh):
    """Return the smallest angle in degrees, from the law of cosines."""
    a, b, c = np.linalg.norm(np.roll(mesh.verts[mesh.faces], -1, axis=1) - mesh.verts[mesh.faces], axis=2).T
    p, q, r = a**2, b**2, c**2
    area = np.linalg.norm(
        np.cross(*(mesh.verts[mesh.faces[:, k]] - mesh.verts[mesh.faces[:, 0]] for k in (1, 2))), axis=1
    )
    return float(np.degrees(np.stack([np.arctan2(2 * area, s) for s in (q + r - p, r + p - q, p + q - r)]).min()))


def with_thin_faces(mesh, count=4):
    """Move corners of some faces next to another, or nearly onto the opposite side."""
    rng, verts = np.random.default_rng(0), mesh.verts.copy()
    inner = ~np.isin(mesh.faces, Topology.of(mesh).boundary_verts).any(axis=1)
    for face in rng.choice(np.flatnonzero(inner), count, replace=False):
        a, b, c = mesh.faces[face]
        if rng.random() < 0.5:
            verts[a] = verts[b] + 1e-3 * (verts[a] - verts[b])
        else:
            verts[c] = verts[[a, b]].mean(axis=0) + 2e-3 * (verts[c] - verts[a])
    return mesh.with_verts(verts)


def flat(mesh, thickness):
    return mesh.with_verts(mesh.verts * [1.0, 1.0, thickness])


def wedge():
    """Return a ball that ends in a sharp edge."""
    verts = icosphere(3).verts.copy()
    verts[:, 2] *= 0.15 * (1 - verts[:, 0]) + 0.01
    return icosphere(3).with_verts(verts)


SHAPES = {
    "ball": lambda: icosphere(3),
    "ring": lambda: torus(16, 12),
    "thin disc": lambda: flat(icosphere(3), 0.02),
    "needle": lambda: icosphere(3).with_verts(icosphere(3).verts * [0.05, 0.05, 1.0]),
    "thin ring": lambda: flat(torus(24, 10), 0.02),
    "wedge": wedge,
    "sheet": lambda: patch(14, 12),
}


@over(("name", "dtype"), [*((name, torch.float32) for name in SHAPES), ("ball", torch.float64)])
def test_thin_faces_are_removed_and_all_else_stays(name, dtype):
    mesh = with_thin_faces(SHAPES[name]())
    verts, faces = torch.tensor(mesh.verts).to(dtype), torch.tensor(mesh.faces)
    verts, faces = without_thin_faces(verts, faces)
    result = Mesh(verts.double().numpy(), faces.numpy())
    assert least_angle(mesh) < 1 <= least_angle(result)
    assert mesh.num_verts - 6 <= result.num_verts <= mesh.num_verts
    assert TopologyCounts.of(Topology.of(result)) == TopologyCounts.of(Topology.of(mesh))
    crossing = [
        int(intersecting_faces(torch.tensor(each.verts), torch.tensor(each.faces)).sum()) for each in (mesh, result)
    ]
    assert crossing[1] <= crossing[0]
    for origin, surface in ((mesh, result), (result, mesh)):
        points = sample_surface(origin, 2000, np.random.default_rng(0)).points
        assert point_distances(surface, points).max() < 5e-4 * bounding_box_diagonal(mesh.verts)


def test_the_same_faces_are_mended_each_time():
    mesh = with_thin_faces(icosphere(2))
    first, second = (without_thin_faces(torch.tensor(mesh.verts), torch.tensor(mesh.faces)) for _ in range(2))
    assert all(torch.equal(*pair) for pair in zip(first, second, strict=True))


def test_a_surface_without_thin_faces_is_left_as_it_is():
    state = FitState.of(torch.tensor(icosphere(2).verts), torch.tensor(icosphere(2).faces))
    assert state.without_thin_faces() is state


def test_pieces_that_may_cross_keep_what_they_cross_and_lose_their_thin_faces():
    one = with_thin_faces(icosphere(3))
    verts = np.concatenate([one.verts, one.verts + np.array([0.9, 0.1, 0.0])])
    faces = np.concatenate([one.faces, one.faces + one.num_verts])
    state = FitState.of(torch.tensor(verts), torch.tensor(faces), crossing=True)
    assert any(text.startswith("thin faces: ") for text in faults_of(state.shape))
    mended = state.without_thin_faces()
    assert mended.crossing
    assert not faults_of(mended.shape)
    assert mended.pattern.connectivity.pieces[0] == 2


def test_faces_that_cannot_be_mended_stay():
    """Every change of a tetrahedron would change its topology or its shape."""
    verts = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-3, 0], [0.5, 0, 1]], dtype=torch.float64)
    faces = torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    kept, same = without_thin_faces(verts, faces)
    assert len(kept) == 4
    assert torch.equal(same.sort().values.unique(dim=0), faces.sort().values.unique(dim=0))
