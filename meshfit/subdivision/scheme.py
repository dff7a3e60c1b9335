"""Parts that schemes of all domains share: the push-back parameter, and the table entry with its provenance."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Generic, Literal, TypeVar

from meshfit.errors import SchemeError
from meshfit.specs import Value, suggest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Kind = Literal["approximating", "interpolatory"]
Domain = Literal["triangles", "polygons", "curves"]
S = TypeVar("S", bound="BaseScheme")
S_co = TypeVar("S_co", bound="BaseScheme", covariant=True)


@dataclass(frozen=True)
class BaseScheme:
    """A subdivision scheme, every parameter fixed: declared data, which the assembler of its domain lays down.

    A push-back takes back, by a share α, the smoothing by the base masks: from approximating (0) to interpolatory (1).
    With E and O the base masks of old and inserted vertices, M linear interpolation on the same split and D = I - E the
    displacement, old vertices become E + αD and inserted ones O + αMD.

    Attributes:
        alpha: the α of a push-back, one value in [0, 1] or one for each vertex of the mesh that is refined; None for
            the base masks alone.
    """

    alpha: "float | NDArray[np.float64] | None" = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        alpha = self.alpha
        if alpha is None:
            return
        low, high = (alpha, alpha) if isinstance(alpha, float | int) else (alpha.min(initial=1), alpha.max(initial=0))
        if not (low >= 0 and high <= 1):
            raise SchemeError(f"alpha is not allowed: all its values must lie from 0 to 1{_first_outside(alpha)}")

    def with_alpha(self: S, alpha: "float | NDArray[np.float64]") -> S:
        """Return the same scheme with another α.

        Raises:
            SchemeError: the scheme is not a push-back, or α is out of range.
        """
        if self.alpha is None:
            raise SchemeError(
                "this scheme has no parameter alpha; interp-loop, interp-catmull-clark, interp-bspline and others do"
            )
        return replace(self, alpha=alpha)


def _first_outside(alpha: "float | NDArray[np.float64]") -> str:
    if isinstance(alpha, float | int):
        return f"; found {alpha:g}"
    vert = int((~((alpha >= 0) & (alpha <= 1))).argmax())
    return f"; vertex {vert} has {alpha.flat[vert]:g}"


@dataclass(frozen=True)
class Parameter:
    """A parameter of a scheme: a number in a range, or one of some words.

    Attributes:
        default: its value when none is given.
        allowed: (lowest, highest), or the words.
        meaning: its effect, in a phrase.
    """

    default: float | str
    allowed: tuple[float, float] | tuple[str, ...]
    meaning: str

    def check(self, name: str, value: Value) -> float | str:
        """Return the value in the parameter's own type.

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
            raise SchemeError(f"{name}={value} is not allowed: expected a number from {low:g} to {high:g}")
        return float(value)


@dataclass(frozen=True)
class SchemeEntry(Generic[S_co]):
    """An entry of the registry: a family of schemes, its parameters and its provenance.

    Attributes:
        title: its name in prose.
        domain: the kind of mesh that it refines.
        kind: whether old vertices move.
        continuity: smoothness of the limit, on regular meshes and at extraordinary vertices.
        source: the publication that the rule comes from.
        declare: parameters → scheme.
        parameters: by name.
    """

    title: str
    domain: Domain
    kind: Kind
    continuity: str
    source: str
    declare: Callable[..., S_co]
    parameters: Mapping[str, Parameter]
