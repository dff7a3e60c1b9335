"""The colours of figures, and the scale of colours that distances are shown on."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, UInt8

SURFACE = "#cdd6de"
"""A mesh without values."""
MISSING = "#8c8c8c"
"""A missing value."""
INK = "#22303c"
"""Text, lines and marks."""
MASK, RESULT = "#1f6fb4", "#d3611b"
"""Outlines of an image's mask, and of a result in that image."""

# matplotlib's magma, reversed and without its black end: perceptually even, safe for the colour-blind, and light enough
# all along for shading to stay visible.
DISTANCES = (
    "#fcf4b6", "#fed194", "#feac76", "#fb8761", "#f2625d", "#db476a", "#bd3977", "#9c2e7f", "#7c2382", "#5d177f",
)  # fmt: skip
"""Colours of distances, from 0 to the largest, in even steps, to be interpolated between."""

_QUANTILE = 0.99
_ROUND = (1.0, 1.2, 1.6, 2.0, 2.4, 3.0, 4.0, 5.0, 6.0, 8.0)


def shared_limit(distances: Sequence[Float64[np.ndarray, " V"]]) -> float:
    """Return the end of a colour scale that several meshes share: a round number above 99 % of the values of each.

    If the scale ended at the largest distance, a single outlier would make all other vertices look the same.
    """
    reached = max((float(np.quantile(values, _QUANTILE)) for values in distances if len(values)), default=0.0)
    if not reached > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(reached))
    return float(next((step * power for step in _ROUND if step * power >= reached), 10.0 * power))


def ramp(count: int = 256, colours: Sequence[str] = DISTANCES) -> list[str]:
    """Interpolate `count` colours, `#rrggbb`, in even steps along others."""
    known = np.array([rgb(colour) for colour in colours], dtype=np.float64)
    places = np.linspace(0, len(colours) - 1, count)
    mixed = np.stack([np.interp(places, np.arange(len(colours)), channel) for channel in known.T], axis=1)
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in np.rint(mixed).astype(int).tolist()]


def rgb(colour: str) -> UInt8[np.ndarray, "3"]:
    """(3,) red, green and blue of `#rrggbb`."""
    return np.frombuffer(bytes.fromhex(colour.removeprefix("#")), dtype=np.uint8)
