"""The user's own schemes in results: told apart where one name stands for several, and found by their specs."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from meshfit.config.scheme_files import without_path
from meshfit.experiment.store import Result
from meshfit.report.gather import flat
from meshfit.report.variations import shown, variation_names
from meshfit.settings import build
from meshfit.subdivision.catalogue import OwnSchemes, catalogue_of
from meshfit.subdivision.choose import canonical, spec_of
from meshfit.subdivision.table import SCHEMES


def told_apart(results: Sequence[Result]) -> list[Result]:
    """Results, with what tells definitions apart added to a scheme's name: `mine [edge.end=3/8]`.

    Only where some results have one definition under a name and others another: a definition that was changed between
    two runs, or that is swept.
    """
    forms: dict[str, dict[str, Mapping[str, Any]]] = {}
    for result in results:
        own = _definitions(result)
        forms.setdefault(_name(result), {})[_text(own)] = own
    added = {name: _differences(name, list(some.values())) for name, some in forms.items() if len(some) > 1}
    return [_renamed(result, added.get(_name(result), {})) for result in results]


def canonical_among(results: Sequence[Mapping[str, Any]], text: str) -> str:
    """A scheme as results have it: their own word for it, or the canonical form of a spec of theirs or of the table.

    Raises:
        SchemeError: it is no scheme.
        ConfigError: it is one that a result defines in a way that is not understood.
    """
    text = without_path(text)
    if any(result["scheme"] == text for result in results):
        return text
    if spec_of(text).name in SCHEMES:
        return canonical(text)
    define = {name: one for result in results for name, one in _definitions(result).items()}
    return canonical(text, catalogue_of(build(OwnSchemes, {"define": define}).define))


def definitions_of(results: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """What the user's own schemes among some results are, in a line for each of them as results call it."""
    found: dict[str, str] = {}
    for result in results:
        if result["scheme"] not in found and (own := _definitions(result)):
            entries = {key: one for key, one in _in_order(_name(result), own).items() if one is not None}
            found[result["scheme"]] = "; ".join(f"{key}: {_in_words(one)}" for key, one in entries.items())
    return found


def _in_words(value: object) -> str:
    return f"[{', '.join(map(shown, value))}]" if isinstance(value, list) else shown(value)


def _name(result: Mapping[str, Any]) -> str:
    """Of its scheme, whatever it has been called since."""
    return _spec(result).partition(":")[0]


def _spec(result: Mapping[str, Any]) -> str:
    return str(result["settings"].get("schemes", [result["scheme"]])[0])


def _definitions(result: Mapping[str, Any]) -> Mapping[str, Any]:
    found = result["settings"].get("define", {})
    return found if isinstance(found, Mapping) else {}


def _text(own: Mapping[str, Any]) -> str:
    return json.dumps(own, sort_keys=True)


def _differences(name: str, forms: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """What is added to the name of a scheme, by the text of its definitions."""
    names = variation_names([_in_order(name, own) for own in forms], [""] * len(forms))
    return {_text(own): f" [{told}]" if told else "" for own, told in zip(forms, names, strict=True)}


def _in_order(name: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """A scheme's own entries by dotted key, and those of its base, with the base's name before them."""
    return flat(own.get(name, {})) | flat({key: one for key, one in own.items() if key != name})


def _renamed(result: Result, added: Mapping[str, str]) -> Result:
    if not added:
        return result
    return {**result, "scheme": _spec(result) + added[_text(_definitions(result))]}
