"""Views of meshes: a window, an interactive view in a notebook, or an image where there is no display."""

import os
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshfit.errors import ConfigError, MeshError
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.optional import import_optional
from meshfit.specs import suggest

_COLOUR, _EDGES, _BACKGROUND = "#c9d3e0", "#3a4656", "white"
_UPS = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_DIRECTIONS = {"y": (0.55, 0.35, 1.0), "z": (0.55, -1.0, 0.35)}
_LARGEST_SMOOTHED_ANGLE = 35.0
_AMBIENT, _ZOOM = 0.25, 1.25


def show_meshes(
    meshes: Mapping[str, MeshLike],
    *,
    values: ArrayLike | None = None,
    label: str = "",
    edges: bool = False,
    up: str = "y",
    size: tuple[int, int] = (900, 600),
    image: bool | None = None,
) -> Any:  # noqa: ANN401  pyvista is optional
    """Show meshes side by side, all from one camera.

    Args:
        meshes: by their titles, in any form that `as_mesh` takes.
        values: a number for each vertex, or for each face, of the first mesh: it is coloured by them.
        label: of the colour bar.
        edges: draw the edges of faces.
        up: the axis that points up: `y` or `z`.
        size: width and height in pixels.
        image: return an image even where there is a display; None does where there is none.

    Returns:
        A PIL image where there is no display, and in a notebook without trame; the view of a notebook; otherwise the
        plotter, after its window has been closed.

    Raises:
        ConfigError: pyvista or pillow is not installed, or another axis.
        MeshError: not a mesh, or a wrong number of values.
    """
    if up not in _UPS:
        raise ConfigError(f'up: got "{up}"; {suggest(str(up), _UPS)}')
    shown = {title: as_mesh(mesh, title) for title, mesh in meshes.items()}
    styles = [{} if values is None else _style(next(iter(shown.values())), values, label)]
    backend = "image" if image else _backend(image)
    plotter = _plotter(len(shown), size, off_screen=backend == "image")
    for number, (title, mesh) in enumerate(shown.items()):
        plotter.subplot(0, number)
        style = styles[number] if number < len(styles) else {}
        _add(plotter, mesh, style, edges=edges)
        if len(shown) > 1:
            plotter.add_text(title, font_size=11, color="black")
    plotter.link_views()
    plotter.view_vector(_DIRECTIONS[up], viewup=_UPS[up])
    plotter.camera.zoom(_ZOOM)
    if backend == "image":
        pixels = plotter.screenshot(return_img=True)
        plotter.close()
        return import_optional("PIL.Image").fromarray(pixels)
    if backend == "notebook":
        return plotter.show(jupyter_backend="trame", return_viewer=True)
    plotter.show()
    return plotter


def _backend(image: bool | None) -> str:  # noqa: FBT001  None where nothing is asked for
    ipython: Any = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None and hasattr(shell, "kernel"):
        has_trame = all(_installed(name) for name in ("trame", "trame_vtk", "trame_vuetify"))
        return "notebook" if has_trame and image is None else "image"
    windows = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return "window" if windows and not import_optional("pyvista").OFF_SCREEN else "image"


def _installed(module: str) -> bool:
    from importlib.util import find_spec

    return find_spec(module) is not None


def _plotter(count: int, size: tuple[int, int], *, off_screen: bool) -> Any:  # noqa: ANN401  pyvista is optional
    pyvista = import_optional("pyvista")
    if off_screen:
        import_optional("PIL.Image")
        logger = import_optional("vtkmodules.vtkCommonCore").vtkLogger
        logger.SetStderrVerbosity(logger.VERBOSITY_OFF)  # without a display VTK draws in memory, and warns of that
    plotter = pyvista.Plotter(shape=(1, count), window_size=list(size), off_screen=off_screen, border=False)
    plotter.set_background(_BACKGROUND)
    plotter.enable_anti_aliasing("ssaa") if off_screen else None
    return plotter


def _add(plotter: Any, mesh: Mesh | PolygonMesh, style: dict[str, Any], *, edges: bool) -> None:  # noqa: ANN401
    surface = as_pyvista(mesh)
    values = style.pop("values", None)
    if values is not None:
        data = surface.point_data if len(values) == mesh.num_verts else surface.cell_data
        data["values"] = values
        style |= {"scalars": "values"}
    plotter.add_mesh(
        surface,
        smooth_shading=True,
        split_sharp_edges=True,
        feature_angle=_LARGEST_SMOOTHED_ANGLE,
        show_edges=edges,
        edge_color=_EDGES,
        ambient=_AMBIENT,
        **({"color": _COLOUR} | style),
    )


def as_pyvista(mesh: Mesh | PolygonMesh) -> Any:  # noqa: ANN401  pyvista is optional
    """Return a mesh as pyvista's PolyData."""
    pyvista = import_optional("pyvista")
    if isinstance(mesh, Mesh):
        return pyvista.PolyData.from_regular_faces(mesh.verts, mesh.faces)
    padded = np.insert(mesh.corners, mesh.starts, mesh.sizes)
    return pyvista.PolyData(mesh.verts, faces=padded)


def _style(mesh: Mesh | PolygonMesh, values: ArrayLike, label: str) -> dict[str, Any]:
    numbers: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
    if numbers.shape not in ((mesh.num_verts,), (mesh.num_faces,)):
        expected = f"one for each of {mesh.num_verts} vertices or {mesh.num_faces} faces"
        raise MeshError(f"values: expected {expected}, got an array of shape {numbers.shape}")
    signed = bool((numbers < 0).any())
    limit = float(np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0)) or 1.0
    return {
        "values": numbers,
        "cmap": "coolwarm" if signed else "viridis",
        "clim": (-limit if signed else 0.0, limit),
        "scalar_bar_args": {
            "title": f"{label}\n",
            "color": "black",
            "n_labels": 3,
            "fmt": "%.3g",
            "vertical": True,
            "position_x": 0.84,
        },
        "color": None,
    }
