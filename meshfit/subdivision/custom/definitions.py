"""User-defined schemes, as declared in YAML: by masks, or as a push-back of another scheme."""

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PlainValidator, Tag, WithJsonSchema, model_validator

from meshfit.errors import SchemeError
from meshfit.settings import Settings
from meshfit.subdivision.custom.formulas import OTHERS, Written, read_formula, read_ring, read_spokes, weight
from meshfit.subdivision.masks import (
    CUBIC_BSPLINE,
    LINEAR,
    TERNARY_BSPLINE,
    TERNARY_FOUR_POINT,
    CurveMask,
    Weight,
    four_point,
)
from meshfit.subdivision.triangles.scheme import EdgeMask, FaceMask, Split, SpokeMask, TriangleScheme, VertMask

BOUNDARIES: Mapping[str, CurveMask] = MappingProxyType(
    {
        "linear": LINEAR,
        "cubic-bspline": CUBIC_BSPLINE,
        "four-point": four_point(Fraction(1, 16)),
        "ternary-bspline": TERNARY_BSPLINE,
        "ternary-four-point": TERNARY_FOUR_POINT,
    }
)
"""Curve rules that a boundary may follow."""


def _checked(written: Any, read: Callable[[object], object], *, optional: bool = False) -> Any:  # noqa: ANN401
    """Check that a value can be read, and return it in canonical form: texts on one line, keys as texts."""
    if not (optional and written is None):
        _accepted(lambda: read(written))
    return _plain(written)


def _plain(written: Any) -> Any:  # noqa: ANN401  any YAML value
    if isinstance(written, dict):
        return {str(key): _plain(value) for key, value in written.items()}
    if isinstance(written, list | tuple):
        return [_plain(value) for value in written]
    return " ".join(written.split()) if isinstance(written, str) else written


def _read_weight(written: object) -> Weight:
    return weight(read_formula(written))


_NUMBER = [{"type": "number"}, {"type": "string"}]
_LIST = {"type": "array", "items": {"anyOf": _NUMBER}, "minItems": 3}


def _schema(*kinds: dict[str, Any]) -> WithJsonSchema:
    entries = {"anyOf": [*_NUMBER, *kinds]}
    by_valence = {"type": "object", "required": [OTHERS], "additionalProperties": entries}
    return WithJsonSchema({"anyOf": [*_NUMBER, by_valence, {"type": "null"}]})


Formula = Annotated[Written, PlainValidator(partial(_checked, read=_read_weight)), WithJsonSchema({"anyOf": _NUMBER})]
RingFormulas = Annotated[Any, PlainValidator(partial(_checked, read=read_ring, optional=True)), _schema()]
SpokeFormulas = Annotated[Any, PlainValidator(partial(_checked, read=read_spokes, optional=True)), _schema(_LIST)]


class EdgeWeights(Settings):
    """Weights of a new vertex in an inner edge: of 2 ends, 2 opposites and 4 wings; they sum to one."""

    end: Formula
    """Weight of each of the 2 ends of the edge: a number, or a formula such as 3/8."""
    opposite: Formula = 0.0
    """Weight of each of the 2 vertices opposite to the edge in its faces."""
    wing: Formula = 0.0
    """Weight of each of the 4 vertices across the other edges of its faces."""

    @model_validator(mode="after")
    def _sum_to_one(self) -> "EdgeWeights":
        _accepted(self.mask)
        return self

    def mask(self) -> EdgeMask:
        """Return the mask."""
        return EdgeMask(_read_weight(self.end), _read_weight(self.opposite), _read_weight(self.wing))


class FaceWeights(Settings):
    """Weights of a new vertex in a face: of 3 corners, 3 across and 6 wings; they sum to one."""

    corner: Formula
    """Weight of each of the 3 corners of the face: a number, or a formula such as 1/3."""
    across: Formula = 0.0
    """Weight of each of the 3 vertices across the edges of the face."""
    wing: Formula = 0.0
    """Weight of each of the 6 vertices across the outer edges of the 3 neighbouring faces."""

    @model_validator(mode="after")
    def _sum_to_one(self) -> "FaceWeights":
        _accepted(self.mask)
        return self

    def mask(self) -> FaceMask:
        """Return the mask."""
        return FaceMask(_read_weight(self.corner), _read_weight(self.across), _read_weight(self.wing))


