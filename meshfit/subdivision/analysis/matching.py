"""Which fine vertex is in the place of which coarse one: both connectivities are walked at once, from the centre on."""

import numpy as np
from jaxtyping import Complex128

from meshfit.mesh.halfedges import NONE, Indices, Mask
from meshfit.mesh.polygon_topology import PolygonTopology
from meshfit.subdivision.analysis.bench import Fan, Wheel

Places = Complex128[np.ndarray, " V"]


def match_wheel(wheel: Wheel, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """(V,) the fine vertex in the place of each coarse one of the first rings; `NONE` for the others.

    Args:
        wheel: the coarse connectivity.
        fine: the fine one.
        places: where the wheel locates the fine verts.
        rings: how many are matched.
    """
    mine = _about_centre(wheel.topology, wheel.places, hub=wheel.hub)
    theirs = _about_centre(fine, places, hub=wheel.hub)
    ahead = _middles(wheel.topology, wheel.places)[mine[0]]
    turned = np.abs(np.angle(_middles(fine, places)[theirs] / ahead))
    inside = np.zeros(len(wheel.places), dtype=bool)
    inside[wheel.within(rings)] = True
    return _walk(wheel.topology, fine, inside, (int(mine[0]), int(theirs[np.argmin(turned)])))


def match_fan(fan: Fan, fine: PolygonTopology, places: Places, rings: int) -> Indices:
    """The same around a vertex on the boundary, from the half-edge out of it that lies there."""
    starts = []
    for topology, hub in ((fan.topology, 0), (fine, int(np.argmin(np.abs(places))))):
        starts.append(int(np.flatnonzero((topology.tail == hub) & (topology.twin == NONE))[0]))
    return _walk(fan.topology, fine, fan.ring <= rings, (starts[0], starts[1]))


def _walk(coarse: PolygonTopology, fine: PolygonTopology, inside: Mask, start: tuple[int, int]) -> Indices:
    """Along corresponding half-edges, as long as both ends of the coarse one are inside."""
    whole = inside[coarse.tail] & inside[coarse.head]
    matched = np.full(len(inside), NONE)
    seen, waiting = {start[0]}, [start]
    both = coarse, fine
    tails, twins = ([each.tail.tolist() for each in both], [each.twin.tolist() for each in both])
    following = [each.following(np.arange(len(each.corners))).tolist() for each in both]
    while waiting:
        here, there = waiting.pop()
        matched[tails[0][here]] = tails[1][there]
        for mine, theirs in (following, twins):
            onward, beside = mine[here], theirs[there]
            if NONE not in (onward, beside) and onward not in seen and whole[onward]:
                seen.add(onward)
                waiting.append((onward, beside))
    return matched


def _about_centre(topology: PolygonTopology, places: Places, *, hub: bool) -> Indices:
    """The half-edges out of the hub; without one, those of the face in the middle."""
    if hub:
        return np.flatnonzero(topology.tail == int(np.argmin(np.abs(places))))
    middles = np.add.reduceat(places[topology.corners], topology.starts) / topology.sizes
    face = int(np.argmin(np.abs(middles)))
    return np.asarray(topology.starts[face] + np.arange(topology.sizes[face]))


def _middles(topology: PolygonTopology, places: Places) -> Complex128[np.ndarray, " C"]:
    return np.asarray((places[topology.tail] + places[topology.head]) / 2)
