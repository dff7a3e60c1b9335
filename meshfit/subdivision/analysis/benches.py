"""The one place that knows which bench a scheme is for."""

from meshfit.subdivision.analysis.bench import Bench
from meshfit.subdivision.analysis.curves import curve_bench
from meshfit.subdivision.analysis.polygons import polygon_bench
from meshfit.subdivision.analysis.triangles import triangle_bench
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.scheme import Scheme


def bench_of(scheme: Scheme) -> Bench:
    """The bench of a scheme's domain, laid down by that scheme."""
    if isinstance(scheme, CurveScheme):
        return curve_bench(scheme)
    return polygon_bench(scheme) if isinstance(scheme, PolygonScheme) else triangle_bench(scheme)
