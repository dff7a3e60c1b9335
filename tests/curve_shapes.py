"""Small curves for tests: open and closed, as short as possible, several at once, in any numbering."""

from functools import cache

import numpy as np

from meshfit.mesh.curves import Chains, Curves
from meshfit.subdivision.curves.table import CURVE_SCHEMES
from meshfit.subdivision.refine import CurveRefinement, refine
from meshfit.subdivision.registry import resolve
from tests.loops import each

VARIANTS = (
    *CURVE_SCHEMES,
    "four-point:tension=0",
    "four-point:tension=0.03125",
    "four-point:tension=0.15",
    "interp-bspline:alpha=0",
    "interp-bspline:alpha=0.25",
    "interp-bspline:alpha=0.5",
)
by_variant = each("spec", VARIANTS, (*CURVE_SCHEMES, "four-point:tension=0.15"))
INTERPOLATORY = tuple(
    spec for spec in VARIANTS if spec.startswith(("four-point", "ternary-four")) or spec == "interp-bspline"
)


def arity(spec: str) -> int:
    """Into how many segments one is divided."""
    return 3 if spec.startswith("ternary") else 2


def single(size: int, *, closed: bool, seed: int = 0) -> Curves:
    """One curve through random points."""
    return Curves.through(np.random.default_rng(seed).standard_normal((size, 3)), closed=closed)


def many() -> Curves:
    """Chains of all short lengths, open and closed, over verts numbered at random, of which three are not used."""
    generator = np.random.default_rng(4)
    sizes = np.array([2, 2, 3, 3, 4, 5, 9, 8])
    closed = np.array([False, True, False, True, False, True, False, True])
    count = int(sizes.sum())
    return Curves(generator.standard_normal((count + 3, 3)), generator.permutation(count + 3)[:count], sizes, closed)


SHAPES = {
    "one segment": lambda: single(2, closed=False),
    "two segments": lambda: single(3, closed=False),
    "open": lambda: single(7, closed=False),
    "closed on two": lambda: single(2, closed=True),
    "closed on three": lambda: single(3, closed=True),
    "closed": lambda: single(8, closed=True),
    "many": many,
}


@cache
def refined(curves: Curves, spec: str, levels: int = 1) -> CurveRefinement:
    """The refinement of the chains of curves."""
    return refine(Chains.of(curves), resolve(spec), levels)


def dense(curves: Curves, spec: str, levels: int = 1) -> np.ndarray:
    """Its matrix, written out."""
    return refined(curves, spec, levels).matrix.toarray()


def ordered(curves: Curves) -> list[np.ndarray]:
    """For each chain, (n, 3) its points in their order."""
    return np.split(curves.verts[curves.corners], np.cumsum(curves.sizes)[:-1])


def rows_along(spec: str, size: int = 12, *, closed: bool = True, levels: int = 1) -> np.ndarray:
    """The rows of one curve's operator in the order of its fine verts."""
    refinement = refined(single(size, closed=closed), spec, levels)
    return refinement.matrix.toarray()[refinement.chains.corners]
