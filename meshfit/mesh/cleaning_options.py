"""Options for cleaning a mesh, apart from `cleaning` because settings need them without its heavy imports."""

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal

Repair = Literal["split", "refuse"]
Surface = Literal["all", "outer"]
"""The part of a mesh that counts: all of it, or what can be seen from outside."""

Keep = Literal["largest"] | float | None
"""The pieces of a target that count: the largest, those of at least a share of its size, or with None all."""


def as_keep(value: object) -> Keep:
    """Return the pieces to keep that a value names: `all` or None, `largest`, or a share above 0 and up to 1.

    Raises:
        ValueError: it is none of these.
    """
    if value is None or (isinstance(value, str) and value == "all"):
        return None
    if isinstance(value, str) and value == "largest":
        return "largest"
    if isinstance(value, Real) and not isinstance(value, bool) and 0 < float(value) <= 1:
        return float(value)
    raise ValueError(value)


@dataclass(frozen=True)
class CleaningOptions:
    """Options for cleaning a mesh.

    Attributes:
        weld: distance, in the unit of the file, up to which boundary vertices are joined; 0 joins equal positions.
        repair: `split` separates faces where they meet in a non-manifold vertex or edge; `refuse` leaves them, so that
            an operation on manifolds refuses the mesh.
    """

    weld: float = 0.0
    repair: Repair = "split"

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "CleaningOptions":
        """Return the options among the settings of an experiment or a source, as plain data."""
        return cls(settings.get("weld") or 0.0, settings.get("repair", "split"))
