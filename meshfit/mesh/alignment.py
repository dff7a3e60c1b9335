"""Placing one mesh on another before a fit: by centres, by principal axes, or by nearest points."""

from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from meshfit.errors import MeshError
from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.nearest import Points, nearest_point_query
from meshfit.mesh.sampling import sample_surface

Alignment = Literal["none", "center", "pca", "icp"]

_POINTS = 5000
_ICP_STEPS, _ICP_GAIN = 60, 1e-6


def align(source: Mesh, target: Mesh, how: Alignment) -> Mesh:
    """The source, placed on the target.

    `center` brings the centroids of the surfaces together. `pca` also turns the principal axes of the source onto those
    of the target, of the four ways without a reflection the one nearest to it, and scales it by the root mean square
    distances from the centroids. `icp` then lets nearest points settle rotation, position and scale (Besl and McKay, A
    method for registration of 3-D shapes, 1992).

    Args:
        source: what to place.
        target: where to.
        how: `none`, `center`, `pca` or `icp`.

    Raises:
        MeshError: a surface without extent.
    """
    if how == "none":
        return source
    p, q = _sampled(source, "source"), _sampled(target, "target")
    centre, place = p.mean(0), q.mean(0)
    if how == "center":
        return Mesh(source.verts - centre + place, source.faces)
    scale = float(np.sqrt((q - place).var(0).sum() / (p - centre).var(0).sum()))
    turn = _turn_of_axes((p - centre) * scale, q - place)
    verts, points = ((each - centre) @ turn.T * scale + place for each in (source.verts, p))
    if how == "icp":
        verts = _settled(verts, points, q)
    return Mesh(verts, source.faces)


def boxes_are_disjoint(source: Mesh, target: Mesh) -> bool:
    """Whether the bounding boxes of two meshes have nothing in common."""
    (low, high), (floor, ceiling) = bounding_box(source.verts), bounding_box(target.verts)
    return bool((low > ceiling).any() or (floor > high).any())


def _sampled(mesh: Mesh, role: str) -> Points:
    if not np.ptp(mesh.verts, axis=0).max() > 0:
        raise MeshError(f"{role}: a surface without extent cannot be aligned")
    return sample_surface(mesh, _POINTS, np.random.default_rng(0)).points


def _turn_of_axes(p: Points, q: Float64[np.ndarray, "M 3"]) -> Float64[np.ndarray, "3 3"]:
    """The rotation of the principal axes of p onto those of q that brings the points nearest."""
    ours, theirs = (np.linalg.svd(points, full_matrices=False)[2] for points in (p, q))
    nearest = nearest_point_query(q)
    best, least = np.eye(3), np.inf
    for signs in product((1.0, -1.0), repeat=3):
        turn = theirs.T @ np.diag(signs) @ ours
        if np.linalg.det(turn) > 0:
            moved = p @ turn.T
            distance = float(((q[nearest(moved)] - moved) ** 2).sum(1).mean())
            if distance < least:
                best, least = turn, distance
    return best


def _settled(verts: Verts, points: Points, q: Float64[np.ndarray, "M 3"]) -> Verts:
    nearest, before = nearest_point_query(q), np.inf
    for _ in range(_ICP_STEPS):
        goal = q[nearest(points)]
        centre, place = points.mean(0), goal.mean(0)
        rotation, _ = Rotation.align_vectors(goal - place, points - centre)
        turned = rotation.apply(points - centre)
        scale = float((turned * (goal - place)).sum() / (turned**2).sum())
        points = turned * scale + place
        verts = rotation.apply(verts - centre) * scale + place
        distance = float(((goal - points) ** 2).sum(1).mean())
        if distance > before * (1 - _ICP_GAIN):
            break
        before = distance
    return verts
