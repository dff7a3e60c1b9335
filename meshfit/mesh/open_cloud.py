"""Open surfaces through clouds: sheets, and scans of one side of a shape."""

import math

import numpy as np
from scipy.spatial import cKDTree

from meshfit.mesh.denoised_cloud import denoised_cloud
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas, face_normals
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import refine_long_edges, screened_poisson
from meshfit.mesh.noise import noise_of_points
from meshfit.mesh.pieces import manifold_pieces, piece_of_face
from meshfit.mesh.point_cloud import PointCloud, Points, oriented_cloud, sampled_areas
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import NONE, Mask, Topology

# Distances of points, in which gaps are measured: faces this far from all points are off them, and part of a gap or
# beyond the rim if one in the same patch is farther than the second number. The third is how far these are widened.
_OFF, _GAP, _WIDENED = 1.75, 2.5, 1.25
# Points of a closed surface that are looked at. The cloud shows those within a reach of it, and so many standard
# deviations of its noise.
_SAMPLES, _DEVIATIONS = 5000, 4.0
# Depths of the octree: cells are about as long as points are apart; weight of the points.
_LEAST_DEPTH, _MOST_DEPTH, _POINT_WEIGHT = 5, 8, 1.0
# Pieces of a smaller share of the area are crumbs at the rim.
_CRUMB = 0.01
# Rounds in which the rim is smoothed along itself, as faces leave it jagged.
_ROUNDS = 20


def unseen_share(cloud: PointCloud, closed: Mesh, reach: float) -> float:
    """Return the share of a closed surface around a cloud that its points do not show, as far off or on the other side.

    Args:
        cloud: N points, without outliers.
        closed: the surface.
        reach: distance from the points beyond that of their noise.
    """
    oriented = oriented_cloud(cloud)
    assert oriented.normals is not None  # noqa: S101  oriented
    samples = sample_surface(closed, _SAMPLES, np.random.default_rng(0))
    distances, nearest = cKDTree(cloud.verts).query(samples.points)
    along = np.einsum("nk,nk->n", oriented.normals[nearest], face_normals(closed)[samples.faces])
    reach = reach + _DEVIATIONS * noise_of_points(cloud.verts)
    return float(1 - ((np.asarray(distances) < reach) & (along > 0)).mean())


def open_surface(cloud: PointCloud) -> Mesh:
    """Return the screened Poisson surface through a cloud without what lies in its gaps or beyond its rim.

    Args:
        cloud: N points, without outliers; normals that are not known pass from point to point.

    Raises:
        MeshError: it has no faces.
    """
    from meshfit.mesh.proximity import nearest_on_surface  # brings libigl

    noise = noise_of_points(cloud.verts)
    smooth = denoised_cloud(cloud, noise)
    assert smooth.normals is not None  # noqa: S101  oriented
    apart = float(np.sqrt(np.median(sampled_areas(smooth.verts))))
    cells = math.log2(bounding_box_diagonal(smooth.verts) / max(apart, _DEVIATIONS * noise))
    depth = int(np.clip(math.ceil(cells), _LEAST_DEPTH, _MOST_DEPTH))
    surface = manifold_pieces(screened_poisson(smooth.verts, smooth.normals, depth, _POINT_WEIGHT))
    surface = refine_long_edges(surface, apart)
    seen = nearest_on_surface(surface, smooth.verts).points
    shown = manifold_pieces(Mesh(surface.verts, surface.faces[_is_shown(surface, seen, apart)]))
    return _with_smooth_rim(_without_crumbs(shown))


def _is_shown(surface: Mesh, points: Points, apart: float) -> Mask:
    """Return (F,) which faces lie at points on the surface, or in a patch of others that is too small for a gap."""
    middles = surface.verts[surface.faces].mean(axis=1)
    distances = np.asarray(cKDTree(points).query(middles)[0]) / apart
    off = distances > _OFF
    topology = Topology.of(surface)
    side = np.flatnonzero(topology.twin != NONE)
    pairs = np.stack([topology.face_of(side), topology.face_of(topology.twin[side])])
    pairs = pairs[:, off[pairs].all(axis=0)]
    count, patch = graph_components(pairs[0], pairs[1], surface.num_faces)
    farthest = np.zeros(count)
    np.maximum.at(farthest, patch, distances)
    gap: Mask = off & (farthest[patch] > _GAP)
    if not gap.any():
        return np.ones_like(gap)
    # Farther faces first, then those beside them: discs around single points would leave the rim jagged.
    to_gap = np.asarray(cKDTree(middles[gap]).query(middles)[0])
    shown: Mask = to_gap > _WIDENED * apart
    return shown


def _without_crumbs(mesh: Mesh) -> Mesh:
    count, piece = piece_of_face(mesh)
    areas = np.bincount(piece, face_areas(mesh), count)
    kept = (areas > _CRUMB * areas.sum())[piece]
    return manifold_pieces(Mesh(mesh.verts, mesh.faces[kept]))


def _with_smooth_rim(mesh: Mesh) -> Mesh:
    topology, verts = Topology.of(mesh), mesh.verts.copy()
    tail, head = topology.edges[topology.faces_per_edge == 1].T
    rim = np.unique(tail)
    for _ in range(_ROUNDS):
        total = np.zeros_like(verts)
        np.add.at(total, tail, verts[head])
        np.add.at(total, head, verts[tail])
        verts[rim] = (verts[rim] + total[rim] / 2) / 2
    return mesh.with_verts(verts)
