"""Pictures of docs/guide/targets.md: a target of each kind, the source that `meshfit fit` makes of it, and the result.

python -m tests.benchmarks.target_pictures targets                     # the target files alone
python -m tests.benchmarks.target_pictures targets data/pictures/kinds # and the pictures, from fits of them
"""

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

import meshfit
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.targets import load_target
from meshfit.report.figures.camera import Camera
from meshfit.report.figures.layout import PanelRow, mesh_panel, write_rows
from meshfit.report.figures.render import cameras_of, collect_meshes
from tests.benchmarks.targets import CASES

_SHOWN = ("animal", "handles", "pieces", "shells", "crossing", "noisy", "holes", "half", "cloud")
_HOLLOW = ("shells", "crossing")  # drawn cut open
_SIZE, _DPI, _FONT, _COLOURS = 300, 150, 9.0, 48


class _Kind(NamedTuple):
    """A target, the options of its fit, whether its picture shows it cut open, and its file if that is another's."""

    make: Callable[[], Mesh | PointCloud]
    options: tuple[str, ...] = ()
    cut: bool = False
    file: str = ""


def _sheet() -> Mesh:
    """Return a wavy sheet with an opening in it."""
    side = 80
    x, y = np.meshgrid(*[np.linspace(-1, 1, side)] * 2, indexing="ij")
    verts = np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(2 * y)], axis=2).reshape(-1, 3)
    corner = np.arange(side * (side - 1)).reshape(side - 1, side)[:, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + side, corner + side + 1], axis=1),
            np.stack([corner, corner + side + 1, corner + 1], axis=1),
        ]
    )
    middle = verts[faces].mean(axis=1)
    kept = faces[np.hypot(middle[:, 0] - 0.3, middle[:, 1]) > 0.3]
    used, corners = np.unique(kept, return_inverse=True)
    return Mesh(verts[used], corners.reshape(-1, 3))


def _soup() -> Mesh:
    """Return the bunny's triangles, each by itself and a little out of place."""
    bunny = load_target("bunny")
    corners = bunny.verts[bunny.faces]
    shift = np.random.default_rng(0).normal(0, 0.001 * bounding_box_diagonal(bunny.verts), (len(corners), 1, 3))
    return Mesh((corners + shift).reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


KINDS: Mapping[str, _Kind] = {
    **{name: _Kind(lambda make=CASES[name]: make().target, cut=name in _HOLLOW) for name in _SHOWN},
    "skin": _Kind(lambda: CASES["crossing"]().target, ("--surface", "outer"), cut=True, file="crossing"),
    "filled": _Kind(lambda: CASES["holes"]().target, ("--source", "closed"), file="holes"),
    "sheet": _Kind(_sheet),
    "soup": _Kind(_soup),
}
"""The kinds of targets, by the name of their file."""


def main(arguments: list[str]) -> int:
    targets, *pictures = map(Path, arguments)
    targets.mkdir(parents=True, exist_ok=True)
    for name, kind in KINDS.items():
        file = write_target(targets, name)
        for folder in pictures:
            _draw(file, kind, folder / f"{name}.png")
    return 0


def write_target(folder: Path, name: str) -> Path:
    """Write the target of a kind, and return its file."""
    target, name = KINDS[name].make(), KINDS[name].file or name
    if isinstance(target, PointCloud):
        file = folder / f"{name}.xyz"
        np.savetxt(file, target.verts, fmt="%.6f")
        return file
    file = folder / f"{name}.ply"
    meshfit.save_mesh(target, file)
    return file


def _draw(target: Path, kind: _Kind, picture: Path) -> None:
    """Fit a target as the page says, and draw it with source and result."""
    runs, result = target.parent / "runs" / picture.stem, target.parent / "fitted" / f"{picture.stem}.ply"
    result.parent.mkdir(parents=True, exist_ok=True)
    picture.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "meshfit", "fit", target, "-o", result, "--keep", runs, *kind.options]
    subprocess.run(list(map(str, command)), check=True)
    trial = max(runs.glob(f"*/{target.stem}/*/*"), key=lambda folder: folder.stat().st_mtime)
    source, fitted, given = collect_meshes([str(trial)])[0]
    shown = dict(zip(("target", "source", "result"), (given, source, fitted), strict=True))
    panels = []
    for (title, rendered), camera in zip(shown.items(), cameras_of(list(shown.values())), strict=True):
        mesh = _cut_open(rendered.mesh, camera) if kind.cut else rendered.mesh
        panels.append(mesh_panel(mesh, camera, (_SIZE, _SIZE), title, edges=title == "source"))
    write_rows([PanelRow(tuple(panels))], picture, width=len(panels) * _SIZE / _DPI, font=_FONT, dpi=_DPI)
    Image.open(picture).convert("RGB").quantize(_COLOURS).save(picture, optimize=True)


def _cut_open(mesh: Mesh, camera: Camera) -> Mesh:
    """Return a mesh without the quarter that faces the camera from the right."""
    right, _, near = camera.project(mesh.verts[mesh.faces].mean(axis=1)).T
    return Mesh(mesh.verts, mesh.faces[(right < 0) | (near < 0)])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
