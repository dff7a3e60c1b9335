"""Alignment of one mesh with another before a fit: by centroids, boxes, principal axes, or ICP."""

from itertools import product

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from meshfit.errors import MeshError
from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.nearest import Points, nearest_point_query
from meshfit.mesh.placing_options import Alignment
from meshfit.mesh.point_cloud import PointCloud, sampled_areas
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.sampling import sample_surface

_POINTS = 5000
_ICP_STEPS, _ICP_GAIN = 60, 1e-6
_LARGEST_RATIO, _LEAST_SHARE, _FLAT = 10.0, 0.05, 1e-9


def align(source: Mesh, target: Mesh | PointCloud, how: Alignment) -> Mesh:
    """Return the source, aligned with the target.

    `box` moves the bounding box of the source onto that of the target, and stretches it along each axis. `center` makes
    the centroids of the surfaces coincide. `pca` also rotates the principal axes of the source onto
    those of the target, by the one of the four rotations that brings it nearest, and scales it by the root mean square
    distances from the centroids. `icp` then refines rotation, position and scale by iterated closest points (Besl and
    McKay, A method for registration of 3-D shapes, 1992).

    Args:
        source: the mesh to move.
        target: the mesh, or the points of a scan, to align it with.
        how: `none`, `center`, `box`, `pca` or `icp`.

    Raises:
        MeshError: a surface without extent.
    """
    if how == "none":
        return source
    if how == "box":
        return source.with_verts(_into_box(source.verts, target.verts))
    p, q = _sampled(source, "source"), _sampled(target, "target")
    centre, goal = p.mean(0), q.mean(0)
    if how == "center":
        return source.with_verts(source.verts - centre + goal)
    scale = float(np.sqrt((q - goal).var(0).sum() / (p - centre).var(0).sum()))
    rotation = _rotation_of_axes((p - centre) * scale, q - goal)
    verts, points = ((points - centre) @ rotation.T * scale + goal for points in (source.verts, p))
    if how == "icp":
        verts = _iterate_closest_points(verts, points, q)
    return source.with_verts(verts)


def boxes_are_disjoint(source: Mesh | PolygonMesh, target: Mesh | PolygonMesh | PointCloud) -> bool:
    """Return whether the bounding boxes of two meshes do not overlap."""
    (source_low, source_high), (target_low, target_high) = bounding_box(source.verts), bounding_box(target.verts)
    return bool((source_low > target_high).any() or (target_low > source_high).any())


def describe_mismatch(first: Mesh | PointCloud, second: Mesh | PointCloud) -> str:
    """Return how the bounding boxes of two meshes that should lie on each other differ; empty if they do not.

    They do where they differ in size more than tenfold, or hardly overlap: by less than 5 % of the smaller box.
    """
    boxes = [bounding_box(mesh.verts) for mesh in (first, second)]
    sizes = [float(np.linalg.norm(high - low)) for low, high in boxes]
    small, large = sorted(sizes)
    if large > _LARGEST_RATIO * small:
        return f"differ in size {large / small:.3g}-fold" if small > 0 else "differ in size"
    (first_low, first_high), (second_low, second_high) = boxes
    shared = np.minimum(first_high, second_high) - np.maximum(first_low, second_low)
    shorter = np.minimum(first_high - first_low, second_high - second_low)
    # A flat box has no volume, but overlaps along the other axes.
    thick = shorter > _FLAT * large
    share = float(np.prod(np.clip(shared[thick], 0.0, None) / shorter[thick]))
    apart = bool((shared < -_FLAT * large).any())
    if apart or share <= 0:
        return "do not overlap"
    return "hardly overlap" if share < _LEAST_SHARE else ""


def _into_box(verts: Verts, goal: Verts) -> Verts:
    (low, high), (goal_low, goal_high) = bounding_box(verts), bounding_box(goal)
    if not (high - low).max() > 0:
        raise MeshError("source: a surface without extent cannot be aligned")
    sides = np.where(high > low, high - low, 1.0)  # a flat source stays flat
    return np.asarray((verts - (low + high) / 2) / sides * (goal_high - goal_low) + (goal_low + goal_high) / 2)


def _sampled(mesh: Mesh | PointCloud, role: str) -> Points:
    if not np.ptp(mesh.verts, axis=0).max() > 0:
        raise MeshError(f"{role}: a surface without extent cannot be aligned")
    if isinstance(mesh, PointCloud):
        areas = sampled_areas(mesh.verts).cumsum()
        at = (np.arange(_POINTS) + 0.5) * (areas[-1] / _POINTS)
        return np.asarray(mesh.verts[np.searchsorted(areas, at).clip(max=mesh.num_verts - 1)])
    return sample_surface(mesh, _POINTS, np.random.default_rng(0)).points


def _rotation_of_axes(p: Points, q: Float64[np.ndarray, "M 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation of the principal axes of p onto those of q that brings the points nearest."""
    axes_of_p, axes_of_q = (np.linalg.svd(points, full_matrices=False)[2] for points in (p, q))
    nearest = nearest_point_query(q)
    best, least = np.eye(3), np.inf
    for signs in product((1.0, -1.0), repeat=3):
        rotation = axes_of_q.T @ np.diag(signs) @ axes_of_p
        if np.linalg.det(rotation) > 0:
            moved = p @ rotation.T
            distance = float(((q[nearest(moved)] - moved) ** 2).sum(1).mean())
            if distance < least:
                best, least = rotation, distance
    return best


def _iterate_closest_points(verts: Verts, points: Points, q: Float64[np.ndarray, "M 3"]) -> Verts:
    nearest, before = nearest_point_query(q), np.inf
    for _ in range(_ICP_STEPS):
        closest = q[nearest(points)]
        centre, goal = points.mean(0), closest.mean(0)
        rotation, _ = Rotation.align_vectors(closest - goal, points - centre)
        rotated = rotation.apply(points - centre)
        scale = float((rotated * (closest - goal)).sum() / (rotated**2).sum())
        points = rotated * scale + goal
        verts = rotation.apply(verts - centre) * scale + goal
        distance = float(((closest - points) ** 2).sum(1).mean())
        if distance > before * (1 - _ICP_GAIN):
            break
        before = distance
    return verts
