"""The noun of this layer: a scheme on triangles, polygons or curves, and its entry in the table with its provenance."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from meshfit.errors import SchemeError
from meshfit.specs import Value, suggest
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.triangles.scheme import TriangleScheme

Kind = Literal["approximating", "interpolatory"]
Domain = Literal["triangles", "polygons", "curves"]
Scheme = TriangleScheme | PolygonScheme | CurveScheme
"""A scheme, every parameter fixed."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a scheme: a number in a range, or one of some words.

    Attributes:
        default: its value when none is given.
        allowed: (lowest, highest), or the words.
        meaning: what it does, in a phrase.
    """

    default: float | str
    allowed: tuple[float, float] | tuple[str, ...]
    meaning: str

    def check(self, name: str, value: Value) -> float | str:
        """The value in the parameter's own type.

        Raises:
            SchemeError: it is not allowed.
        """
        if isinstance(self.default, str):
            if value in self.allowed:
                return str(value)
            words = [str(word) for word in self.allowed]
            raise SchemeError(f"{name}={value} is not allowed: {suggest(str(value), words)}")
        low, high = self.allowed
        if isinstance(value, str) or not float(low) <= value <= float(high):
            raise SchemeError(f"{name}={value} is not allowed: a number from {low:g} to {high:g} is")
        return float(value)


@dataclass(frozen=True)
class SchemeEntry:
    """A row of the table of schemes: a family, its parameters, and where it comes from.

    Attributes:
        title: its name in prose.
        domain: what it refines.
        kind: whether old vertices move.
        continuity: smoothness of the limit, on regular meshes and at extraordinary vertices.
        source: the publication the rule comes from.
        declare: parameters → scheme.
        parameters: by name.
    """

    title: str
    domain: Domain
    kind: Kind
    continuity: str
    source: str
    declare: Callable[..., Scheme]
    parameters: Mapping[str, Parameter]
