"""Rows of operators, written as masks are."""

from dataclasses import dataclass
from fractions import Fraction

from scipy.sparse import coo_array, csr_array

_LARGEST_DENOMINATOR = 4096
_ZERO = 1e-14


@dataclass(frozen=True)
class MaskRow:
    """One line of a description: which vertex, and its weights as `weight × count role`, or by valence or offset."""

    where: str
    weights: str


def entries(rows: csr_array, row: int) -> list[tuple[int, float]]:
    """The columns and values of one row that are not zero."""
    line = coo_array(rows[[row]])
    pairs = zip(line.coords[1], line.data, strict=True)
    return [(int(column), float(weight)) for column, weight in pairs if abs(weight) > _ZERO]


def number(value: float) -> str:
    """A weight as a fraction where it is one of small denominator, and to six digits where not."""
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-12 else f"{value:.6f}"
