"""Registry of subdivision schemes: built-in and user-defined ones by name, and the scheme that a spec stands for."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

from pydantic import AfterValidator, Field

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, SchemeError
from meshfit.printable import described
from meshfit.settings import Settings
from meshfit.specs import Spec, Value, parse_spec, suggest
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.curves.table import CURVE_SCHEMES
from meshfit.subdivision.custom.definitions import Definition, PushBackDefinition
from meshfit.subdivision.custom.formulas import error_at
from meshfit.subdivision.masks import CHECKED_VALENCES
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.polygons.table import POLYGON_SCHEMES
from meshfit.subdivision.scheme import Domain, Kind, Parameter, SchemeEntry
from meshfit.subdivision.triangles.scheme import TriangleScheme
from meshfit.subdivision.triangles.table import TRIANGLE_SCHEMES

Scheme = TriangleScheme | PolygonScheme | CurveScheme
"""A scheme on any domain, every parameter fixed."""
Entry = SchemeEntry[Scheme]
Registry = Mapping[str, Entry]
"""Schemes by name."""

SCHEMES: Registry = {**TRIANGLE_SCHEMES, **POLYGON_SCHEMES, **CURVE_SCHEMES}
"""The built-in schemes, in the order in which they are listed."""
SURFACES: tuple[Domain, ...] = ("triangles", "polygons")

_DOMAINS: dict[type[Scheme], Domain] = {TriangleScheme: "triangles", PolygonScheme: "polygons", CurveScheme: "curves"}
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_LONGEST_NAME = 60
_CONTINUITY, _SOURCE = "not known", "your own"


@no_type_check
def resolve(scheme: str | Scheme, registry: Registry = SCHEMES, /, **parameters: Value | None) -> Scheme:
    """Return the scheme that a spec stands for, `name` or `name:key=value,…`.

    Args:
        scheme: a spec; or a declared scheme, which is returned as it is.
        registry: the schemes that the spec may name.
        **parameters: take precedence over those in the spec; None means not given.

    Raises:
        SchemeError: neither a spec nor a scheme, no such scheme or parameter, a value that is not allowed, or
            parameters with a declared scheme.
    """
    given = {key: value for key, value in parameters.items() if value is not None}
    if not isinstance(scheme, str):
        if given:
            raise SchemeError(f"parameter '{next(iter(given))}' goes with a scheme's name, not with a declared scheme")
        if not isinstance(scheme, Scheme):
            raise SchemeError(
                f"scheme: expected the name of a scheme, such as 'loop', or a scheme, got {described(scheme)}"
            )
        return scheme
    name, values = _parameters(scheme, registry, given)
    return registry[name].declare(**values)


def entry_of(name: str, registry: Registry = SCHEMES) -> Entry:
    """Return the entry of that name.

    Raises:
        SchemeError: there is none; the nearest name is suggested.
    """
    if name not in registry:
        raise SchemeError(f"'{name}' is not a scheme: {suggest(name, registry)}")
    return registry[name]


def spec_of(text: str) -> Spec:
    """Split a scheme's spec into name and parameters.

    Raises:
        SchemeError: it is not a spec.
    """
    try:
        return parse_spec(text)
    except ConfigError as error:
        raise SchemeError(f"scheme {error}") from None


def canonical(text: str, registry: Registry = SCHEMES) -> str:
    """Return the canonical spelling of a scheme spec: parameters in the entry's order, defaults left out.

    Raises:
        SchemeError: as `resolve`.
    """
    name, values = _parameters(text, registry, {})
    declared = registry[name].parameters
    return str(Spec(name, tuple((key, value) for key, value in values.items() if value != declared[key].default)))


def _parameters(text: str, registry: Registry, overrides: dict[str, Value]) -> tuple[str, dict[str, float | str]]:
    """Return the name in a spec and the checked value of each of the scheme's parameters."""
    spec = spec_of(text)
    declared = entry_of(spec.name, registry).parameters
    given = dict(spec.parameters) | overrides
    for key in given:
        if key not in declared:
            allowed = suggest(key, declared) if declared else "it takes none"
            raise SchemeError(f"scheme '{spec.name}' has no parameter '{key}': {allowed}")
    return spec.name, {
        key: parameter.check(f"{spec.name}: {key}", given.get(key, parameter.default))
        for key, parameter in declared.items()
    }


def domain_of(scheme: Scheme) -> Domain:
    """Return the domain that a scheme refines."""
    return _DOMAINS[type(scheme)]


def schemes_on(*domains: Domain) -> str:
    """List the names of the built-in schemes on some domains, for messages."""
    return ", ".join(name for name, entry in SCHEMES.items() if entry.domain in domains)


def wrong_domain(scheme: Scheme, domain: Domain) -> SchemeError:
    """Make the error for a scheme that does not refine a domain; it names those that do."""
    own = domain_of(scheme)
    return SchemeError(f"a scheme on {own} cannot refine {domain}; schemes on {domain}: {schemes_on(domain)}")


