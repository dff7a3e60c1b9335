"""The bench of schemes on curves: a line, on which nothing is extraordinary."""

import numpy as np

from meshfit.analysis.polygon_meshes import polygon_bench
from meshfit.analysis.stencil_meshes import Bench, Finer, Patch
from meshfit.analysis.triangle_meshes import triangle_bench
from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import refine
from meshfit.subdivision.scheme import Scheme

_BORDER = 2


def curve_bench(scheme: CurveScheme) -> Bench:
    """A line of verts, each with two neighbours."""
    return Bench("curves", 1, "", 2, lambda reach: _patch(scheme, reach), None, None, _distance, ((1.0,),))


def _distance(places: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(places[:, 0]))


def _patch(scheme: CurveScheme, reach: int) -> Patch:
    count = 2 * reach + 1
    chains = Chains(count, np.arange(count), np.array([count]), np.array([False]))
    places = np.arange(count)[:, None] - float(reach)

    def refined(steps: int) -> Finer:
        found = refine(chains, scheme, steps)
        return Finer(found.operators, _segments(found.chains))

    return Patch(places, _segments(chains), np.abs(places[:, 0]) <= reach - _BORDER, refined)


def _segments(chains: Chains) -> PolygonTopology:
    """Each segment as a face of two corners."""
    ends = np.stack([chains.tail, chains.head], axis=1)
    return PolygonTopology(chains.num_verts, ends.reshape(-1), np.full(len(ends), 2))


def bench_of(scheme: Scheme) -> Bench:
    """The bench of a scheme's domain, laid down by that scheme."""
    if isinstance(scheme, CurveScheme):
        return curve_bench(scheme)
    return polygon_bench(scheme) if isinstance(scheme, PolygonScheme) else triangle_bench(scheme)
