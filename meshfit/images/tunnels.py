"""Narrow tunnels of a solid on a grid, such as those that rounding leaves where the edges of two masks touch."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_closing, find_objects, label

Values = Float64[np.ndarray, "X Y Z"]
Solid = Bool[np.ndarray, "X Y Z"]

# Radii of the balls, in voxels, that no tunnel to be filled lets through.
_RADII = (1, 2, 3)
# Value of a filled voxel, in voxels.
_FILLED = 0.1


def without_narrow_tunnels(values: Values, tolerance: float, cell: float) -> Values:
    """Return the values of a solid, positive inside, without the tunnels that it is only just excluded from.

    Closing by a small ball adds parts. Those with which the surface has fewer handles, so that its Euler number is
    larger, are kept; narrow grooves, and gaps between pieces, stay.

    Args:
        values: signed distances from the surface, in lengths of the world.
        tolerance: voxels with values above the negative of it may be filled.
        cell: side of a voxel.
    """
    from meshfit.mesh.proximity import zero_surface  # brings libigl

    def euler_number(part: Values) -> int:
        padded = np.pad(part, 1, constant_values=-cell)
        mesh = zero_surface(padded, [cell * np.arange(size) for size in padded.shape])
        return mesh.num_verts - mesh.num_faces // 2

    values = values.copy()
    for radius in _RADII:
        for box, added in _parts(_closed(values > 0, radius) & (values <= 0) & (values > -tolerance)):
            filled = np.where(added, _FILLED * cell, values[box])
            if euler_number(filled) > euler_number(values[box]):
                values[box] = filled
    return values


def _closed(solid: Solid, radius: int) -> Solid:
    """Return what a ball of this radius outside of the solid does not reach."""
    steps = np.mgrid[(slice(-radius, radius + 1),) * 3]
    closed = binary_closing(np.pad(solid, radius), np.square(steps).sum(axis=0) <= radius**2)
    inner = slice(radius, -radius)
    return np.asarray(closed[inner, inner, inner])


def _parts(solid: Solid) -> Iterator[tuple[tuple[slice, ...], Solid]]:
    """Yield a box around each connected part, with two voxels on each side, and the part in it."""
    labels, _ = label(solid, np.ones((3, 3, 3)))
    for number, found in enumerate(find_objects(labels), 1):
        box = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in found)
        yield box, labels[box] == number