def _check_name(name: str) -> str:
    """Refuse names that a folder or spec could misread, or that a built-in scheme has."""
    if not _NAME.fullmatch(name):
        raise ValueError("not a scheme name: lower-case letters, digits and single hyphens are allowed, as in my-loop")
    if len(name) > _LONGEST_NAME:
        raise ValueError(f"the name has {len(name)} characters; {_LONGEST_NAME} are allowed")
    if name in SCHEMES:
        raise ValueError("a built-in scheme has this name; choose another")
    return name


def _check_bases(definitions: dict[str, Definition]) -> dict[str, Definition]:
    for name, definition in definitions.items():
        try:
            _entry(name, definition, definitions)
        except SchemeError as error:
            raise error_at((name, "base"), str(error)) from None
    return definitions


Definitions = Annotated[dict[Annotated[str, AfterValidator(_check_name)], Definition], AfterValidator(_check_bases)]
"""User-defined schemes by name."""


class UserSchemes(Settings):
    """User-defined schemes, where there are no other settings."""

    define: Definitions = Field(default_factory=dict)
    """Definitions by name."""


@dataclass(frozen=True, eq=False)
class _ExtendedRegistry(Mapping[str, Entry]):
    """The built-in schemes and some definitions, whose entries are made on demand."""

    definitions: Mapping[str, Definition]

    def __getitem__(self, name: str) -> Entry:
        return SCHEMES[name] if name in SCHEMES else _entry(name, self.definitions[name], self.definitions)

    def __iter__(self) -> Iterator[str]:
        yield from SCHEMES
        yield from self.definitions

    def __len__(self) -> int:
        return len(SCHEMES) + len(self.definitions)


def registry_with(definitions: Mapping[str, Definition]) -> Registry:
    """Return the built-in schemes together with some definitions, none of which has a built-in name."""
    return _ExtendedRegistry(definitions)


@dataclass(frozen=True)
class NamedScheme:
    """A scheme by its spec, with the user's definitions that it depends on; hashable, so that caches can use it as key.

    Attributes:
        spec: the spec.
        own: by name, the scheme's definition and that of its base, where the user has defined them.
    """

    spec: str
    own: tuple[tuple[str, Definition], ...] = ()

    @classmethod
    def of(cls, spec: str, definitions: Mapping[str, Definition]) -> "NamedScheme":
        """Name the scheme of a spec, with what it needs of some definitions."""
        needed: dict[str, Definition] = {}
        name = spec_of(spec).name
        while name in definitions and name not in needed:
            definition = needed[name] = definitions[name]
            if isinstance(definition, PushBackDefinition):
                name = spec_of(definition.base).name
        return cls(spec, tuple(needed.items()))

    def resolve(self) -> Scheme:
        """Return the scheme, every parameter fixed.

        Raises:
            SchemeError: no scheme of that name, or a parameter that is not allowed.
        """
        return resolve(self.spec, registry_with(dict(self.own)))


def _entry(name: str, definition: Definition, definitions: Mapping[str, Definition]) -> Entry:
    kind: Kind
    if not isinstance(definition, PushBackDefinition):
        kind = "interpolatory" if _keeps_old_verts(definition.scheme()) else "approximating"
        declare = partial(definition.scheme, name)
        return Entry(name, "triangles", kind, _CONTINUITY, _SOURCE, declare, {})
    base, entry = _base(name, definition.base, definitions)
    kind = "interpolatory" if definition.alpha == 1 else entry.kind
    alpha = Parameter(definition.alpha, (0.0, 1.0), f"from {definition.base} (0) to interpolatory (1)")
    source = f"{_SOURCE}, a push-back of {definition.base}"
    return Entry(name, entry.domain, kind, _CONTINUITY, source, partial(_pushed_back, base), {"alpha": alpha})


def _base(name: str, base: str, definitions: Mapping[str, Definition]) -> tuple[Scheme, Entry]:
    """Return the scheme that is pushed back, and its entry."""
    base_name = spec_of(base).name
    registry = SCHEMES
    if base_name in definitions:
        if isinstance(definitions[base_name], PushBackDefinition):
            fault = "the definition itself" if base_name == name else "a push-back too"
            raise SchemeError(f"'{base}' is {fault}; expected a scheme defined by masks alone")
        registry = {**SCHEMES, base_name: _entry(base_name, definitions[base_name], definitions)}
    scheme, entry = resolve(base, registry), entry_of(base_name, registry)
    if scheme.alpha is not None:
        raise SchemeError(f"'{base}' is pushed back already; expected a scheme defined by masks alone")
    return scheme, entry


def _pushed_back(base: Scheme, alpha: float) -> Scheme:
    return replace(base, alpha=alpha)


def _keeps_old_verts(scheme: TriangleScheme) -> bool:
    inner = scheme.vert is None or not any(scheme.vert.ring(valence) for valence in CHECKED_VALENCES)
    return inner and {offset for offset, weight in scheme.boundary.vert.items() if weight} == {0}
