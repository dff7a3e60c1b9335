"""The table of schemes, all domains together, in the order that they are listed in."""

from meshfit.subdivision.curve_table import CURVE_SCHEMES
from meshfit.subdivision.polygon_table import POLYGON_SCHEMES
from meshfit.subdivision.scheme import SchemeEntry
from meshfit.subdivision.triangle_table import TRIANGLE_SCHEMES

SCHEMES: dict[str, SchemeEntry] = {**TRIANGLE_SCHEMES, **POLYGON_SCHEMES, **CURVE_SCHEMES}
