"""The picture of docs/guide/landmarks.md: a striped bar whose target is twisted, registered without and with landmarks.

python -m tests.benchmarks.landmark_picture data/pictures/landmarks.png
"""

import sys

import numpy as np
import pyvista

import meshfit
from meshfit.mesh.mesh import Mesh, Verts

_TWIST, _STRIPES, _EVERY, _SPACE = 0.6, 5, 24, 1.5


def _twisted(verts: Verts) -> Verts:
    c, s = np.cos(_TWIST * verts[:, 0]), np.sin(_TWIST * verts[:, 0])
    rows = (verts[:, 0], c * verts[:, 1] - s * verts[:, 2], s * verts[:, 1] + c * verts[:, 2])
    return np.stack(rows, axis=1)


def _draw(path: str) -> None:
    ball = meshfit.icosphere(4)
    bar = ball.with_verts(ball.verts * np.array([2.0, 0.55, 0.55]))
    target = bar.with_verts(_twisted(bar.verts))
    settings = meshfit.GaussNewtonSettings(connectivity="fixed", levels=0, register="near-rigid")
    some = np.arange(0, bar.num_verts, _EVERY)
    known = meshfit.Landmarks.of(some, target.verts[some])
    results: list[Mesh] = [
        meshfit.fit(bar, target, settings, landmarks=marks, device="cpu").mesh for marks in (None, known)
    ]
    stripes = np.cos(_STRIPES * np.arctan2(bar.verts[:, 2], bar.verts[:, 1])) > 0
    plotter = pyvista.Plotter(off_screen=True, window_size=[1000, 900])
    plotter.set_background("white")
    for row, (mesh, words) in enumerate(
        zip((bar, target, *results), ("source", "target", "without landmarks", "with landmarks"), strict=True)
    ):
        place = np.array([0, -_SPACE * row, 0])
        surface = pyvista.PolyData.from_regular_faces(mesh.verts + place, mesh.faces)
        colours = {"cmap": ["#d8d8d8", "#20798b"], "show_scalar_bar": False, "smooth_shading": True}
        plotter.add_mesh(surface, scalars=stripes.astype(float), **colours)
        plotter.add_point_labels(
            [place - np.array([2.3, 0, 0])], [words], shape=None, text_color="black", font_size=24, show_points=False,
            justification_horizontal="right", always_visible=True,
        )  # fmt: skip
        if row in (1, 3):
            points = (target.verts if row == 1 else mesh.verts)[some] * 1.01 + place
            plotter.add_points(points, color="#d9480f", point_size=9, render_points_as_spheres=True)
    plotter.camera_position = [(-1.1, -1.5 * _SPACE, 20), (-1.1, -1.5 * _SPACE, 0), (0, 1, 0)]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = 3.1
    plotter.screenshot(path)


if __name__ == "__main__":
    _draw(sys.argv[1])
