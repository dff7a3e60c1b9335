"""The basis function of a scheme: the limit of the data that are 1 at one vertex of the regular lattice."""

from dataclasses import dataclass
from math import ceil, log

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.mesh.polygons import fan_triangles
from meshfit.subdivision.analysis.bench import Bench, Patch

_FINENESS = 24
_MARGIN = 0.35


@dataclass(frozen=True, eq=False)
class Basis:
    """The function, sampled.

    Attributes:
        places: (V, D) where, edges of the lattice having length 1.
        values: (V,) what it is there.
        triangles: (T, 3) between these places; none on a line, where places are in order.
        lattice: (L, 2, D) the ends of the control edges within its support.
    """

    places: Float64[np.ndarray, "V D"]
    values: Float64[np.ndarray, " V"]
    triangles: Int64[np.ndarray, "T 3"]
    lattice: Float64[np.ndarray, "L 2 D"]


def basis_of(bench: Bench, steps: int, dilation: int, radius: float) -> Basis:
    """Sample it by refining, until about 24 samples lie along an edge.

    Args:
        bench: laid down by the scheme.
        steps: of the scheme, that make one scalar dilation.
        dilation: fine edges along a coarse one after so many steps.
        radius: of the support, in rings.
    """
    reach = ceil(radius) + 4
    patch = bench.patch(reach)
    origin = (patch.places == 0).all(axis=1) * 1.0
    finer = patch.refine(steps * ceil(log(_FINENESS) / log(dilation)))
    places, values = finer.carry(patch.places), finer.carry(origin)
    near = bench.distance(places) <= radius + _MARGIN
    if bench.dimension == 1:
        order = np.argsort(places[:, 0])
        chosen, triangles = order[near[order]], np.empty((0, 3), dtype=np.int64)
    else:
        chosen = np.flatnonzero(near)
        every = fan_triangles(finer.topology.corners, finer.topology.sizes)
        place = np.full(len(places), -1)
        place[chosen] = np.arange(len(chosen))
        triangles = place[every]
        triangles = triangles[(triangles >= 0).all(axis=1)]
    axes = np.array(bench.axes)
    return Basis(places[chosen] @ axes, values[chosen], triangles, _edges_within(bench, patch, radius) @ axes)


def _edges_within(bench: Bench, patch: Patch, radius: float) -> Float64[np.ndarray, "L 2 D"]:
    """The control edges whose ends are no farther than the support."""
    ends = patch.topology.edges
    inside = bench.distance(patch.places) <= max(1.0, radius) + _MARGIN
    return np.asarray(patch.places[ends[inside[ends].all(axis=1)]])
