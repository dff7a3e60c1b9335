"""One valence: the spectrum, the characteristic map, and what they say of the surface there."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

from meshfit.errors import SchemeError
from meshfit.subdivision.analysis.bench import Bench, Wheel
from meshfit.subdivision.analysis.characteristic import is_regular
from meshfit.subdivision.analysis.lattice import RegularMask
from meshfit.subdivision.analysis.local_matrix import invariant_matrix
from meshfit.subdivision.analysis.spectrum import Spectrum, spectrum_of

_ROUNDING = 1e-9
_LEAST = 3


@dataclass(frozen=True)
class OddPlace:
    """What a scheme does at a vertex, or for dual schemes a face, of one valence amid regular ones.

    Attributes:
        spectrum: the leading eigenvalues of the local matrix.
        rings: how many rings the matrix is over.
        regular_map: whether the characteristic map keeps its orientation.
    """

    spectrum: Spectrum
    rings: int
    regular_map: bool

    @property
    def valence(self) -> int:
        """The number of edges, or of corners."""
        return self.spectrum.valence

    @property
    def fault(self) -> str:
        """Why the surface is not C1 here, where it is on regular meshes; empty where it is (Reif 1995)."""
        return self.spectrum.fault or ("" if self.regular_map else "the characteristic map folds")


def study_valence(bench: Bench, mask: RegularMask, radius: float, valence: int) -> OddPlace:
    """Look at one valence.

    Args:
        bench: with wheels.
        mask: on its regular lattice.
        radius: of the basis function, in rings: so many rings decide on the surface around the centre.
        valence: number of spokes, 3 or more.

    Raises:
        SchemeError: no number of rings follows from itself.
    """
    wheel_of = wheels(bench, valence)
    matrix = invariant_matrix(wheel_of, mask.steps, ceil(radius - _ROUNDING))
    wider = invariant_matrix(wheel_of, mask.steps, matrix.rings + 1)
    regular = is_regular(wheel_of, wider, mask.steps, mask.dilation)
    return OddPlace(spectrum_of(matrix), matrix.rings, regular)


def wheels(bench: Bench, valence: int) -> Callable[[int], Wheel]:
    """Number of rings → the wheel of that valence.

    Raises:
        SchemeError: nothing is extraordinary in this bench, or a wheel has fewer than 3 spokes.
    """
    make = bench.wheel
    if make is None or valence < _LEAST:
        raise SchemeError(f"{bench.name} have nothing of valence {valence} to analyse: 3 or more is, off curves")
    return lambda rings: make(valence, rings)
