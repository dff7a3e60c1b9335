"""Pictures of meshes, drawn by pyvista with soft shading and ambient occlusion."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt8
from scipy.ndimage import uniform_filter

from meshfit.mesh.mesh import Mesh
from meshfit.optional import import_optional
from meshfit.report.figures.camera import Camera
from meshfit.report.figures.colours import MISSING, SURFACE, ramp, rgb

Image = UInt8[np.ndarray, "H W 4"]
Depth = Float32[np.ndarray, "H W"]

_EDGES = "#46535f"
_FEATURE_ANGLE = 60.0
# Each pixel is the mean of a block of fine pixels, so that edges are smooth whatever the OpenGL driver supports.
_FINE = 3
# Position (right, up, towards the eye) and brightness: a key light from the upper left, a fill light from the right,
# and a light next to the eye, so that nothing visible is black.
_LIGHTS = (((-0.9, 1.1, 1.0), 0.5), ((1.0, 0.1, 0.6), 0.14), ((0.0, 0.2, 1.0), 0.42))
_AMBIENT = 0.24

# Ambient occlusion: radii as shares of the picture's shorter side, each with its strongest darkening.
_RADII = ((0.012, 0.65), (0.03, 0.6), (0.07, 0.55))
# Directions at varying distances, as shares of the radius: equal distances would print copies of an outline.
_DIRECTIONS = 12
_DISTANCES = (1.0, 0.55, 0.8, 0.35, 0.9)
# Fill of the ball beyond one half that does not count yet: the edges of a coarse mesh are not creases.
_TOLERATED = 0.09


def draw(  # noqa: PLR0913  all but two have a default, and each can be set without the others
    mesh: Mesh,
    camera: Camera,
    *,
    size: tuple[int, int] = (500, 500),
    values: Float[np.ndarray, " V"] | None = None,
    limits: tuple[float, float] | None = None,
    edges: bool = False,
    colour: str = SURFACE,
    background: str | None = "#ffffff",
) -> Image:
    """Draw a mesh; the same arguments give the same picture.

    Args:
        mesh: the mesh; both sides of its faces are lit.
        camera: the view, usually `camera_of` the target for every mesh that belongs to it.
        size: width and height in pixels.
        values: (V,) one value per vertex, shown in the colours `DISTANCES`; non-finite values are grey.
        limits: the values of the first and last colour; by default 0 and the largest value.
        edges: draw the edges of faces too.
        colour: colour of a mesh without values, as `#rrggbb`.
        background: background colour, as `#rrggbb`; None for a transparent one.

    Returns:
        (height, width, 4) uint8: red, green, blue and opacity.

    Raises:
        ConfigError: pyvista is not installed.
    """
    plotter = _plotter((size[0] * _FINE, size[1] * _FINE))
    try:
        if mesh.num_faces:
            style = {"color": colour} if values is None else _value_style(values, limits)
            _add(plotter, mesh, style, edges=edges)
        depths = _set_camera(plotter, camera, mesh)
        pixels, depth = _read_buffers(plotter)
    finally:
        plotter.close()
    seen = depth < 1.0
    pixel = 2 * camera.scale / min(size)
    away = np.where(seen, depth * np.float32((depths[1] - depths[0]) / pixel), np.float32(np.inf))
    return _downsample(pixels, seen.astype(np.float32), occlusion_shade(_over_blocks(np.minimum, away)), background)


def _plotter(size: tuple[int, int]) -> Any:  # noqa: ANN401  pyvista is optional
    pyvista = import_optional("pyvista")
    logger = import_optional("vtkmodules.vtkCommonCore").vtkLogger
    # Without a display VTK draws in memory; its warning about that is of no use.
    logger.SetStderrVerbosity(logger.VERBOSITY_OFF)
    plotter = pyvista.Plotter(off_screen=True, window_size=list(size), border=False, lighting="none")
    plotter.disable_anti_aliasing()
    for position, intensity in _LIGHTS:
        plotter.add_light(pyvista.Light(position=position, light_type="camera light", intensity=intensity))
    return plotter


def _value_style(values: Float[np.ndarray, " V"], limits: tuple[float, float] | None) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    low, high = limits or (0.0, float(finite.max(initial=0.0)))
    return {
        "scalars": np.asarray(values, dtype=np.float64),
        "clim": (low, high if high > low else low + 1.0),
        "cmap": ramp(),
        "nan_color": MISSING,
        "show_scalar_bar": False,
    }


def _add(plotter: Any, mesh: Mesh, style: dict[str, Any], *, edges: bool) -> None:  # noqa: ANN401  pyvista is optional
    surface = import_optional("pyvista").PolyData.from_regular_faces(mesh.verts, mesh.faces)
    if "scalars" in style:
        surface.point_data["values"] = style["scalars"]
        style = style | {"scalars": "values"}
    surface = surface.compute_normals(
        cell_normals=False,
        split_vertices=True,
        feature_angle=_FEATURE_ANGLE,
        consistent_normals=False,
        auto_orient_normals=False,
    )
    if edges:
        style = style | {"show_edges": True, "edge_color": _EDGES, "line_width": 0.55 * _FINE}
    plotter.add_mesh(surface, smooth_shading=True, ambient=_AMBIENT, specular=0.0, **style)


def _set_camera(plotter: Any, camera: Camera, mesh: Mesh) -> tuple[float, float]:  # noqa: ANN401  pyvista is optional
    """Set the camera, and return the distances from the eye at which the depth buffer begins and ends."""
    towards = camera.project(mesh.verts)[:, 2] * camera.scale
    pad = 0.01 * camera.scale
    low, high = float(towards.min(initial=0.0)) - pad, float(towards.max(initial=0.0)) + pad
    away = high + camera.scale
    depths = (away - high, away - low)
    plotter.camera.focal_point = camera.focal
    plotter.camera.position = np.asarray(camera.focal) + away * np.asarray(camera.direction)
    plotter.camera.up = camera.up
    plotter.camera.parallel_projection = True
    width, height = plotter.window_size
    plotter.camera.parallel_scale = camera.scale * max(1.0, height / width)
    plotter.camera.clipping_range = depths
    return depths


def _read_buffers(plotter: Any) -> tuple[UInt8[np.ndarray, "H W 3"], Float32[np.ndarray, "H W"]]:  # noqa: ANN401
    """Return the colours and depths (0 to 1) of the drawn picture, top row first."""
    core, support = import_optional("vtkmodules.vtkCommonCore"), import_optional("vtkmodules.util.numpy_support")
    width, height = plotter.window_size
    window, corners = plotter.render_window, (0, 0, width - 1, height - 1)
    window.Render()
    pixels, depth = core.vtkUnsignedCharArray(), core.vtkFloatArray()
    window.GetPixelData(*corners, 0, pixels, 0)
    window.GetZbufferData(*corners, depth)
    rows = support.vtk_to_numpy(pixels).reshape(height, width, 3)
    return rows[::-1].copy(), support.vtk_to_numpy(depth).reshape(height, width)[::-1].copy()


def _over_blocks(operation: Callable[[Any, Any], Any], fine: Float32[np.ndarray, "H W *rest"]) -> Any:  # noqa: ANN401
    """Combine the fine pixels of each block. NumPy takes many times as long to reduce over such short axes."""
    rows = functools.reduce(operation, [fine[first::_FINE] for first in range(_FINE)])
    return functools.reduce(operation, [rows[:, first::_FINE] for first in range(_FINE)])


def _downsample(
    pixels: UInt8[np.ndarray, "H W 3"],
    seen: Float32[np.ndarray, "H W"],
    shade: Float32[np.ndarray, "h w"],
    background: str | None,
) -> Image:
    """Average blocks of fine pixels and shade them, over the background or, without one, over the mesh alone."""
    cover = _over_blocks(np.add, seen)[:, :, None] / _FINE**2
    colour = _over_blocks(np.add, pixels * seen[:, :, None]) * (shade[:, :, None] / _FINE**2)
    if background is None:
        colour, opacity = np.divide(colour, cover, out=np.zeros_like(colour), where=cover > 0), cover * 255
    else:
        colour, opacity = colour + (1 - cover) * rgb(background), np.full_like(cover, 255)
    return np.asarray(np.rint(np.concatenate([colour, opacity], axis=2)), dtype=np.uint8)


def occlusion_shade(depth: Depth) -> Depth:
    """(H, W) ambient occlusion of a depth buffer: the factor, from 0 to 1, of each pixel's colour.

    Pixels that lie deeper than their surroundings become darker, as creases do under an overcast sky. Opposite
    neighbours are taken in pairs, as in the volumetric obscurance of Loos and Sloan (2010), so that a slope does not
    count as a hollow. Only the depth buffer enters, so the result does not depend on the OpenGL driver.

    Args:
        depth: (H, W) distance from the eye in pixel widths, in parallel projection; infinite for the background.
    """
    result = np.ones_like(depth)
    for share, strength in _RADII:
        radius = max(1.5, share * min(depth.shape))
        result *= 1.0 - strength * _smooth(_occlusion(depth, radius), depth, radius)
    return np.where(np.isfinite(depth), result, np.float32(1.0))


def _occlusion(depth: Depth, radius: float) -> Depth:
    """The share, 0 to 1, of a ball around each pixel's point that is filled beyond the half that a plane fills."""
    reach = int(np.ceil(radius))
    own = np.where(np.isfinite(depth), depth, np.float32(0.0))
    around = np.pad(depth, reach, constant_values=np.inf)
    total = np.zeros_like(depth)
    height, width = depth.shape
    for number in range(_DIRECTIONS):
        angle, away = number * np.pi / _DIRECTIONS, radius * _DISTANCES[number % len(_DISTANCES)]
        down, right = round(away * np.sin(angle)), round(away * np.cos(angle))
        pair = np.zeros_like(depth)
        for sign in (1, -1):
            top, left = reach + sign * down, reach + sign * right
            nearer = own - around[top : top + height, left : left + width]
            # A surface far in front of the ball does not block light from the sides.
            pair += np.clip(np.where(nearer > 3 * away, 6 * away - nearer, nearer), -2 * away, 2 * away)
        total += np.clip(pair / max(2 * away, 1.0) - _TOLERATED, 0.0, 1.0)
    return np.asarray(total / _DIRECTIONS, dtype=np.float32)


def _smooth(occlusion: Depth, depth: Depth, radius: float) -> Depth:
    """The mean over the neighbouring pixels that belong to the mesh."""
    size = max(1, round(radius / 2))
    seen = np.isfinite(depth).astype(np.float32)
    total, count = uniform_filter(occlusion * seen, size, mode="constant"), uniform_filter(seen, size, mode="constant")
    return np.asarray(np.divide(total, count, out=np.zeros_like(total), where=count > 1e-6))
