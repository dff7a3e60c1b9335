"""The target of a registration as points: its vertices, or samples where these are too few or too many."""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.template import Template, remoteness_in
from meshfit.mesh.geometry import face_areas, face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import refine_long_edges
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud, rim_of, sampled_areas
from meshfit.mesh.sampling import sample_surface

# Numbers of points to match with, and of neighbours along which distances between points are measured.
_FEWEST, _MOST, _SAMPLES, _NEIGHBOURS = 4000, 40_000, 20_000, 10
# Distance that two opposite normals are worth, halved, in distances of neighbours: sides that touch are not neighbours.
_NORMALS = 4.0


def target_points(target: Mesh | PointCloud) -> OrientedPoints:
    """Return the points of a target: of a mesh, its vertices, or samples if it has very many; of a scan, its own."""
    if isinstance(target, PointCloud):
        if target.num_verts > _MOST:
            target = target.subset(np.sort(np.random.default_rng(0).permutation(target.num_verts)[:_MOST]))
        scan = oriented_cloud(target)
        assert scan.normals is not None  # noqa: S101  oriented
        parts = scan.verts, scan.normals, sampled_areas(scan.verts), rim_of(scan)
        return OrientedPoints(*parts, _remoteness(scan.verts, scan.normals))
    if target.num_verts < _FEWEST:
        # An equilateral triangle stands for two faces per vertex.
        target = refine_long_edges(target, math.sqrt(2 / math.sqrt(3) * float(face_areas(target).sum()) / _FEWEST))
    if target.num_verts <= _MOST:
        return Template(target).points_at(target.verts)
    samples = sample_surface(target, _SAMPLES, np.random.default_rng(0))
    normals = face_normals(target)[samples.faces]
    rim = Template(target).rim[target.faces[samples.faces]].any(axis=1)
    areas = np.ones(_SAMPLES)
    return OrientedPoints(samples.points, normals, areas, rim, _remoteness(samples.points, normals))


def _remoteness(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the remoteness of points, from distances along their neighbours."""
    spacing = float(np.median(np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1]))
    joined = np.hstack([points, _NORMALS * spacing * normals])
    rows = np.asarray(cKDTree(joined).query(joined, k=min(_NEIGHBOURS + 1, len(points)))[1])
    tail, head = np.arange(len(points)).repeat(rows.shape[1] - 1), rows[:, 1:].ravel()
    lengths = np.linalg.norm(points[tail] - points[head], axis=1)
    return remoteness_in(coo_array((lengths, (tail, head)), shape=(len(points), len(points))).tocsr())
