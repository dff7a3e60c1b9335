"""Up to which α of a push-back a scheme is smooth at a valence."""

from scipy.optimize import brentq

from meshfit.subdivision.analysis.benches import bench_of
from meshfit.subdivision.analysis.local_matrix import invariant_matrix
from meshfit.subdivision.analysis.odd_place import OddPlace, wheels
from meshfit.subdivision.analysis.spectrum import TIE, spectrum_of
from meshfit.subdivision.scheme import Scheme

_EXACT = 1e-9


def largest_alpha(scheme: Scheme, steps: int, place: OddPlace) -> float | None:
    """The α at which another eigenvalue overtakes λ1 at a valence; None where it does not on the way from α = 0.

    Args:
        scheme: as it is analysed, with its own α.
        steps: of the scheme, that make one scalar dilation.
        place: what it does at that valence.
    """
    push_back = getattr(scheme, "push_back", None)
    if push_back is None or place.spectrum.gap > TIE * place.spectrum.leading.modulus:
        return None

    def gap(alpha: float) -> float:
        blend = scheme.with_alpha(alpha)
        matrix = invariant_matrix(wheels(bench_of(blend), place.valence), steps, place.rings)
        return spectrum_of(matrix).gap

    given = float(push_back.alpha)
    if gap(0.0) <= TIE:
        return None
    return float(brentq(gap, 0.0, given, xtol=_EXACT)) if gap(given) < 0 else given
