"""Deviation of a mesh from a target: the distance of each vertex and each face, with its side where there is one."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from meshfit.doors import no_type_check
from meshfit.measuring.surface import as_target, as_triangles, require_surface
from meshfit.mesh.any_mesh import MeshLike
from meshfit.mesh.io.ply import write_ply_values
from meshfit.mesh.io.vtk_xml import write_vtp_values
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import is_inside, point_distances
from meshfit.mesh.topology import Topology
from meshfit.units import count_text

Points = Float64[np.ndarray, "N 3"]


@dataclass(frozen=True, eq=False)
class Deviation:
    """Distances of a mesh from a target, in the unit of the vertices.

    Attributes:
        verts: (V,) of the vertices.
        faces: (F,) of the faces, at their centroids.
        signed: whether they are negative inside the target and positive outside; otherwise none is negative.

    Example:
        >>> import meshfit
        >>> meshfit.deviation("octahedron", "icosahedron")
        Deviation(6 verts, 8 faces, -0.2173 to 0.1493, negative inside)
    """

    verts: Float64[np.ndarray, " V"]
    faces: Float64[np.ndarray, " F"]
    signed: bool

    def __repr__(self) -> str:
        """Return the numbers of vertices and faces, and the range of the distances."""
        counts = f"{count_text(len(self.verts), 'vert')}, {count_text(len(self.faces), 'face')}"
        both = np.concatenate([self.verts, self.faces])
        return f"Deviation({counts}, {both.min():.4g} to {both.max():.4g}{', negative inside' if self.signed else ''})"

    @property
    def name(self) -> str:
        """The name of the values in files: `distance`, or `unsigned_distance`."""
        return "distance" if self.signed else "unsigned_distance"


@no_type_check
def deviation(result: "MeshLike", target: "MeshLike | PointCloud") -> Deviation:
    """Return the distance of each vertex and face of a mesh from a target, signed if the target is closed.

    Args:
        result: V vertices, F faces, in any form that `as_mesh` takes, such as a `FitResult`; polygons are triangulated.
        target: the mesh to measure to, in any form that `as_mesh` takes. A closed one that is inside out is turned. Or
            points, to the nearest of which distances are.

    Example:
        >>> import meshfit
        >>> cube = meshfit.as_mesh("cube")
        >>> half = cube.with_verts(cube.verts / 2)
        >>> bool((meshfit.deviation(half, cube).verts < 0).all())
        True

    Raises:
        MeasureError: a mesh without a surface.
    """
    surface, goal = as_triangles(result, "result"), as_target(target)
    require_surface(surface, "result")
    points = np.concatenate([surface.verts, surface.verts[surface.faces].mean(axis=1)])
    distances = distances_to_target(goal, points)
    signed = isinstance(goal, Mesh) and Topology.of(goal).is_watertight
    if isinstance(goal, Mesh) and signed:
        distances = np.where(is_inside(goal, points, distances), -distances, distances)
    return Deviation(distances[: surface.num_verts], distances[surface.num_verts :], signed)


def distances_to_target(target: Mesh | PointCloud, points: Points) -> Float64[np.ndarray, " N"]:
    """Return (N,) the distance from each point to the surface of a mesh, or to the nearest point of a cloud."""
    if not isinstance(target, PointCloud):
        return point_distances(target, points)
    nearest = nearest_point_query(target.verts)(points)
    return np.asarray(np.linalg.norm(points - target.verts[nearest], axis=1))


def encode_deviation(mesh: Mesh, values: Deviation, file_format: str = ".ply") -> bytes:
    """Return the bytes of a file of a mesh with its deviation, in double precision, of vertices and faces.

    The values are named `distance` if signed, else `unsigned_distance`. In PLY, `quality` repeats them, which MeshLab
    shows. VTK and ParaView read the shape alone from PLY files; a VTP file gives them the values too.

    Args:
        mesh: the mesh.
        values: its deviation.
        file_format: `.ply`, or `.vtp` for VTK's XML format.
    """
    if file_format == ".vtp":
        return write_vtp_values(mesh, {values.name: values.verts}, {values.name: values.faces})
    side = "negative inside the target" if values.signed else "unsigned, since the target is not a closed surface"
    comment = f"{values.name}: {side}; of faces at their centroids"
    return write_ply_values(mesh, _named(values, values.verts), _named(values, values.faces), comment)


def _named(values: Deviation, numbers: Float64[np.ndarray, " N"]) -> Mapping[str, Float64[np.ndarray, " N"]]:
    return {values.name: numbers, "quality": numbers}
