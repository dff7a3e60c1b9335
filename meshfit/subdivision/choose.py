"""From what a user writes, `interp-loop:alpha=0.5`, to a scheme, and to the one canonical way of writing it."""

from collections.abc import Mapping

from meshfit.errors import ConfigError, SchemeError
from meshfit.specs import Spec, Value, parse_spec, suggest
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.polygon_scheme import PolygonScheme
from meshfit.subdivision.scheme import Domain, Scheme, SchemeEntry
from meshfit.subdivision.table import SCHEMES
from meshfit.subdivision.triangle_scheme import TriangleScheme

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
