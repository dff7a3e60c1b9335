"""Views: a camera and a size, from which meshes become panels, plain or in the colours of their distances."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from meshfit.mesh.mesh import Mesh
from meshfit.report.figures.camera import Camera
from meshfit.report.figures.drawing import draw
from meshfit.report.figures.layout import Panel, Ring
from meshfit.report.figures.surface_errors import worst_vert
from meshfit.report.figures.visibility import in_sight


@dataclass(frozen=True)
class View:
    """Where meshes are seen from, and how.

    Attributes:
        camera: the camera.
        size: width and height in pixels.
        edges: whether the edges of faces are drawn.
    """

    camera: Camera
    size: tuple[int, int]
    edges: bool = False

    def plain(self, mesh: Mesh, *lines: str) -> Panel:
        """A mesh, with lines of text below it."""
        return Panel(draw(mesh, self.camera, size=self.size, edges=self.edges), lines)

    def coloured(self, mesh: Mesh, distances: Float64[np.ndarray, " V"], limit: float, *lines: str) -> Panel:
        """A mesh in the colours of its distances, with a ring around the vert that is farthest off."""
        limits = (0.0, limit)
        image = draw(mesh, self.camera, size=self.size, values=distances, limits=limits, edges=self.edges)
        worst = worst_vert(distances)
        right, up, _ = self.camera.project(mesh.verts[[worst]])[0] * min(self.size) / 2
        dashed = not in_sight(mesh, worst, self.camera)
        return Panel(image, lines, Ring(self.size[0] / 2 + right, self.size[1] / 2 - up, dashed))

    def fitting(self, mesh: Mesh) -> "View":
        """The same view with a mesh in the middle, drawn back where it would not fit."""
        camera, _ = self.camera.framing(mesh, aspect=self.size[0] / self.size[1])
        return replace(self, camera=replace(camera, scale=max(camera.scale, self.camera.scale)))
