"""Polygons with holes as polygons without: each hole is joined to the outline by two edges at the same place."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError

_MOST_CORNERS_TIMES_HOLES = 20_000
_TRIES = 30


@np.errstate(all="ignore")
def with_holes(verts: Float64[np.ndarray, "V 3"], loops: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return one loop around an outline and its holes.

    Args:
        verts: that the loops index.
        loops: the outline, then its holes, in either direction.

    Raises:
        MeshError: so many holes and corners that joining them takes long.
    """
    outline, holes = (
        (loops[0], [loop for loop in loops[1:] if len(loop) >= 3]) if loops else (np.empty(0, np.int64), [])
    )
    if not holes or len(outline) < 3:
        return outline
    if sum(map(len, loops)) * len(holes) > _MOST_CORNERS_TIMES_HOLES:
        raise MeshError(f"a polygon with {len(holes)} holes, which are too many; triangulate it, and export again")
    flat = _flattened(verts, outline)
    holes = [hole[::-1] if _signed_area(flat[hole]) > 0 else hole for hole in holes]
    while holes:
        walls = [outline, *holes]
        at, number, corner = _bridge(flat, outline, holes, walls)
        hole = holes.pop(number)
        around = np.concatenate([hole[corner:], hole[: corner + 1]])
        outline = np.concatenate([outline[: at + 1], around, outline[at:]])
    return outline


def _flattened(verts: NDArray[np.float64], outline: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (V, 2) the vertices along the two axes in which the outline is largest; it goes round to the left."""
    points = verts[outline] - verts[outline[0]]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    kept = [axis for axis in range(3) if axis != int(np.abs(normal).argmax())]
    flat = verts[:, kept]
    return np.asarray(flat if _signed_area(flat[outline]) > 0 else flat[:, ::-1])


def _signed_area(points: NDArray[np.float64]) -> float:
    ahead = np.roll(points, -1, axis=0)
    return float((points[:, 0] * ahead[:, 1] - points[:, 1] * ahead[:, 0]).sum())


def _bridge(
    flat: NDArray[np.float64],
    outline: NDArray[np.int64],
    holes: list[NDArray[np.int64]],
    walls: list[NDArray[np.int64]],
) -> tuple[int, int, int]:
    """Return a corner of the outline, a hole and a corner of it, as near as possible, that see each other."""
    starts = np.concatenate(walls)
    ends = np.concatenate([np.roll(wall, -1) for wall in walls])
    owner = np.repeat(np.arange(len(holes)), [len(hole) for hole in holes])
    corner = np.concatenate([np.arange(len(hole)) for hole in holes])
    candidates = np.concatenate(holes)
    distance = np.linalg.norm(flat[outline][:, None] - flat[candidates][None], axis=2)
    nearest = np.argpartition(distance, min(_TRIES, distance.size) - 1, axis=None)[:_TRIES]
    order = nearest[np.lexsort((nearest, distance.reshape(-1)[nearest]))]
    for place in order.tolist():
        at, other = divmod(place, len(candidates))
        number, turn = int(owner[other]), int(corner[other])
        first, second = flat[outline[at]], flat[candidates[other]]
        if (
            _enters(flat[outline], at, second)
            and _enters(flat[holes[number]], turn, first)
            and not _crosses(first, second, flat[starts], flat[ends])
        ):
            return at, number, turn
    at, other = divmod(int(order[0]), len(candidates))
    return at, int(owner[other]), int(corner[other])


def _enters(loop: NDArray[np.float64], corner: int, target: NDArray[np.float64]) -> bool:
    """Return whether the way from a corner of a loop to a target begins on the left of the loop."""
    place = loop[corner]
    before, after, ahead = loop[corner - 1] - place, loop[(corner + 1) % len(loop)] - place, target - place
    if _cross(after, before) >= 0:
        return bool(_cross(ahead, before) > 0 and _cross(after, ahead) > 0)
    return not bool(_cross(ahead, after) >= 0 and _cross(before, ahead) >= 0)


def _crosses(
    first: NDArray[np.float64], second: NDArray[np.float64], starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> bool:
    """Return whether a segment properly crosses one of the edges."""
    apart = _cross(second - first, starts - first) * _cross(second - first, ends - first) < 0
    cut = _cross(ends - starts, first - starts) * _cross(ends - starts, second - starts) < 0
    return bool((apart & cut).any())


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
