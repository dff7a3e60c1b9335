"""Rows of an operator as people write them: weights as fractions, by the roles that the verts play."""

from dataclasses import dataclass
from fractions import Fraction

from scipy.sparse import coo_array, csr_array

from meshfit.subdivision.triangle_scheme import PushBack

_LARGEST_DENOMINATOR = 8192
_ZERO = 1e-14


@dataclass(frozen=True)
class MaskRow:
    """One line of a description: which vertex, and its weights as `weight × count role`, or by valence or offset."""

    where: str
    weights: str


def entries(rows: csr_array, row: int) -> list[tuple[int, float]]:
    """The columns and weights of a row, less those that are zero but for rounding."""
    line = coo_array(rows[[row]])
    pairs = zip(line.coords[1], line.data, strict=True)
    return [(int(column), float(weight)) for column, weight in pairs if abs(weight) > _ZERO]


def grouped(rows: csr_array, row: int, roles: dict[int, str], others: str) -> str:
    """A row's weights, with how many verts of each role have them."""
    groups: dict[tuple[str, str], int] = {}
    for column, weight in entries(rows, row):
        key = (roles.get(column, others), number(weight))
        groups[key] = groups.get(key, 0) + 1
    order = [*dict.fromkeys(roles.values()), others]
    found = sorted(groups.items(), key=lambda item: order.index(item[0][0]))
    return ", ".join(f"{weight} {role}" + (f" ({count})" if count > 1 else "") for (role, weight), count in found)


def along(rows: csr_array, row: int, origin: int) -> str:
    """A row's weights along a boundary or another curve, by offset from one of its verts."""
    weights = {column - origin: weight for column, weight in entries(rows, row)}
    listed = ", ".join(number(weights[offset]) for offset in sorted(weights))
    return f"{listed} " + (f"at {min(weights)} … {max(weights)} along it" if len(weights) > 1 else "itself")


def push_back_row(push_back: PushBack) -> MaskRow:
    """What a push-back by one α for all makes of the masks."""
    return MaskRow("push-back", f"alpha = {number(float(push_back.alpha))}: old E + αD, new O + αMD, D = I - E")


def number(value: float) -> str:
    """A weight as a fraction where it is one of small denominator, and to six digits where not."""
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-12 else f"{value:.6f}"
