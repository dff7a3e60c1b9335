"""Relief from depth: pixels that lie deeper than what surrounds them get darker, as creases do under an overcast sky.

Opposite neighbours are taken in pairs, as in Loos and Sloan's volumetric obscurance (2010), so that a slope is not
taken for a hollow. It needs nothing but a depth buffer, so it looks the same whatever draws it.
"""

import numpy as np
from jaxtyping import Float32
from scipy.ndimage import uniform_filter

Depth = Float32[np.ndarray, "H W"]

# Radii as shares of the picture's shorter side, and how much each of them darkens at most.
_RADII = ((0.012, 0.65), (0.03, 0.6), (0.07, 0.55))
# Directions at unlike distances, as shares of the radius: at like ones they would make copies of an outline.
_DIRECTIONS = 12
_DISTANCES = (1.0, 0.55, 0.8, 0.35, 0.9)
# What a ball may be filled beyond the half before it counts: the edges between faces of a coarse mesh are no creases.
_SPARED = 0.09


def occlusion_shade(depth: Depth) -> Depth:
    """(H, W) what to multiply each pixel's colour with, from 0 to 1.

    Args:
        depth: distance from the eye in units of a pixel's width, in parallel projection; infinite where nothing is.
    """
    result = np.ones_like(depth)
    for share, strength in _RADII:
        radius = max(1.5, share * min(depth.shape))
        result *= 1.0 - strength * _softened(_hidden(depth, radius), depth, radius)
    return np.where(np.isfinite(depth), result, np.float32(1.0))


def _hidden(depth: Depth, radius: float) -> Depth:
    """How much of a ball around each pixel's point is filled beyond the half that a plane fills, from 0 to 1."""
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
            # What is far in front of the ball hides no light that comes from beside it.
            pair += np.clip(np.where(nearer > 3 * away, 6 * away - nearer, nearer), -2 * away, 2 * away)
        total += np.clip(pair / max(2 * away, 1.0) - _SPARED, 0.0, 1.0)
    return np.asarray(total / _DIRECTIONS, dtype=np.float32)


def _softened(hidden: Depth, depth: Depth, radius: float) -> Depth:
    """The mean over what is near each pixel, and belongs to the mesh."""
    size = max(1, round(radius / 2))
    seen = np.isfinite(depth).astype(np.float32)
    total, count = uniform_filter(hidden * seen, size, mode="constant"), uniform_filter(seen, size, mode="constant")
    return np.asarray(np.divide(total, count, out=np.zeros_like(total), where=count > 1e-6))
