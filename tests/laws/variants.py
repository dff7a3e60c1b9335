"""The triangle schemes over which the laws are stated: the whole table, and more values of parameters."""

from functools import cache

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.subdivision.refine import Refinement, refine
from meshfit.subdivision.registry import resolve
from meshfit.subdivision.triangles.scheme import Split
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES
from tests.loops import each

VARIANTS = (
    *TRIANGLE_SCHEMES,
    "loop:weights=warren",
    "interp-loop:alpha=0",
    "interp-loop:alpha=0.25",
    "interp-loop:alpha=0.5",
    "interp-loop:weights=warren",
    "interp-loop:valence3=zorin",
    "interp-loop:alpha=0.5,weights=warren,valence3=zorin",
    "butterfly:tension=0",
    "butterfly:tension=0.03",
    "butterfly:tension=0.125",
    "lin-luo-sqrt3:alpha=0.5",
)
by_variant = each("spec", VARIANTS, (*TRIANGLE_SCHEMES, "interp-loop:alpha=0.5,weights=warren,valence3=zorin"))
QUADRISECTING = tuple(spec for spec in VARIANTS if resolve(spec).split is Split.QUADRISECT)
SQRT3 = tuple(spec for spec in VARIANTS if spec not in QUADRISECTING)
INTERPOLATORY = (
    "midpoint",
    "interp-loop",
    "interp-loop:weights=warren",
    "interp-loop:valence3=zorin",
    "butterfly",
    "butterfly:tension=0",
    "butterfly:tension=0.03",
    "butterfly:tension=0.125",
    "modified-butterfly",
    "lin-luo-sqrt3",
    "interp-sqrt3",
)


@cache
def refined(mesh: Mesh, spec: str, levels: int = 1) -> Refinement:
    """The refinement of a mesh's connectivity."""
    return refine(Topology.of(mesh), resolve(spec), levels)


def dense(mesh: Mesh, spec: str, levels: int = 1) -> np.ndarray:
    """Its matrix, written out."""
    return refined(mesh, spec, levels).matrix.toarray()
