"""Depth of the hidden parts of a mesh, where its parts run through each other."""

import igl
import numpy as np
from scipy.spatial import cKDTree

from meshfit.mesh.geometry import face_normals
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface

_SAMPLES, _OFF = 400_000, 1e-4


def hidden_depth(mesh: Mesh) -> float:
    """The largest distance from points of a closed mesh that its other parts enclose to those in view.

    A surface that agrees with what is in view has a Hausdorff distance of so much, however good it is. Points are in
    view where the winding number just outside is 0 (Jacobson, Kavan and Sorkine-Hornung, 2013).
    """
    samples = sample_surface(mesh, _SAMPLES, np.random.default_rng(0))
    outside = samples.points + _OFF * face_normals(mesh)[samples.faces]
    hidden = np.round(igl.fast_winding_number(mesh.verts, mesh.faces, outside)) != 0
    if not hidden.any():
        return 0.0
    return float(cKDTree(samples.points[~hidden]).query(samples.points[hidden])[0].max())
