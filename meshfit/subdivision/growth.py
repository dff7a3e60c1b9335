"""How fast the verts of a surface become more by a scheme, before it is refined."""

from meshfit.subdivision.polygon_scheme import PolygonScheme, PolygonSplit
from meshfit.subdivision.scheme import Scheme

# On a large closed surface of triangles, which has three edges and two faces for each vertex, the first level, and any
# that follows it on the polygons that it leaves.
_ON_TRIANGLES: dict[PolygonSplit, tuple[float, float]] = {
    PolygonSplit.QUADS: (6.0, 4.0),
    PolygonSplit.SQRT2: (3.0, 2.0),
    PolygonSplit.TERNARY: (13.0, 9.0),
    PolygonSplit.DUAL: (6.0, 4.0),
}


def growth(scheme: Scheme, levels: int) -> float:
    """About how many verts come of each by some levels on triangles; four at each for any scheme on triangles."""
    if not isinstance(scheme, PolygonScheme):
        return 4.0**levels
    first, later = _ON_TRIANGLES[scheme.split]
    return first * later ** (levels - 1) if levels else 1.0