class _Definition(Settings):
    def __hash__(self) -> int:
        """Hash the JSON text, since weights by valence are plain data without a hash."""
        return hash(self.model_dump_json())


class _Masks(_Definition):
    split: Literal["quadrisect", "sqrt3"]
    vertex: RingFormulas = None
    """Total weight of the one-ring of an old inner vertex; the vertex itself gets the rest. A formula in its valence n,
    or formulas for some valences and one for all others, as in {3: 9/16, else: 3/8}. null: old inner vertices stay."""
    spokes: SpokeFormulas = None
    """Weights of the one-ring of an inner vertex of valence n other than 6 for a new vertex next to it: a formula in n
    and in the number j of the neighbour, or by valence, where lists are allowed too. j counts counter-clockwise from 0,
    the other end of the edge (in a face, 0 and 1 are the other corners). The vertex itself gets the rest to one.
    null: new vertices there follow the same rule as elsewhere."""

    def _vert(self, name: str) -> VertMask | None:
        return None if self.vertex is None else VertMask(read_ring(self.vertex, f"{name}: vertex: "))

    def _spokes(self, name: str) -> SpokeMask | None:
        return None if self.spokes is None else SpokeMask(read_spokes(self.spokes, f"{name}: spokes: "))


class EdgeSchemeDefinition(_Masks):
    """A scheme of the 1-to-4 split on triangles, defined by its masks."""

    split: Annotated[Literal["quadrisect", "sqrt3"], WithJsonSchema({"const": "quadrisect"})] = "quadrisect"
    """How faces are divided: `quadrisect`, 1-to-4, with a new vertex in every edge; or `sqrt3`."""
    edge: EdgeWeights
    """Weights of a new vertex in an inner edge."""
    boundary: Literal["linear", "cubic-bspline", "four-point"]
    """The curve rule along boundaries: `linear`, `cubic-bspline` or `four-point`."""

    def scheme(self, name: str = "") -> TriangleScheme:
        """Return the scheme of the masks; the name is for messages."""
        return TriangleScheme(
            Split.QUADRISECT, self.edge.mask(), BOUNDARIES[self.boundary], self._vert(name), self._spokes(name)
        )


class FaceSchemeDefinition(_Masks):
    """A scheme of the 1-to-3 split on triangles, defined by its masks."""

    split: Literal["sqrt3"]
    """How faces are divided: 1-to-3, with a new vertex in every face, and old edges flipped."""
    face: FaceWeights
    """Weights of a new vertex in a face."""
    boundary: Literal["ternary-bspline", "ternary-four-point"]
    """The curve rule along boundaries: `ternary-bspline` or `ternary-four-point`."""

    def scheme(self, name: str = "") -> TriangleScheme:
        """Return the scheme of the masks; the name is for messages."""
        return TriangleScheme(
            Split.SQRT3, self.face.mask(), BOUNDARIES[self.boundary], self._vert(name), self._spokes(name)
        )


class PushBackDefinition(_Definition):
    """A scheme pushed back towards interpolation: from its base (alpha = 0) to keeping old vertices (1)."""

    base: str
    """The scheme that is pushed back, a spec such as `loop:weights=warren` or another definition by masks."""
    alpha: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Default alpha; a spec such as `softer:alpha=0.3` overrides it."""


def _form(definition: Any) -> str:  # noqa: ANN401  a definition, or data to be validated
    given = definition if isinstance(definition, dict) else getattr(definition, "__dict__", {})
    if "base" in given:
        return "push-back"
    return "sqrt3" if given.get("split") == "sqrt3" else "quadrisect"


Definition = Annotated[
    Annotated[EdgeSchemeDefinition, Tag("quadrisect")]
    | Annotated[FaceSchemeDefinition, Tag("sqrt3")]
    | Annotated[PushBackDefinition, Tag("push-back")],
    Discriminator(_form),
]
"""A scheme by masks on one of two splits, or as a push-back, which names its `base`."""


def _accepted(make: Callable[[], object]) -> None:
    try:
        make()
    except SchemeError as error:
        raise ValueError(str(error)) from None
