"""Relief from depth: pixels that lie deeper than what surrounds them get darker, as creases do under an overcast sky.

Opposite neighbours are taken in pairs, as in Loos and Sloan's volumetric obscurance (2010), so that a slope is not
taken for a hollow. It needs nothing but a depth buffer, so it looks the same whatever draws it.
"""

import numpy as np
from jaxtyping import Float32

Depth = Float32[np.ndarray, "H W"]

_DIRECTIONS = 6
# Radii as shares of the picture's shorter side, and how much each of them darkens at most.
_RADII = ((0.01, 0.45), (0.025, 0.45), (0.06, 0.45))
# What a ball may be filled beyond the half before it counts: the edges between faces of a coarse mesh are no creases.
_SPARED = 0.06


def occlusion_shade(depth: Depth) -> Depth:
    """(H, W) what to multiply each pixel's colour with, from 0 to 1.

    Args:
        depth: distance from the eye in units of a pixel's width, in parallel projection; infinite where nothing is.
    """
    result = np.ones_like(depth)
    for share, strength in _RADII:
        radius = max(1.0, share * min(depth.shape))
        result *= 1.0 - strength * _hidden(depth, radius)
    return np.where(np.isfinite(depth), result, np.float32(1.0))


def _hidden(depth: Depth, radius: float) -> Depth:
    """How much of a ball around each pixel's point is filled beyond the half that a plane fills, from 0 to 1."""
    reach = int(np.ceil(radius))
    own = np.where(np.isfinite(depth), depth, np.float32(0.0))
    around = np.pad(depth, reach, constant_values=np.inf)
    total = np.zeros_like(depth)
    height, width = depth.shape
    for angle in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS + 0.2:
        down, right = round(radius * np.sin(angle)), round(radius * np.cos(angle))
        pair = np.zeros_like(depth)
        for sign in (1, -1):
            top, left = reach + sign * down, reach + sign * right
            nearer = own - around[top : top + height, left : left + width]
            # What is far in front of the ball hides no light that comes from beside it.
            faded = np.where(nearer > 3 * radius, 3 * radius - (nearer - 3 * radius), nearer)
            pair += np.clip(faded, -2 * radius, 2 * radius)
        total += np.clip(pair / (2 * radius) - _SPARED, 0.0, 1.0)
    return np.asarray(total / _DIRECTIONS, dtype=np.float32)
