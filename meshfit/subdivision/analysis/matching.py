"""Which fine vertex is in the place of which coarse one: both connectivities are walked at once, from the centre on."""

import numpy as np
from jaxtyping import Complex128

from meshfit.mesh.topology import NONE, Indices, Mask
from meshfit.subdivision.analysis.bench import Fan, HalfEdges, Wheel

Places = Complex128[np.ndarray, " V"]


def match_wheel(wheel: Wheel, fine: HalfEdges, places: Places, rings: int) -> Indices:
    """(V,) the fine vertex in the place of each coarse one of the first rings; `NONE` for the others.

    Args:
        wheel: the coarse connectivity.
        fine: the fine one.
        places: where the wheel locates the fine verts.
        rings: how many are matched.
    """
    mine = _about_centre(wheel.halfedges, wheel.places, hub=wheel.hub)
    theirs = _about_centre(fine, places, hub=wheel.hub)
    ahead = _middles(wheel.halfedges, wheel.places)[mine[0]]
    turned = np.abs(np.angle(_middles(fine, places)[theirs] / ahead))
    inside = np.zeros(len(wheel.places), dtype=bool)
    inside[wheel.within(rings)] = True
    return _walk(wheel.halfedges, fine, inside, (int(mine[0]), int(theirs[np.argmin(turned)])))


def match_fan(fan: Fan, fine: HalfEdges, places: Places, rings: int) -> Indices:
    """The same around a vertex on the boundary, from the half-edge out of it that lies there."""
    starts = []
    for halfedges, hub in ((fan.halfedges, 0), (fine, int(np.argmin(np.abs(places))))):
        starts.append(int(np.flatnonzero((halfedges.tail == hub) & (halfedges.twin == NONE))[0]))
    return _walk(fan.halfedges, fine, fan.ring <= rings, (starts[0], starts[1]))


def _walk(coarse: HalfEdges, fine: HalfEdges, inside: Mask, start: tuple[int, int]) -> Indices:
    """Along corresponding half-edges, as long as both ends of the coarse one are inside."""
    whole = inside[coarse.tail] & inside[coarse.head]
    matched = np.full(len(inside), NONE)
    seen, waiting = {start[0]}, [start]
    following, tails = (coarse.following.tolist(), fine.following.tolist()), (coarse.tail.tolist(), fine.tail.tolist())
    twins = coarse.twin.tolist(), fine.twin.tolist()
    while waiting:
        here, there = waiting.pop()
        matched[tails[0][here]] = tails[1][there]
        for mine, theirs in (following, twins):
            onward, beside = mine[here], theirs[there]
            if NONE not in (onward, beside) and onward not in seen and whole[onward]:
                seen.add(onward)
                waiting.append((onward, beside))
    return matched


def _about_centre(halfedges: HalfEdges, places: Places, *, hub: bool) -> Indices:
    """Those out of the hub; without one, those of the face in the middle."""
    if hub:
        return np.flatnonzero(halfedges.tail == int(np.argmin(np.abs(places))))
    here = int(np.argmin(np.abs(_face_centres(halfedges, places))))
    face = [here]
    while (here := int(halfedges.following[here])) != face[0]:
        face.append(here)
    return np.array(face)


def _middles(halfedges: HalfEdges, places: Places) -> Complex128[np.ndarray, " H"]:
    return np.asarray((places[halfedges.tail] + places[halfedges.head]) / 2)


def _face_centres(halfedges: HalfEdges, places: Places) -> Complex128[np.ndarray, " H"]:
    """(H,) the mean of the corners of the face of each half-edge, whatever the sizes of faces are."""
    total, corners = places[halfedges.tail].copy(), np.ones(len(halfedges.tail))
    ahead = halfedges.following.copy()
    going = ahead != np.arange(len(ahead))
    while going.any():
        total[going] += places[halfedges.tail[ahead[going]]]
        corners[going] += 1
        ahead[going] = halfedges.following[ahead[going]]
        going = ahead != np.arange(len(ahead))
    return np.asarray(total / corners)
