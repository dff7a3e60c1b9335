"""Noise of scans: how far points lie off their surface at random."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from meshfit.mesh.geometry import bounding_box_diagonal, unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology

NEIGHBOURHOOD = 4.0
"""Radius of a neighbourhood that shows the surface through its noise, in standard deviations."""

# Noise, as a share of the diagonal, beyond which nearest points are no guide to the surface between them.
_VERY_NOISY = 0.007
# Neighbours that a quadric is fitted to, its number of coefficients, the most neighbours, and the most quadrics.
_QUADRIC, _COEFFICIENTS, _MOST_NEIGHBOURS, _MOST_QUADRICS = 24, 6, 96, 5000
# Correlation of the heights of adjacent vertices over their neighbours' means: at most that of a smooth surface, and
# that of independent noise at valence 6.
_SMOOTH, _INDEPENDENT = 0.2, -0.238
# Fewer vertices do not tell: the standard error of the correlation is that of some 3 edges for each.
_FEWEST = 50
_SMOOTHINGS = 2
_NORMAL_MEDIAN = 1.4826


def noise_of_points(points: Float64[np.ndarray, "N 3"]) -> float:
    """Estimate the standard deviation of the noise of points across their surface, in their unit.

    It is the median residual of quadrics fitted to the nearest neighbours of points.
    """
    if len(points) <= 2 * _COEFFICIENTS:
        return 0.0
    tree, rows = cKDTree(points), np.random.default_rng(0).permutation(len(points))[:_MOST_QUADRICS]
    most, count = min(_MOST_NEIGHBOURS, len(points) - 1), min(_QUADRIC, len(points) - 1)
    while True:
        distances, neighbours = tree.query(points[np.sort(rows)], count + 1)
        radii = np.asarray(distances)[:, -1]
        noise = _quadric_residual(points[neighbours], radii)
        # Neighbours no farther apart than the noise lie in no surface.
        if float(np.median(radii)) >= NEIGHBOURHOOD * noise or 2 * count > most:
            return noise
        count *= 2


def is_very_noisy(points: Float64[np.ndarray, "N 3"], noise: float) -> bool:
    """Return whether points of some noise have to be smoothed before a surface is drawn to the nearest of them."""
    return noise > _VERY_NOISY * bounding_box_diagonal(points)


def _quadric_residual(neighbourhoods: Float64[np.ndarray, "M K 3"], radii: Float64[np.ndarray, " M"]) -> float:
    offsets = neighbourhoods - neighbourhoods.mean(axis=1, keepdims=True)
    axes = np.linalg.svd(offsets, full_matrices=False)[2]
    x, y, height = np.moveaxis(np.einsum("mkj,mij->mki", offsets, axes), 2, 0)
    scale = np.maximum(radii, np.finfo(float).tiny)[:, None]
    x, y = x / scale, y / scale
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2))[0]
    residual = height - np.einsum("mkj,mj->mk", basis, np.einsum("mkj,mk->mj", basis, height))
    variance = (residual**2).sum(axis=1) / max(residual.shape[1] - _COEFFICIENTS, 1)
    return float(np.sqrt(np.median(variance)))


def noise_of_mesh(mesh: Mesh) -> float:
    """Estimate the standard deviation of the noise of a mesh's vertices across its surface, in their unit.

    The height of a vertex over the mean of its neighbours comes from curvature and from noise. Curvature gives adjacent
    vertices like heights; independent noise gives them opposed ones, with a correlation of -0.238 on a regular mesh.
    The correlation thus tells which part of the heights is noise: a coarse or creased mesh without noise has none.
    """
    topology = Topology.of(mesh)
    inner = np.ones(mesh.num_verts, dtype=bool)
    inner[topology.edges[topology.faces_per_edge != 2].reshape(-1)] = False
    tail, head = topology.edges.T
    valence = np.bincount(topology.edges.reshape(-1), minlength=mesh.num_verts)
    inner &= valence > 2
    between = inner[tail] & inner[head]
    if inner.sum() < _FEWEST or not between.any():
        return 0.0
    heights = heights_over_neighbours(mesh)
    size = float(np.median(np.abs(heights[inner])))
    if size == 0:
        return 0.0
    clipped = np.clip(heights / size, -2, 2)
    correlation = (clipped[tail[between]] * clipped[head[between]]).mean() / (clipped[inner] ** 2).mean()
    share = np.clip((_SMOOTH - correlation) / (_SMOOTH - _INDEPENDENT), 0, 1)
    of_noise = 1 + (1 / valence[inner]).mean()
    return float(_NORMAL_MEDIAN * size * np.sqrt(share / of_noise))


def heights_over_neighbours(mesh: Mesh) -> Float64[np.ndarray, " V"]:
    """Return the height of each vertex over the mean of its neighbours, along a smooth normal."""
    tail, head = Topology.of(mesh).edges.T
    valence = np.bincount(np.concatenate([tail, head]), minlength=mesh.num_verts)
    normals = smoothed_normals(mesh, vert_area_vectors(mesh), _SMOOTHINGS)
    middle = _sum_of_neighbours(mesh.verts, tail, head) / np.maximum(valence, 1)[:, None]
    return np.asarray(np.einsum("nk,nk->n", mesh.verts - middle, unit_vectors(normals)))


def smoothed_normals(mesh: Mesh, normals: Float64[np.ndarray, "V 3"], rounds: int) -> Float64[np.ndarray, "V 3"]:
    """Add to the unit normal of each vertex those of its neighbours, in some rounds; the lengths have no meaning."""
    tail, head = Topology.of(mesh).edges.T
    for _ in range(rounds):
        normals = unit_vectors(normals)
        normals = normals + _sum_of_neighbours(normals, tail, head)
    return normals


def _sum_of_neighbours(
    values: Float64[np.ndarray, "N 3"], tail: np.ndarray, head: np.ndarray
) -> Float64[np.ndarray, "N 3"]:
    columns = [
        np.bincount(np.concatenate([tail, head]), np.concatenate([column[head], column[tail]]), len(values))
        for column in values.T
    ]
    return np.stack(columns, axis=1)
