"""Boundaries of open surfaces are fitted to each other, with fixed and with changing connectivity."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshfit.measuring.measure import measure
from meshfit.mesh.manifold import describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from tests.fits import fit


def disk(size, height):
    x = np.linspace(-1, 1, size)
    u, v = (part.ravel() for part in np.meshgrid(x, x, indexing="ij"))
    u, v = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)
    i = np.arange(size * size).reshape(size, size)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return Mesh(np.stack([u, v, height(u, v)], 1), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def boundary(mesh):
    topology = Topology.of(mesh)
    return mesh.verts[np.unique(topology.edges[topology.faces_per_edge == 1])]


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"connectivity": "fixed"}, {"verts": 1200}], ids=["fixed", "remeshed"])
def test_the_boundary_of_a_disk_is_fitted_to_that_of_a_bowl(changes):
    source = disk(9, lambda u, v: 0 * u)
    source = Mesh(0.6 * source.verts, source.faces)
    bowl = disk(41, lambda u, v: 0.5 * (1 - u * u - v * v) + 0.1 * np.sin(4 * u))
    result = fit(source, bowl, method="gauss-newton", device="cpu", **{"levels": 1, "tries": 1} | changes).mesh
    assert describe_topology(Topology.of(result)) == "1 piece, open, 1 boundary loop, Euler number 1"
    assert cKDTree(boundary(bowl)).query(boundary(result))[0].max() < 0.1  # its verts are up to 0.08 apart
    found = measure(result, bowl, samples=20_000)
    assert found.distance.mean < 0.002
    assert (found.quality.self_intersecting_faces, found.quality.flipped_faces) == (0, 0)
