"""Pictures of meshes, drawn off-screen with pyvista (the extra `report`)."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from meshfit.errors import ConfigError
from meshfit.mesh.geometry import bounding_box
from meshfit.mesh.mesh import Mesh

_COLOUR = "#c9d3dc"
_EDGES = "#3b4a57"
_TEXT = "#22303c"
_PANEL = 520
_VIEW = (0.55, 0.35, 1.0)
_ZOOM = 1.35


def draw_row(meshes: Mapping[str, Mesh], path: Path, *, edges: bool = False) -> None:
    """Draw meshes side by side from one three-quarter view, y up, at one scale, each with its title below.

    Args:
        meshes: by title; they should be in one frame.
        path: the PNG to write.
        edges: draw the edges of faces too.

    Raises:
        ConfigError: pyvista is not installed, or the picture cannot be written.
    """
    plotter = _plotter(len(meshes))
    low, high = bounding_box(np.concatenate([mesh.verts for mesh in meshes.values()]))
    for column, (title, mesh) in enumerate(meshes.items()):
        plotter.subplot(0, column)
        style = {"show_edges": True, "edge_color": _EDGES, "line_width": 0.6} if edges else {"smooth_shading": True}
        plotter.add_mesh(_surface(mesh), color=_COLOUR, split_sharp_edges=not edges, feature_angle=60, **style)
        plotter.add_text(title, position=(0.03, 0.03), viewport=True, font_size=11, color=_TEXT)
        _look(plotter, low, high)
    plotter.link_views()
    try:
        plotter.screenshot(str(path), return_img=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be written: {error}") from error
    finally:
        plotter.close()


def _plotter(columns: int) -> Any:  # noqa: ANN401  pyvista is optional
    try:
        pyvista = importlib.import_module("pyvista")
        logger = importlib.import_module("vtkmodules.vtkCommonCore").vtkLogger
    except ImportError:
        raise ConfigError("pictures need pyvista, which is not installed: pip install 'meshfit[report]'") from None
    # Without a display VTK draws in memory, and needs not say so.
    logger.SetStderrVerbosity(logger.VERBOSITY_OFF)
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(1, columns),
        window_size=(columns * _PANEL, _PANEL),
        border=False,
        lighting="three lights",
    )
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    return plotter


def _surface(mesh: Mesh) -> Any:  # noqa: ANN401  pyvista is optional
    return importlib.import_module("pyvista").PolyData.from_regular_faces(mesh.verts, mesh.faces)


def _look(plotter: Any, low: np.ndarray, high: np.ndarray) -> None:  # noqa: ANN401  likewise
    middle, extent = (low + high) / 2, float(np.linalg.norm(high - low))
    away = np.asarray(_VIEW) / np.linalg.norm(_VIEW)
    plotter.camera.focal_point = middle
    plotter.camera.position = middle + 3 * extent * away
    plotter.camera.up = (0.0, 1.0, 0.0)
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = extent / 2 / _ZOOM * 1.15
    plotter.camera.clipping_range = (0.1 * extent, 10 * extent)
