"""Load point clouds, and the vertices of meshes."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.cleaning import require_finite_verts
from meshfit.mesh.io.files import POINT_FORMATS, open_mesh_file, parse_file, read_soup
from meshfit.mesh.io.mesh_file import MeshFile


def load_points(path: str | Path | MeshFile, *, file_format: str | None = None) -> Float64[np.ndarray, "N 3"]:
    """Read a point cloud in one of `POINT_FORMATS`, or all vertices of a mesh file.

    Args:
        path: of the file; as for `load_mesh`.
        file_format: the format, such as `xyz`, in place of the suffix.

    Example:
        >>> points = load_points("scan.las")  # doctest: +SKIP

    Raises:
        MeshError: no such file, an unknown format, an unreadable file, one without points, or a coordinate that is not
            finite or beyond 1e60.
    """
    file = path if isinstance(path, MeshFile) else open_mesh_file(path, "mesh", file_format)
    if file.suffix in POINT_FORMATS:
        points = parse_file(file, POINT_FORMATS[file.suffix].read, POINT_FORMATS)
    else:
        points = read_soup(file).verts
    points = np.asarray(points, dtype=np.float64)
    require_finite_verts(points, file.name)
    return points
