"""MeshLab filters: distances, self-intersections, decimation. The one module that imports pymeshlab.

Every parameter is given, since defaults mislead: by default the Hausdorff filter compares mesh 0 with itself, takes
vertices only, and drops samples farther than half the diagonal.
"""

from dataclasses import dataclass

import numpy as np
import pymeshlab
from jaxtyping import Bool, Float64

from meshfit.errors import MeasureError, MeshError
from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh


@dataclass(frozen=True)
class DistanceStatistics:
    """Distances from points to a surface: largest, mean and root mean square, and the number of points."""

    largest: float
    mean: float
    rms: float
    count: int


def point_to_surface(points: Float64[np.ndarray, "N 3"], surface: Mesh) -> DistanceStatistics:
    """Return statistics of the distances from points to a surface, by MeshLab's Hausdorff filter.

    The filter's own sampler takes no seed; given points without faces, it measures exactly these.

    Raises:
        MeasureError: a coordinate is not finite, which makes MeshLab abort the process, or it left out points.
    """
    if not (np.isfinite(points).all() and np.isfinite(surface.verts).all()):
        raise MeasureError("distances need finite coordinates")
    low, high = bounding_box(np.concatenate([points, surface.verts]))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.array(points)))
    meshes.add_mesh(_to_meshlab(surface))
    distances = meshes.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        savesample=False,
        samplevert=True,
        sampleedge=False,
        samplefauxedge=False,
        sampleface=False,
        samplenum=len(points),
        maxdist=pymeshlab.PureValue(2.0 * float(np.linalg.norm(high - low)) + 1.0),
    )
    if distances["n_samples"] != len(points):
        raise MeasureError(f"MeshLab measured {distances['n_samples']} of {len(points)} points")
    return DistanceStatistics(float(distances["max"]), float(distances["mean"]), float(distances["RMS"]), len(points))


def self_intersecting_faces(mesh: Mesh) -> Bool[np.ndarray, " F"]:
    """Return (F,) which faces cross another face of the same mesh."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_to_meshlab(mesh))
    meshes.compute_selection_by_self_intersections_per_face()
    return np.asarray(meshes.current_mesh().face_selection_array(), dtype=bool)


def decimate(mesh: Mesh, num_faces: int) -> Mesh:
    """Reduce a mesh to about `num_faces` faces by quadric edge collapse (Garland and Heckbert 1997); keep its topology.

    Raises:
        MeshError: the mesh has no faces, or no face is left.
    """
    if not mesh.num_faces:
        raise MeshError("a mesh without faces cannot be decimated")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_to_meshlab(mesh))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=num_faces,
        targetperc=0.0,
        qualitythr=0.3,
        preserveboundary=True,
        boundaryweight=1.0,
        preservenormal=True,
        preservetopology=True,
        optimalplacement=True,
        planarquadric=True,
        planarweight=0.001,
        qualityweight=False,
        autoclean=True,
        selected=False,
    )
    reduced = meshes.current_mesh()
    if not reduced.face_number():
        raise MeshError(f"decimation to {num_faces} faces left nothing of a mesh of {mesh.num_faces} faces")
    return Mesh(reduced.vertex_matrix(), reduced.face_matrix().astype(np.int64))


def _to_meshlab(mesh: Mesh) -> pymeshlab.Mesh:
    return pymeshlab.Mesh(np.array(mesh.verts), np.array(mesh.faces))
