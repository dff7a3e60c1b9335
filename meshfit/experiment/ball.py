"""Spheres that verts are put on."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from meshfit.mesh.mesh import Verts


@dataclass(frozen=True)
class Ball:
    """A sphere by its centre and its radius."""

    centre: tuple[float, float, float]
    radius: float

    @classmethod
    def about(cls, verts: Verts) -> "Ball":
        """The one about the mean of some verts that goes through the farthest of them."""
        centre = verts.mean(axis=0)
        radius = float(np.linalg.norm(verts - centre, axis=1).max())
        return cls((float(centre[0]), float(centre[1]), float(centre[2])), radius)

    def put(self, verts: Verts) -> Verts:
        """The verts, each moved along its ray from the centre."""
        offset = verts - np.asarray(self.centre)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        return np.asarray(self.centre + offset * (self.radius / length))


def refined_on_ball(verts: Verts, operators: Iterable[csr_array]) -> Verts:
    """Verts refined level by level, put on their ball before the first and after each."""
    ball = Ball.about(verts)
    verts = ball.put(verts)
    for operator in operators:
        verts = ball.put(operator @ verts)
    return verts
