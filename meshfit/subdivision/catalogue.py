"""The schemes that there are: those of the table, and beside them the user's own."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

from pydantic import AfterValidator, Field

from meshfit.errors import SchemeError
from meshfit.settings import Settings
from meshfit.subdivision.choose import Catalogue, entry_of, scheme_of, spec_of
from meshfit.subdivision.definition import Definition, PushBackDefinition
from meshfit.subdivision.formulas import fault
from meshfit.subdivision.masks import CHECKED_VALENCES
from meshfit.subdivision.scheme import Kind, Parameter, Scheme, SchemeEntry
from meshfit.subdivision.table import SCHEMES
from meshfit.subdivision.triangle_scheme import PushBack, TriangleScheme

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_LONGEST_NAME = 60
_CONTINUITY, _SOURCE = "not known", "your own"


def _name(name: str) -> str:
    """A name that neither folders nor specs nor the table of schemes can take for something else."""
    if not _NAME.fullmatch(name):
        raise ValueError("no name for a scheme: small letters, digits and single hyphens are allowed, as in my-loop")
    if len(name) > _LONGEST_NAME:
        raise ValueError(f"a name of {len(name)} characters; {_LONGEST_NAME} are allowed")
    if name in SCHEMES:
        raise ValueError("the name of a scheme that comes with meshfit; choose another")
    return name


def _resolvable(definitions: dict[str, Definition]) -> dict[str, Definition]:
    for name, definition in definitions.items():
        try:
            _entry(name, definition, definitions)
        except SchemeError as error:
            raise fault((name, "base"), str(error)) from None
    return definitions


Definitions = Annotated[dict[Annotated[str, AfterValidator(_name)], Definition], AfterValidator(_resolvable)]
"""Schemes of the user's own, by name."""


class OwnSchemes(Settings):
    """Schemes of the user's own, where there are no other settings."""

    define: Definitions = Field(default_factory=dict)
    """By name."""


@dataclass(frozen=True, eq=False)
class _Catalogue(Mapping[str, SchemeEntry]):
    """Entries of definitions are made when they are asked for."""

    definitions: Mapping[str, Definition]

    def __getitem__(self, name: str) -> SchemeEntry:
        if name in SCHEMES:
            return SCHEMES[name]
        return _entry(name, self.definitions[name], self.definitions)

    def __iter__(self) -> Iterator[str]:
        yield from SCHEMES
        yield from self.definitions

    def __len__(self) -> int:
        return len(SCHEMES) + len(self.definitions)


def catalogue_of(definitions: Mapping[str, Definition]) -> Catalogue:
    """The table of schemes, with definitions beside it, none of which has a name of the table."""
    return _Catalogue(definitions)


@dataclass(frozen=True)
class NamedScheme:
    """A scheme by its spec, with those of a user's definitions that it hangs on: a value that caches can be kept by.

    Attributes:
        spec: the spec.
        own: the scheme's definition and that of its base, by name, where the user has defined them.
    """

    spec: str
    own: tuple[tuple[str, Definition], ...] = ()

    @classmethod
    def of(cls, spec: str, definitions: Mapping[str, Definition]) -> "NamedScheme":
        """The scheme of a spec, among some definitions and the table."""
        found: dict[str, Definition] = {}
        name = spec_of(spec).name
        while name in definitions and name not in found:
            definition = found[name] = definitions[name]
            if isinstance(definition, PushBackDefinition):
                name = spec_of(definition.base).name
        return cls(spec, tuple(found.items()))

    def declared(self) -> Scheme:
        """The scheme, every parameter fixed.

        Raises:
            SchemeError: there is none of that name, or a parameter is not allowed.
        """
        return scheme_of(self.spec, catalogue_of(dict(self.own)))


def _entry(name: str, definition: Definition, definitions: Mapping[str, Definition]) -> SchemeEntry:
    if not isinstance(definition, PushBackDefinition):
        kind: Kind = "interpolatory" if _keeps_old_verts(definition.scheme()) else "approximating"
        declare = partial(definition.scheme, name)
        return SchemeEntry(name, "triangles", kind, _CONTINUITY, _SOURCE, declare, {})
    base, entry = _base(name, definition.base, definitions)
    kind = "interpolatory" if definition.alpha == 1 else entry.kind
    alpha = Parameter(definition.alpha, (0.0, 1.0), f"from {definition.base} (0) to interpolatory (1)")
    source = f"{_SOURCE}, a push-back of {definition.base}"
    pushed_back = partial(_pushed_back, base)
    return SchemeEntry(name, entry.domain, kind, _CONTINUITY, source, pushed_back, {"alpha": alpha})


def _base(name: str, base: str, definitions: Mapping[str, Definition]) -> tuple[Scheme, SchemeEntry]:
    """The scheme that is pushed back, and its entry."""
    own = spec_of(base).name
    catalogue = SCHEMES
    if own in definitions:
        if isinstance(definitions[own], PushBackDefinition):
            what = "the definition itself" if own == name else "a push-back too"
            raise SchemeError(f"'{base}' is {what}; a scheme of masks alone is needed")
        catalogue = {**SCHEMES, own: _entry(own, definitions[own], definitions)}
    scheme, entry = scheme_of(base, catalogue), entry_of(own, catalogue)
    if not hasattr(scheme, "push_back"):
        raise SchemeError(f"'{base}', a scheme on {entry.domain}, cannot be pushed back")
    if scheme.push_back is not None:
        raise SchemeError(f"'{base}' is pushed back already; a scheme of masks alone is needed")
    return scheme, entry


def _pushed_back(base: Scheme, alpha: float) -> Scheme:
    return replace(base, push_back=PushBack(alpha))


def _keeps_old_verts(scheme: TriangleScheme) -> bool:
    inner = scheme.vert is None or not any(scheme.vert.ring(valence) for valence in CHECKED_VALENCES)
    return inner and {offset for offset, weight in scheme.boundary.vert.items() if weight} == {0}
