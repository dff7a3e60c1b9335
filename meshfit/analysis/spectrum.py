"""Eigenvalues of the local matrix at an extraordinary vertex, and the smoothness that follows from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128

from meshfit.analysis.local_matrix import LocalMatrix

TIE = 1e-5
"""Relative difference below which moduli of eigenvalues count as equal; multiple ones are no more exact than this."""

_ZERO = 1e-14


@dataclass(frozen=True)
class Eigenvalue:
    """An eigenvalue of a local matrix, and the Fourier mode of its eigenvectors, from 0 to n/2."""

    value: complex
    mode: int

    @property
    def modulus(self) -> float:
        """The absolute value."""
        return abs(self.value)


@dataclass(frozen=True)
class Spectrum:
    """The eigenvalues that decide on smoothness at an extraordinary vertex.

    Attributes:
        valence: n, the number of spokes.
        leading: λ1, the largest eigenvalue of mode 1, which counts twice, since mode n - 1 has it too.
        rest: the largest of all others but the 1 of constants.
        multiplicity: how many eigenvalues are as large as λ1: 2 where it is of mode 1 alone.
    """

    valence: int
    leading: Eigenvalue
    rest: Eigenvalue
    multiplicity: int

    @property
    def gap(self) -> float:
        """λ1 less the modulus of the rest: positive where the tangent plane exists."""
        return self.leading.modulus - self.rest.modulus

    @property
    def fault(self) -> str:
        """The violation of 1 > λ1 = λ2 > |rest| with λ1 real and of mode 1; empty where there is none.

        Reif 1995, A unified approach to subdivision algorithms near extraordinary vertices.
        """
        value, size = self.leading.value, self.leading.modulus
        if value.real <= 0 or abs(value.imag) > TIE * size or size >= 1 - TIE:
            return f"the largest eigenvalue of mode 1 is {_written(value)}, not between 0 and 1"
        if self.gap > TIE * size:
            return ""
        compared = "exceeds" if self.gap < -TIE * size else "equals"
        return f"|λ| = {self.rest.modulus:.4f} of mode {self.rest.mode} {compared} {size:.4f} of mode 1"

    @property
    def curvature(self) -> str:
        """Curvatures at a tangent plane: `bounded` for |rest| = λ1², `flat` (all 0) below, `unbounded` above."""
        excess = self.rest.modulus - self.leading.modulus**2
        if abs(excess) <= 10 * TIE:
            return "bounded"
        return "flat" if excess < 0 else "unbounded"


def spectrum_of(matrix: LocalMatrix) -> Spectrum:
    """Return the leading eigenvalues of a local matrix, by Fourier mode."""
    n = matrix.valence
    by_mode = {mode: eigenvalues(matrix.block(mode)) for mode in range(n // 2 + 1)}
    by_mode[0] = np.delete(by_mode[0], int(np.argmin(np.abs(by_mode[0] - 1))))
    leading, by_mode[1] = Eigenvalue(_upper(by_mode[1][0]), 1), by_mode[1][1:]
    others = [Eigenvalue(_upper(value), mode) for mode, values in by_mode.items() for value in values]
    # Modes n/2 < m < n repeat those below n/2; of equal moduli the one of the lowest mode is named.
    largest = max((other.modulus for other in others), default=0.0)
    rest = next((other for other in others if other.modulus >= largest * (1 - TIE)), Eigenvalue(0j, 0))
    tied = [other for other in others if abs(other.modulus - leading.modulus) <= TIE * leading.modulus]
    return Spectrum(n, leading, rest, 2 + sum(1 + (0 < 2 * other.mode < n) for other in tied))


def eigenvalues(block: Complex128[np.ndarray, "L L"]) -> Complex128[np.ndarray, " L"]:
    """Return the eigenvalues, largest modulus first.

    Inner rings do not depend on outer ones, so each diagonal part is solved by itself; the coupling between the parts
    would only make multiple eigenvalues less exact.
    """
    cuts = [i for i in range(1, len(block)) if (np.abs(block[:i, i:]) <= _ZERO).all()]
    parts = zip([0, *cuts], [*cuts, len(block)], strict=True)
    values = np.concatenate([np.linalg.eigvals(block[low:high, low:high]) for low, high in parts])
    return np.asarray(values[np.argsort(-np.abs(values), kind="stable")])


def _upper(value: np.complex128) -> complex:
    """Return an eigenvalue or its conjugate, which mode n - m has, whichever is in the upper half plane."""
    return complex(value.real, abs(value.imag))


def _written(value: complex) -> str:
    return f"{value.real:.4f}" if abs(value.imag) < TIE else f"{value.real:.4f} ± {abs(value.imag):.4f}i"
