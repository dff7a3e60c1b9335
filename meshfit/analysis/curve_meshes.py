"""The meshes of schemes on curves: a line, on which nothing is extraordinary."""

import numpy as np

from meshfit.analysis.polygon_meshes import polygon_meshes
from meshfit.analysis.stencil_meshes import FinerMesh, Patch, StencilMeshes
from meshfit.analysis.triangle_meshes import triangle_meshes
from meshfit.mesh.curves import Chains
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import refine
from meshfit.subdivision.scheme import Scheme

_BORDER = 2


def curve_meshes(scheme: CurveScheme) -> StencilMeshes:
    """A line of verts, each with two neighbours."""
    return StencilMeshes("curves", 1, "", 2, lambda reach: _patch(scheme, reach), None, None, _distance, ((1.0,),))


def _distance(places: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(places[:, 0]))


def _patch(scheme: CurveScheme, reach: int) -> Patch:
    count = 2 * reach + 1
    chains = Chains(count, np.arange(count), np.array([count]), np.array([False]))
    places = np.arange(count)[:, None] - float(reach)

    def refined(steps: int) -> FinerMesh:
        found = refine(chains, scheme, steps)
        return FinerMesh(found.operators, _segments(found.chains))

    return Patch(places, _segments(chains), np.abs(places[:, 0]) <= reach - _BORDER, refined)


def _segments(chains: Chains) -> PolygonTopology:
    """Each segment as a face of two corners."""
    ends = np.stack([chains.tail, chains.head], axis=1)
    return PolygonTopology(chains.num_verts, ends.reshape(-1), np.full(len(ends), 2))


def stencil_meshes(scheme: Scheme) -> StencilMeshes:
    """The meshes of a scheme's domain, laid down by that scheme."""
    if isinstance(scheme, CurveScheme):
        return curve_meshes(scheme)
    return polygon_meshes(scheme) if isinstance(scheme, PolygonScheme) else triangle_meshes(scheme)
