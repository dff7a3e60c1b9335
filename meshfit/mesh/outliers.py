"""Outliers of scans: points far from any surface, and vertices that stick out of one."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from meshfit.mesh.mesh import Mesh, SameContent
from meshfit.mesh.noise import heights_over_neighbours
from meshfit.mesh.topology import Topology

# Neighbours of a point; fewer points than the second number show no density.
_NEIGHBOURS, _FEWEST = 12, 100
# A point is stray if it is so many times as far from its neighbours as they are from theirs; or so many times as far
# as most points are, where sparse points fill space: of so many nearest ones, more than this share have neighbours that
# lie in no plane, up to this share of their extent. At edges and thin parts of a sparse surface fewer do.
_LONELY, _SPARSE, _VOTES, _MOST, _FLAT = 1.7, 2.5, 24, 0.75, 0.25
# Unless this share of all sparse points have such neighbours, they are a surface, and this share of the nearest must.
_FILLED, _NEARLY_ALL = 0.6, 0.95
# Outliers hide each other: those left are looked at again, so many times.
_ROUNDS = 3
_BLOCK = 1 << 16
# A vertex is a spike if its height over the mean of its neighbours is so many standard deviations of the noise, and
# this many mean lengths of the edges around it; corners and tips of surfaces with faces of good shape are lower.
_SPIKE_NOISE, _SPIKE_EDGES = 5.0, 1.5


def stray_points(points: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    """Return (N,) which points lie off any surface, judged by the distances of their nearest neighbours.

    Density may vary over the surface: a point is compared with its own neighbours first.
    """
    return _stray_points(SameContent(Mesh(points, [])))


@lru_cache(maxsize=2)  # a control mesh is made without them, and a fit leaves them out again
def _stray_points(content: SameContent) -> Bool[np.ndarray, " N"]:
    points = content.mesh.verts
    stray = np.zeros(len(points), dtype=bool)
    kept = np.arange(len(points))
    for _ in range(_ROUNDS if len(points) >= _FEWEST else 0):
        rows = _stray_among(points[kept])
        if not rows.any():
            break
        stray[kept[rows]] = True
        kept = kept[~rows]
    stray.setflags(write=False)
    return stray


def _stray_among(points: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    tree, count = cKDTree(points), min(_NEIGHBOURS, len(points) - 1)
    reach, neighbours = np.empty(len(points)), np.empty((len(points), count), dtype=np.int64)
    for start in range(0, len(points), _BLOCK):
        block = slice(start, start + _BLOCK)
        distances, rows = (np.asarray(found)[:, 1:] for found in tree.query(points[block], count + 1))
        reach[block], neighbours[block] = np.sqrt(np.square(distances).mean(axis=1)), rows
    stray = np.asarray(reach > _LONELY * np.median(reach[neighbours], axis=1))
    sparse = np.flatnonzero((reach > _SPARSE * np.median(reach)) & ~stray)
    if not len(sparse):
        return stray
    offsets = points[neighbours[sparse]] - points[sparse][:, None]
    extents = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", offsets, offsets))
    solid = extents[:, 0] > _FLAT**2 * extents.sum(axis=1)
    around = np.asarray(cKDTree(points[sparse]).query(points[sparse], np.arange(min(_VOTES, len(sparse))) + 1)[1])
    stray[sparse] = solid[around].mean(axis=1) > (_MOST if solid.mean() > _FILLED else _NEARLY_ALL)
    return stray


def spikes(mesh: Mesh, noise: float) -> Bool[np.ndarray, " V"]:
    """Return (V,) which vertices stick out of their surroundings far more than its noise does.

    Args:
        mesh: a surface.
        noise: standard deviation of its vertices across it.
    """
    topology = Topology.of(mesh)
    inner = np.ones(mesh.num_verts, dtype=bool)
    inner[topology.edges[topology.faces_per_edge != 2].reshape(-1)] = False
    heights = np.abs(heights_over_neighbours(mesh))
    return np.asarray(inner & (heights > _SPIKE_NOISE * noise) & (heights > _SPIKE_EDGES * _edges_around(mesh)))


def _edges_around(mesh: Mesh) -> Float64[np.ndarray, " V"]:
    """Return the mean length of the edges opposite to each vertex in its faces."""
    corners = mesh.verts[mesh.faces]
    opposite = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    verts = mesh.faces.reshape(-1)
    total = np.bincount(verts, opposite.reshape(-1), mesh.num_verts)
    return np.asarray(total / np.maximum(np.bincount(verts, minlength=mesh.num_verts), 1))
