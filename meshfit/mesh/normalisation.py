"""Normalisation: the frame that maps a target from its own coordinates to those of all lengths and results."""

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from meshfit.errors import MeshError
from meshfit.mesh.geometry import bounding_box, bounding_box_diagonal
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh

Normalisation = Literal["tutorial", "box", "none"]

_AnyMesh = TypeVar("_AnyMesh", Mesh, PolygonMesh, Mesh | PolygonMesh)


@dataclass(frozen=True)
class Frame:
    """The map x → (x - centre) / scale from a mesh's own coordinates to normalised ones."""

    centre: tuple[float, float, float]
    scale: float

    def normalise(self, mesh: _AnyMesh) -> _AnyMesh:
        """Return the mesh in normalised coordinates."""
        return mesh.with_verts((mesh.verts - self.centre) / self.scale)

    def restore(self, mesh: _AnyMesh) -> _AnyMesh:
        """Return a normalised mesh in its original coordinates."""
        return mesh.with_verts(mesh.verts * self.scale + self.centre)


def frame_of(verts: Verts, how: Normalisation) -> Frame:
    """Return the frame of a target.

    Args:
        verts: (V, 3) of the target.
        how: `tutorial` puts the mean of the vertices at 0 and the largest |coordinate| at 1, as PyTorch3D's tutorial
            does; `box` puts the centre of the bounding box at 0 and its diagonal at 1; `none` changes nothing.

    Raises:
        MeshError: all vertices are at one point.
    """
    if how == "none":
        return Frame((0.0, 0.0, 0.0), 1.0)
    if how == "tutorial":
        centre = verts.mean(axis=0)
        scale = float(np.abs(verts - centre).max())
    else:
        low, high = bounding_box(verts)
        centre, scale = (low + high) / 2, bounding_box_diagonal(verts)
    if not scale > 0:
        raise MeshError("the mesh has no extent: all its vertices are at one point, so it cannot be normalised")
    return Frame((float(centre[0]), float(centre[1]), float(centre[2])), scale)
