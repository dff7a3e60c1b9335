"""Linear interpolation on the split of a scheme: where its new verts lie while the surface is left as it is."""

from meshfit.subdivision.polygon_scheme import LINEAR, PolygonScheme
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangle_scheme import Split
from meshfit.subdivision.triangle_table import MIDPOINT


def flat(scheme: Scheme) -> Scheme | None:
    """The scheme that keeps old verts and puts those of the same split between them; None where old edges are lost."""
    if isinstance(scheme, PolygonScheme):
        return LINEAR.get(scheme.split)
    return MIDPOINT if scheme.split is Split.QUADRISECT else None
