"""Load point clouds, with their normals, and the vertices of meshes."""

import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.doors import no_type_check
from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.any_mesh import as_path
from meshfit.mesh.cleaning import require_finite_verts
from meshfit.mesh.io.files import POINT_FORMATS, encode_mesh, mesh_output_suffix, open_mesh_file, parse_file, read_soup
from meshfit.mesh.io.mesh_file import MeshFile, write_file
from meshfit.mesh.io.obj import read_obj_normals
from meshfit.mesh.io.ply import read_ply_normals
from meshfit.mesh.io.ply_elements import read_comments
from meshfit.mesh.io.raw_points import RawPoints
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import MOST_HIDDEN, PointCloud, Position, hidden_from_sensor
from meshfit.paths import path_text
from meshfit.units import count_text

_SENSOR = "sensor"
_NORMALS = {".ply": read_ply_normals, ".obj": read_obj_normals}
# A step of coordinates that is a larger share of the size is warned of.
_COARSE = 1e-4
_LARGEST_SINGLE = float(np.finfo(np.float32).max)
# Points on a line, up to rounding, are no surface.
_THIN = 1e-6


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
    points = np.asarray(_read(file).verts, dtype=np.float64)
    require_finite_verts(points, file.name)
    return points


@no_type_check
def load_point_cloud(path: str | Path | MeshFile, *, file_format: str | None = None) -> PointCloud:
    """Read a point cloud, with its normals if it has some: PLY, OBJ, XYZ, PTS, TXT, ASC, CSV, PCD, LAS or LAZ.

    A PCD file may name its sensor. Of a mesh file, the points are its vertices. Duplicates and points that are not
    finite are left out.

    Args:
        path: of the file, which may be compressed; the text `-` is standard input.
        file_format: the format, such as `xyz`, in place of the suffix.

    Example:
        >>> import meshfit
        >>> meshfit.save_mesh("octahedron", "points.obj")
        >>> meshfit.load_point_cloud("points.obj")
        PointCloud(6 points, box 2 × 2 × 2)

    Raises:
        MeshError: no such file, an unknown format, an unreadable file, fewer than four points, or points on a line.

    Warns:
        MeshfitWarning: of points and normals that are left out.
    """
    file = path if isinstance(path, MeshFile) else open_mesh_file(as_path(path), "mesh", file_format)
    raw = _read(file)
    verts, normals = np.asarray(raw.verts, dtype=np.float64), raw.normals
    if normals is not None and len(normals) != len(verts):
        counts = f"{count_text(len(normals), 'normal')}, as there are {count_text(len(verts), 'point')}"
        warnings.warn(f"{file.name}: left out {counts}", MeshfitWarning, stacklevel=2)
        normals = None
    finite = np.isfinite(verts).all(axis=1)
    if not finite.all():
        left_out = count_text(int((~finite).sum()), "point")
        text = f"{file.name}: left out {left_out} with a coordinate that is not finite"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
        verts, normals = verts[finite], None if normals is None else normals[finite]
    require_finite_verts(verts, file.name)
    first = np.sort(np.unique(verts, axis=0, return_index=True)[1])
    if len(first) < len(verts):
        text = f"{file.name}: left out {count_text(len(verts) - len(first), 'duplicate point')}"
        warnings.warn(text, MeshfitWarning, stacklevel=2)
        verts, normals = verts[first], None if normals is None else normals[first]
    try:
        cloud = PointCloud(verts, normals, raw.sensor)
    except MeshError as error:
        raise MeshError(f"{file.name}: {error}") from None
    _warn_of_coarse_steps(verts, file.name)
    sizes = np.linalg.svd(verts - verts.mean(axis=0), compute_uv=False)
    if sizes[1] <= _THIN * sizes[0]:
        raise MeshError(
            f"{file.name}: its {count_text(len(verts), 'point')} lie on a line: there is no surface in them"
        )
    return _without_other_sensor(cloud, file.name)


def _warn_of_coarse_steps(verts: Float64[np.ndarray, "N 3"], name: str) -> None:
    """Warn of single precision so far from the origin that it moves points by much of the size of the cloud."""
    size, largest = np.linalg.norm(np.ptp(verts, axis=0)), np.abs(verts).max()
    step = float(np.spacing(np.float32(largest))) if largest < _LARGEST_SINGLE else 0.0
    if step > _COARSE * size and np.array_equal(verts, verts.astype(np.float32)):
        text = f"{name}: its coordinates are in single precision, in steps of {step:.2g} so far from the origin, and"
        remedy = "write it in double precision, or nearer to the origin"
        warnings.warn(f"{text} its size is {size:.3g}; {remedy}", MeshfitWarning, stacklevel=3)


def _without_other_sensor(cloud: PointCloud, name: str) -> PointCloud:
    """Return a cloud without its sensor if that cannot have seen its points, as others are in front of them."""
    if cloud.sensor is None or cloud.normals is not None or (hidden := hidden_from_sensor(cloud)) < MOST_HIDDEN:
        return cloud
    text = f"{name}: its viewpoint {cloud.sensor} does not see {100 * hidden:.0f} % of its points; it is left out"
    warnings.warn(text, MeshfitWarning, stacklevel=3)
    return PointCloud(cloud.verts)


def encode_point_cloud(cloud: PointCloud, suffix: str = ".ply") -> bytes:
    """Return the bytes of a file of points, with their normals, which is read back to the last bit.

    A sensor is written to PLY, as a comment.
    """
    content = encode_mesh(Mesh(cloud.verts, []), suffix, cloud.normals)
    if cloud.sensor is None or suffix != ".ply":
        return content
    place = content.index(b"element")
    return content[:place] + f"comment {_SENSOR} {' '.join(map(repr, cloud.sensor))}\n".encode() + content[place:]


def save_point_cloud(cloud: PointCloud, path: str | Path, *, file_format: str | None = None) -> None:
    """Write points, with their normals, as PLY or OBJ, in double precision.

    Args:
        cloud: the points.
        path: of the file, as for `save_mesh`.
        file_format: the format, such as `ply`, in place of the suffix.

    Raises:
        MeshError: another format, or a path that cannot be written.
    """
    suffix = mesh_output_suffix(path, file_format)
    if suffix not in _NORMALS:
        raise MeshError(f"{path_text(path)}: points are written as PLY or OBJ; give a name in .ply or .obj")
    write_file(path, encode_point_cloud(cloud, suffix))


def read_written_points(file: MeshFile) -> PointCloud | None:
    """Return the points of a file that `encode_point_cloud` wrote, exactly; None if it has faces."""
    soup = read_soup(file)
    if len(soup.sizes):
        return None
    return PointCloud(soup.verts, read_ply_normals(file.content), _sensor(file))


def _read(file: MeshFile) -> RawPoints:
    if file.suffix in POINT_FORMATS:
        return parse_file(file, POINT_FORMATS[file.suffix].read, POINT_FORMATS)
    soup = read_soup(file)
    read = _NORMALS.get(file.suffix)
    normals = soup.normals if read is None else parse_file(file, read, _NORMALS)
    return RawPoints(soup.verts, normals, _sensor(file))


def _sensor(file: MeshFile) -> Position | None:
    """Return the sensor that `encode_point_cloud` wrote."""
    comments = read_comments(file.content) if file.suffix == ".ply" else []
    words = next((words[1:] for words in comments if len(words) == 4 and words[0] == _SENSOR), [])
    try:
        x, y, z = map(float, words)
    except ValueError:
        return None
    return (x, y, z) if np.isfinite([x, y, z]).all() else None
