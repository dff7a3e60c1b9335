"""The colours of pictures: of surfaces, and of distances. Named once, for pyvista, matplotlib and plotly alike."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8

SURFACE = "#cdd6de"
"""A mesh without values."""
MISSING = "#8c8c8c"
"""Where there is no value."""
INK = "#22303c"
"""Text, lines and marks."""

# From matplotlib's magma, backwards and without its black end: even steps are seen as even ones, also by the
# colour-blind, and light and shade stay visible on all of it.
DISTANCES = (
    "#fcf4b6", "#fed194", "#feac76", "#fb8761", "#f2625d", "#db476a", "#bd3977", "#9c2e7f", "#7c2382", "#5d177f",
)  # fmt: skip
"""Colours of distances, from 0 to the largest, in even steps; in between they are mixed.

`LinearSegmentedColormap.from_list("distances", DISTANCES)` makes a colour map of them for matplotlib, and plotly takes
`list(DISTANCES)` for a colour scale.
"""


def ramp(count: int = 256, colours: Sequence[str] = DISTANCES) -> list[str]:
    """So many colours in even steps along others, as `#rrggbb`."""
    known = np.array([rgb(colour) for colour in colours], dtype=np.float64)
    places = np.linspace(0, len(colours) - 1, count)
    mixed = np.stack([np.interp(places, np.arange(len(colours)), channel) for channel in known.T], axis=1)
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in np.rint(mixed).astype(int).tolist()]


def rgb(colour: str) -> UInt8[np.ndarray, "3"]:
    """Red, green and blue of `#rrggbb`."""
    return np.frombuffer(bytes.fromhex(colour.removeprefix("#")), dtype=np.uint8)
