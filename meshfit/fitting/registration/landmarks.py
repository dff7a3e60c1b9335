"""Landmarks in a registration: the pose that they lead to, and their rows in the equations."""

import numpy as np
from scipy.sparse import csr_array

from meshfit.fitting.registration.pairs import geman_mcclure
from meshfit.fitting.registration.poses import Pose, nearest_pose
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh

_ROUNDS, _WIDTH = 10, 2.0


def pose_of_landmarks(landmarks: PlacedLandmarks, source: Mesh, *, similarity: bool) -> Pose:
    """Return the pose that brings landmarks nearest to their goals, of which some may be wrong."""
    points, weights = landmarks.points(source.verts), np.ones(len(landmarks))
    pose = nearest_pose(points, landmarks.goals, weights, similarity=similarity)
    for _ in range(_ROUNDS):
        distances = np.linalg.norm(pose.applied(points) - landmarks.goals, axis=1)
        weights = geman_mcclure(distances, _WIDTH * float(np.median(distances)) + 1e-12)
        pose = nearest_pose(points, landmarks.goals, weights, similarity=similarity)
    return pose


def summed_rows(landmarks: PlacedLandmarks, rows: csr_array) -> csr_array:
    """Return the rows of landmarks, from three rows for each of their three corners."""
    count = len(landmarks)
    landmark, corner, axis = (grid.ravel() for grid in np.indices((count, 3, 3)))
    shares = landmarks.shares[landmark, corner]
    gather = csr_array((shares, (3 * landmark + axis, 9 * landmark + 3 * corner + axis)), shape=(3 * count, 9 * count))
    return csr_array(gather @ rows)
