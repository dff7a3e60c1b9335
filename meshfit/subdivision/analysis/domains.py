"""The one place that knows which domain a scheme is of."""

from meshfit.subdivision.analysis.domain import Domain
from meshfit.subdivision.analysis.triangles import triangle_domain
from meshfit.subdivision.scheme import Scheme


def domain_of(scheme: Scheme) -> Domain:
    """The domain of a scheme, laid down by that scheme."""
    return triangle_domain(scheme)
