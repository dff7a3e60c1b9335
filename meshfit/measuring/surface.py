"""Checks of surfaces before they are measured."""

import warnings
from collections.abc import Callable

import numpy as np

from meshfit.doors import no_type_check
from meshfit.errors import MeasureError, MeshfitWarning
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.any_target import as_mesh_or_points
from meshfit.mesh.cleaning import outward, with_turning
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud

# MeshLab, which counts self-intersecting faces, holds coordinates in single precision, and squares them.
_LARGEST_COORDINATE = 1e15


@no_type_check
def as_triangles(mesh: MeshLike, role: str) -> Mesh:
    """Return a mesh in any form that `as_mesh` takes as triangles; a `Mesh` stays as it is, for `require_surface`."""
    return mesh if isinstance(mesh, Mesh) else as_mesh(mesh, role, triangles=True)


@no_type_check
def as_target(mesh: MeshLike | PointCloud) -> Mesh | PointCloud:
    """Return the target to measure to, as triangles or as points; a closed mesh that is inside out is turned.

    Raises:
        MeasureError: it has no surface.

    Warns:
        MeshfitWarning: as loading it does; those of faces that are turned say so.
    """
    return turned_target(lambda: mesh if isinstance(mesh, Mesh) else as_mesh_or_points(mesh))


def turned_target(load: Callable[[], Mesh | PointCloud]) -> Mesh | PointCloud:
    """Load the target to measure to, and turn it as `as_target` does, with its errors and warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        target = load()
    require_target(target)
    turned = outward(target)
    texts = [str(warning.message) for warning in caught]
    for warning, text in zip(caught, texts if turned is target else with_turning(texts, "measurement"), strict=True):
        warnings.warn(text, warning.category, stacklevel=4)
    return turned


def require_target(target: Mesh | PointCloud) -> None:
    """Refuse a target without a surface, or points that are not finite.

    Raises:
        MeasureError: as `require_surface` does.
    """
    if isinstance(target, PointCloud):
        _require_coordinates(target, "target", "point")
    else:
        require_surface(target, "target")


def require_surface(mesh: Mesh, role: str) -> None:
    """Refuse a mesh that has no surface to measure.

    Args:
        mesh: the mesh.
        role: its name in the message, such as `result`.

    Raises:
        MeasureError: no faces, no area, a face with an index out of range, or a coordinate that is not finite or beyond
            1e15.
    """
    if not mesh.num_faces:
        raise MeasureError(f"the {role} has {mesh.num_verts} vertices and no faces: there is no surface to measure")
    outside = ((mesh.faces < 0) | (mesh.faces >= mesh.num_verts)).any(axis=1)
    if outside.any():
        bad = int(np.flatnonzero(outside)[0])
        allowed = f"vertices are numbered 0 to {mesh.num_verts - 1}"
        raise MeasureError(f"the {role}'s face {bad} is {mesh.faces[bad].tolist()}, but {allowed}")
    _require_coordinates(mesh, role, "vertex")
    if not face_areas(mesh).sum() > 0:
        raise MeasureError(f"the {role} has no area: all its faces ({mesh.num_faces}) are degenerate")


def _require_coordinates(mesh: Mesh | PointCloud, role: str, noun: str) -> None:
    # A NaN makes MeshLab abort the whole process.
    usable = (np.abs(mesh.verts) <= _LARGEST_COORDINATE).all(axis=1)
    if not usable.all():
        bad = int(np.flatnonzero(~usable)[0])
        expected = f"expected finite coordinates up to {_LARGEST_COORDINATE:g}"
        raise MeasureError(f"the {role}: {expected}, got {mesh.verts[bad].tolist()} at {noun} {bad}")
