"""MeshLab filters: self-intersections and decimation. The one module that imports pymeshlab."""

import numpy as np
import pymeshlab
from jaxtyping import Bool

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh


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
