"""The table of schemes, all domains together, in the order that they are listed in."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

from pydantic import AfterValidator, Field

from meshfit.errors import ConfigError, SchemeError
from meshfit.settings import Settings
from meshfit.specs import Spec, Value, parse_spec, suggest
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.curves.table import CURVE_SCHEMES
from meshfit.subdivision.custom.definitions import Definition, PushBackDefinition
from meshfit.subdivision.custom.formulas import fault
from meshfit.subdivision.masks import CHECKED_VALENCES
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.scheme import Domain, Kind, Parameter, Scheme, SchemeEntry
from meshfit.subdivision.triangles.scheme import PushBack, TriangleScheme
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES

SCHEMES: dict[str, SchemeEntry] = {**TRIANGLE_SCHEMES, **POLYGON_SCHEMES, **CURVE_SCHEMES}


SURFACES: tuple[Domain, ...] = ("triangles", "polygons")
_DOMAINS: dict[type[Scheme], Domain] = {TriangleScheme: "triangles", PolygonScheme: "polygons", CurveScheme: "curves"}

Catalogue = Mapping[str, SchemeEntry]
"""Schemes by name: those of the table alone, or with a user's own beside them."""


def entry_of(name: str, catalogue: Catalogue = SCHEMES) -> SchemeEntry:
    """The entry of that name.

    Raises:
        SchemeError: there is none; the nearest name is suggested.
    """
    if name not in catalogue:
        raise SchemeError(f"'{name}' is not a scheme: {suggest(name, catalogue)}")
    return catalogue[name]


def scheme_of(text: str, catalogue: Catalogue = SCHEMES, /, **overrides: Value | None) -> Scheme:
    """The scheme of a spec, `name` or `name:key=value,…`; parameters given apart take precedence (None: not given).

    Raises:
        SchemeError: no such scheme or parameter, or a value that is not allowed.
    """
    given = {key: value for key, value in overrides.items() if value is not None}
    name, parameters = _resolve(text, catalogue, given)
    return catalogue[name].declare(**parameters)


def declared(scheme: str | Scheme) -> Scheme:
    """The scheme of a spec; a scheme that is declared already is itself.

    Raises:
        SchemeError: as `scheme_of`.
    """
    return scheme_of(scheme) if isinstance(scheme, str) else scheme


def canonical(text: str, catalogue: Catalogue = SCHEMES) -> str:
    """The one way to write a scheme spec: parameters in the entry's order, those at their default left out.

    Raises:
        SchemeError: as `scheme_of`.
    """
    name, parameters = _resolve(text, catalogue, {})
    declared = catalogue[name].parameters
    changed = tuple((key, value) for key, value in parameters.items() if value != declared[key].default)
    return str(Spec(name, changed))


def domain_of(scheme: Scheme) -> Domain:
    """What a scheme refines."""
    return _DOMAINS[type(scheme)]


def schemes_on(*domains: Domain) -> str:
    """The names of the schemes that refine these, as messages list them."""
    return ", ".join(name for name, entry in SCHEMES.items() if entry.domain in domains)


def unfit(scheme: Scheme, domain: Domain) -> SchemeError:
    """The error that a scheme does not refine things of that domain, with the names of those that do."""
    own = domain_of(scheme)
    return SchemeError(f"a scheme on {own} cannot refine {domain}; schemes on {domain}: {schemes_on(domain)}")


def spec_of(text: str) -> Spec:
    """The name and the parameters in a scheme's spec, as they are written.

    Raises:
        SchemeError: it is no spec.
    """
    try:
        return parse_spec(text)
    except ConfigError as error:
        raise SchemeError(f"scheme {error}") from None


def _resolve(text: str, catalogue: Catalogue, overrides: dict[str, Value]) -> tuple[str, dict[str, float | str]]:
    spec = spec_of(text)
    declared = entry_of(spec.name, catalogue).parameters
    given = dict(spec.parameters) | overrides
    for key in given:
        if key not in declared:
            allowed = suggest(key, declared) if declared else "it takes none"
            raise SchemeError(f"scheme '{spec.name}' has no parameter '{key}': {allowed}")
    return spec.name, {
        key: parameter.check(f"{spec.name}: {key}", given.get(key, parameter.default))
        for key, parameter in declared.items()
    }


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
