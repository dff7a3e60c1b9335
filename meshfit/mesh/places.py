"""Places on meshes by the numbers of a file: a vertex, a point within a triangle, or a position."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import NONE, Indices

Weights = tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """A place on a mesh: a vertex, a point within a triangle, or a position near the surface.

    Attributes:
        vertex: number of the vertex, from 0, as in the file of the mesh.
        face: number of the triangle, from 0, as in the file.
        weights: barycentric coordinates in the triangle, with a sum of 1.
        position: coordinates, in the frame and unit of the file.
        anatomical: whether the position is from a file that names its axes by the body (LPS or RAS), which the mesh's
            file may do otherwise.

    Example:
        >>> from meshfit.mesh.landmarks import Place
        >>> Place(face=7, weights=(0.5, 0.5, 0.0)).kind
        'face'
    """

    vertex: int | None = None
    face: int | None = None
    weights: Weights | None = None
    position: tuple[float, float, float] | None = None
    anatomical: bool = False

    @property
    def kind(self) -> str:
        """`vertex`, `face` or `position`."""
        return "vertex" if self.vertex is not None else "position" if self.face is None else "face"


@dataclass(frozen=True, eq=False)
class Numbering:
    """The vertices and faces of a mesh file, which places refer to.

    Attributes:
        verts: (N, 3) the vertices of the file.
        corners: vertices of its faces, one after the other.
        sizes: (F,) number of corners of each face.
        to_mesh: (N,) index of each vertex in the mesh, `NONE` for those that it does not have; None if the mesh has
            vertices of its own.
    """

    verts: Float64[np.ndarray, "N 3"]
    corners: Indices
    sizes: Indices
    to_mesh: Indices | None

    @classmethod
    def of(cls, mesh: Mesh | PolygonMesh | PointCloud) -> "Numbering":
        """Return the numbering of a mesh, or of points, by themselves."""
        none = np.empty(0, dtype=np.int64)
        if isinstance(mesh, PointCloud):
            return cls(mesh.verts, none, none, np.arange(mesh.num_verts))
        polygons = PolygonMesh.of(mesh)
        return cls(mesh.verts, polygons.corners, polygons.sizes, np.arange(mesh.num_verts))

    @classmethod
    def of_file(cls, name: str, vertex_map: VertexMap | None = None) -> "Numbering":
        """Return the numbering of a target's file.

        Args:
            name: as for `target_path`.
            vertex_map: the vertices of the mesh that those of the file became.
        """
        from meshfit.mesh.io.files import POINT_FORMATS, parse_file, read_soup
        from meshfit.mesh.targets import open_target

        file = open_target(name)
        to_mesh, none = None if vertex_map is None else vertex_map.first, np.empty(0, dtype=np.int64)
        if file.suffix in POINT_FORMATS:
            verts = parse_file(file, POINT_FORMATS[file.suffix].read, POINT_FORMATS).verts
            return cls(np.asarray(verts, dtype=np.float64), none, none, to_mesh)
        soup = read_soup(file)
        return cls(np.asarray(soup.verts, dtype=np.float64), soup.corners, soup.sizes, to_mesh)

    def corners_of(self, face: int) -> Indices:
        """Return the corners of a face."""
        start = int(self.sizes[:face].sum())
        return self.corners[start : start + int(self.sizes[face])]

    def corners_and_weights(self, place: Place, name: str, role: str) -> tuple[Indices, Weights]:
        """Return three vertices of the file, and their weights, of a place that is a vertex or within a face.

        Raises:
            MeshError: a vertex or a face that the file does not have, or a face that is no triangle.
        """
        if place.vertex is not None:
            if not 0 <= place.vertex < len(self.verts):
                raise MeshError(f"{name}: no vertex {place.vertex}; the {role} has {len(self.verts):,}, from 0")
            return np.full(3, place.vertex), (1.0, 0.0, 0.0)
        assert place.face is not None  # noqa: S101  as it is no position
        assert place.weights is not None  # noqa: S101  they come with a face
        if not 0 <= place.face < len(self.sizes):
            raise MeshError(f"{name}: no face {place.face}; the {role} has {len(self.sizes):,}, from 0")
        corners = self.corners_of(place.face)
        if len(corners) != 3:
            raise MeshError(f"{name}: face {place.face} has {len(corners)} corners; weights are those of a triangle")
        return corners, place.weights

    def mesh_verts(self, verts: Indices) -> Indices | None:
        """Return vertices of the mesh for those of the file; None if it lacks one of them."""
        if self.to_mesh is None or (self.to_mesh[verts] == NONE).any():
            return None
        return np.asarray(self.to_mesh[verts])

    def position(self, place: Place, name: str, role: str) -> Float64[np.ndarray, "3"]:
        """Return the position of a place, in the coordinates of the file.

        Raises:
            MeshError: as `corners_and_weights` does.
        """
        if place.position is not None:
            return np.array(place.position)
        corners, weights = self.corners_and_weights(place, name, role)
        return np.asarray(np.asarray(weights) @ self.verts[corners])
