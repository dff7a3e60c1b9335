"""Normalisation: the frame that maps a target from its own coordinates to those of all lengths and results."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar, get_args, overload

import numpy as np

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, MeshError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.geometry import bounding_box, bounding_box_diagonal
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.placing_options import Normalisation
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.printable import option_text
from meshfit.specs import suggest

_AnyMesh = TypeVar("_AnyMesh", Mesh, PolygonMesh, PointCloud, Mesh | PolygonMesh, Mesh | PointCloud)


@dataclass(frozen=True)
class Frame:
    """The map x → (x - centre) / scale from a mesh's own coordinates to normalised ones.

    Example:
        >>> import meshfit
        >>> frame = meshfit.Frame(centre=(1.0, 0.0, 0.0), scale=10.0)
        >>> frame.normalise("octahedron")
        Mesh(6 verts, 8 faces, box 0.2 × 0.2 × 0.2)
        >>> frame.restore(frame.normalise("octahedron"))
        Mesh(6 verts, 8 faces, box 2 × 2 × 2)
    """

    centre: tuple[float, float, float]
    scale: float

    def __repr__(self) -> str:
        """Return centre and scale, to six digits."""
        return f"Frame(centre=({', '.join(f'{value:g}' for value in self.centre)}), scale={self.scale:g})"

    @overload
    def normalise(self, mesh: _AnyMesh) -> _AnyMesh: ...  # type: ignore[overload-overlap]
    @overload
    def normalise(self, mesh: "MeshLike") -> Mesh | PolygonMesh: ...
    @no_type_check
    def normalise(self, mesh: "MeshLike | PointCloud") -> Mesh | PolygonMesh | PointCloud:
        """Return a mesh, in any form that `as_mesh` takes, or points, in normalised coordinates."""
        return _moved(mesh, lambda verts: (verts - self.centre) / self.scale)

    @overload
    def restore(self, mesh: _AnyMesh) -> _AnyMesh: ...  # type: ignore[overload-overlap]
    @overload
    def restore(self, mesh: "MeshLike") -> Mesh | PolygonMesh: ...
    @no_type_check
    def restore(self, mesh: "MeshLike | PointCloud") -> Mesh | PolygonMesh | PointCloud:
        """Return a normalised mesh, in any form that `as_mesh` takes, or points, in its original coordinates."""
        return _moved(mesh, lambda verts: verts * self.scale + self.centre)


@no_type_check
def _moved(mesh: "MeshLike | PointCloud", move: Callable[[Verts], Verts]) -> Mesh | PolygonMesh | PointCloud:
    if isinstance(mesh, PointCloud):
        return mesh.moved(move)
    mesh = as_mesh(mesh)
    return mesh.with_verts(move(mesh.verts))


IDENTITY = Frame((0.0, 0.0, 0.0), 1.0)
"""The frame of a mesh that is not normalised."""


@no_type_check
def frame_of(target: "MeshLike | PointCloud | Verts", how: Normalisation = "tutorial") -> Frame:
    """Return the frame of a target.

    Args:
        target: in any form that `as_mesh` takes, or points, or its (V, 3) vertices alone.
        how: `tutorial` puts the mean of the vertices at 0 and the largest |coordinate| at 1, as PyTorch3D's tutorial
            does; `box` puts the centre of the bounding box at 0 and its diagonal at 1; `cube` likewise, with its
            longest side at 1; `sphere` puts the mean of the vertices at 0 and the farthest at distance 1; `none`
            changes nothing.

    Example:
        >>> import meshfit
        >>> frame = meshfit.frame_of("cube", "box")
        >>> frame
        Frame(centre=(0, 0, 0), scale=2)
        >>> frame.normalise("cube")
        PolygonMesh(8 verts, 6 quads, box 0.5774 × 0.5774 × 0.5774)

    Raises:
        ConfigError: another frame.
        MeshError: not a mesh, or all vertices are at one point.
    """
    if not isinstance(how, str) or how not in get_args(Normalisation):
        raise ConfigError(f"frame: got {option_text(how)}; {suggest(str(how), get_args(Normalisation))}")
    if isinstance(target, PointCloud):
        target = target.verts
    verts = target if isinstance(target, np.ndarray) else as_mesh(target, "target").verts
    if verts.ndim != 2 or verts.shape[1] != 3 or not len(verts):
        raise MeshError(f"target: expected (V, 3) vertices, got an array of shape {verts.shape}")
    if how == "none":
        return IDENTITY
    if how in ("tutorial", "sphere"):
        centre = verts.mean(axis=0)
        offsets = np.abs(verts - centre) if how == "tutorial" else np.linalg.norm(verts - centre, axis=1)
        scale = float(offsets.max())
    else:
        low, high = bounding_box(verts)
        centre, scale = (low + high) / 2, bounding_box_diagonal(verts) if how == "box" else float((high - low).max())
    if not scale > 0:
        raise MeshError("the mesh has no extent: all its vertices are at one point, so it cannot be normalised")
    return Frame((float(centre[0]), float(centre[1]), float(centre[2])), scale)


def placed(verts: Verts, radius: float | None, centre: tuple[float, float, float] | None = (0.0, 0.0, 0.0)) -> Verts:
    """Scale vertices about their mean, and move their mean.

    Args:
        verts: (V, 3).
        radius: distance of the farthest vertex from the mean; None keeps it.
        centre: of the mean; None keeps it.

    Raises:
        MeshError: all vertices are at one point.
    """
    mean = verts.mean(axis=0)
    offset = verts - mean
    extent = float(np.linalg.norm(offset, axis=1).max())
    if not extent > 0:
        raise MeshError("the mesh has no extent")
    scale = 1.0 if radius is None else radius / extent
    return np.asarray(offset * scale + (mean if centre is None else centre))
