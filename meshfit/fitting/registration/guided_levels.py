"""Guidance of the levels that follow a registration: it is refined with the source, and adapts correspondences."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float64, Int64

from meshfit.errors import error_prefix
from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.problem import Problem
from meshfit.fitting.registration.guidance import NO_GUIDANCE, Guidance
from meshfit.fitting.registration.pairs import geman_mcclure
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.attributes import NO_ATTRIBUTES
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.registry import resolve

# Weight of a landmark, relative to the mean weight of a vertex, and the distance at which a quarter of it is left,
# relative to the diagonal of the target.
_WEIGHT, _WIDTH = 10.0, 0.01


class RefinedGuide:
    """The guidance of a problem on each level of its source."""

    def __init__(self, problem: Problem, settings: GaussNewtonSettings) -> None:
        polygons = problem.polygons if isinstance(resolve(problem.scheme), PolygonScheme) else None
        rest: Mesh | PolygonMesh = problem.source if polygons is None else polygons
        self._scheme = problem.scheme
        known = problem.guidance or NO_GUIDANCE
        self._levels = [(rest.with_attributes(NO_ATTRIBUTES), known.mirrored(rest) if settings.symmetric else known)]
        if settings.symmetric and settings.levels:
            with error_prefix("refined by levels"):
                self.at(settings.levels)

    @property
    def has_landmarks(self) -> bool:
        """Whether there are landmarks."""
        return self._levels[0][1].landmarks is not None

    @property
    def holds(self) -> bool:
        """Whether something is fixed, rigid or symmetric."""
        guidance = self._levels[0][1]
        return any(values is not None for values in (guidance.fixed, guidance.rigid, guidance.mirror))

    def at(self, level: int) -> Guidance:
        """Return the guidance after a number of levels."""
        known = self._levels[0][1]
        return self._at(level)[1] if known.landmarks is not None or known.steers else NO_GUIDANCE

    def rest_at(self, level: int) -> Verts:
        """Return the vertices of the source after a number of levels."""
        return self._at(level)[0].verts

    def _at(self, level: int) -> tuple[Mesh | PolygonMesh, Guidance]:
        while len(self._levels) <= level:
            mesh, guidance = self._levels[-1]
            finer = subdivide(mesh, self._scheme, 1)
            assert isinstance(finer, Mesh | PolygonMesh)  # noqa: S101  as it is no curve
            refined = guidance.refined(mesh, self._scheme)
            self._levels.append((finer, refined if guidance.mirror is None else refined.mirrored(finer)))
        return self._levels[level]


def adapted_pairs(pairs: Correspondences, shape: Shape, guidance: Guidance, diagonal: float) -> Correspondences:
    """Return correspondences with the confidence at their vertices, and with landmarks.

    A landmark is paired with its goal three times, along orthogonal directions.

    Args:
        pairs: correspondences of the surface.
        shape: the surface.
        guidance: of its vertices.
        diagonal: of the target.
    """
    faces = shape.connectivity.faces
    if guidance.weights is not None:
        confidence = torch.tensor(guidance.weights).to(pairs.weights)
        pairs = replace(pairs, weights=pairs.weights * (confidence[faces[pairs.face]] * pairs.corners).sum(1))
    landmarks = guidance.used_landmarks
    if landmarks is None:
        return pairs
    within, weights_there = _within_faces(landmarks, faces.cpu().numpy())
    face, corners = torch.tensor(within, device=faces.device), torch.tensor(weights_there).to(pairs.corners)
    away = torch.tensor(landmarks.goals).to(pairs.residuals) - shape.points(face, corners)
    robust = geman_mcclure(away.norm(dim=1).cpu().double().numpy(), _WIDTH * diagonal)
    weights = torch.tensor(robust).to(pairs.weights) * (_WEIGHT * 2 / shape.connectivity.num_verts)
    axes = torch.eye(3, dtype=away.dtype, device=away.device).repeat_interleave(len(away), 0)
    return replace(
        pairs,
        face=torch.cat([pairs.face, face.repeat(3)]),
        corners=torch.cat([pairs.corners, corners.repeat(3, 1)]),
        normals=torch.cat([pairs.normals, axes]),
        residuals=torch.cat([pairs.residuals, away.repeat(3, 1)]),
        weights=torch.cat([pairs.weights, weights.repeat(3)]),
    )


def _within_faces(
    landmarks: PlacedLandmarks, faces: Int64[np.ndarray, "F 3"]
) -> tuple[Int64[np.ndarray, " L"], Float64[np.ndarray, "L 3"]]:
    """Return a face of each landmark, and its barycentric coordinates there; of other triangles, the nearest corner."""
    number = {tuple(sorted(face)): index for index, face in enumerate(faces.tolist())}
    some_face = dict(zip(faces.ravel().tolist(), np.arange(len(faces)).repeat(3).tolist(), strict=True))
    found = np.zeros(len(landmarks), dtype=np.int64)
    weights = np.zeros((len(landmarks), 3))
    for index, (corners, shares) in enumerate(zip(landmarks.corners.tolist(), landmarks.shares, strict=True)):
        at = number.get(tuple(sorted(corners)))
        places = [(corner, share) for corner, share in zip(corners, shares, strict=True)]
        if at is None:
            nearest = corners[int(np.argmax(shares))]
            at, places = some_face[nearest], [(nearest, 1.0)]
        found[index] = at
        for corner, share in places:
            weights[index, faces[at].tolist().index(corner)] += share
    return found, weights
