"""The polygon schemes and meshes over which the laws are stated."""

from functools import cache

import numpy as np

from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.refine import PolygonRefinement, refine
from meshfit.subdivision.registry import resolve
from tests.loops import each
from tests.quads import EVERY, quad_patch, quad_torus

VARIANTS = (
    *POLYGON_SCHEMES,
    "interp-catmull-clark:alpha=0",
    "interp-catmull-clark:alpha=0.5",
    "interp-sqrt2:alpha=0.5",
)
by_variant = each("spec", VARIANTS, POLYGON_SCHEMES)
INTERPOLATORY = ("interp-catmull-clark", "kobbelt", "interp-sqrt2", "interp-ternary")
REGULAR = ("ternary", "interp-ternary")
ANYWHERE = tuple(spec for spec in VARIANTS if spec not in REGULAR)
KEEPING = tuple(spec for spec in VARIANTS if spec != "doo-sabin")

_REGULAR_MESHES = {"torus": lambda: quad_torus(5, 4), "patch": lambda: quad_patch(5, 4)}


def shapes_for(spec: str) -> list[str]:
    """The names of the meshes that a scheme refines."""
    return list(_REGULAR_MESHES if spec in REGULAR else EVERY)


@cache
def shape_of(name: str) -> PolygonMesh:
    """The mesh of that name."""
    return EVERY[name]()


@cache
def refined(mesh: PolygonMesh, spec: str, levels: int = 1) -> PolygonRefinement:
    """The refinement of a mesh's connectivity."""
    return refine(PolygonTopology.of(mesh), resolve(spec), levels)


def dense(mesh: PolygonMesh, spec: str, levels: int = 1) -> np.ndarray:
    """Its matrix, written out."""
    return refined(mesh, spec, levels).matrix.toarray()
