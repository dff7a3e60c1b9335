"""Targets in any form: a mesh, or the points of a scan."""

import os
from pathlib import Path

from meshfit.doors import no_type_check
from meshfit.errors import NoFacesError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.faceless import no_faces_message
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.targets import load_target
from meshfit.paths import path_text


@no_type_check
def as_mesh_or_points(target: "MeshLike | PointCloud", role: str = "target") -> Mesh | PointCloud:
    """Return a target as triangles, or as points: a `PointCloud`, or the path of a file of points alone.

    Args:
        target: anything that `as_mesh` takes, too.
        role: name of the target in messages.

    Raises:
        MeshError: as `as_mesh` and `load_point_cloud` do.
    """
    if isinstance(target, PointCloud):
        return target
    try:
        return as_mesh(target, role, triangles=True)
    except NoFacesError:
        if not isinstance(target, str | os.PathLike):
            raise
    return load_target(Path(target))


def require_mesh(target: Mesh | PointCloud, name: str) -> Mesh:
    """Refuse points where a mesh is expected.

    Raises:
        NoFacesError: the target is a point cloud.
    """
    if isinstance(target, PointCloud):
        raise NoFacesError(f"{path_text(name)}: {no_faces_message(target.num_verts)}")
    return target
