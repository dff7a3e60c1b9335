"""Which settings are not at their defaults."""

from collections.abc import Mapping
from typing import Any

from meshfit.config.experiment import ExperimentSettings
from meshfit.fitting.settings import METHODS
from meshfit.settings import TAG

_WITHOUT_EFFECT = {"jobs", "threads"}


def defaults(method: str = "first-order") -> dict[str, Any]:
    """Every setting that a result may depend on, at its default, as plain data.

    Args:
        method: the engine that the settings of the fit are for.
    """
    plain = ExperimentSettings().model_dump(mode="json", exclude=_WITHOUT_EFFECT)
    fit = METHODS.get(method)
    return plain | ({"fit": fit().model_dump(mode="json")} if fit else {})


def changed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of some settings, as plain data, that are not at their defaults, in the order that they come in."""
    fit = settings.get("fit")
    method = fit.get(TAG, "first-order") if isinstance(fit, Mapping) else "first-order"
    found = _difference(settings, defaults(method))
    if method != "first-order" and "fit" in settings:
        found["fit"] = {TAG: method} | found.get("fit", {})
    return found


def _difference(settings: Mapping[str, Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in settings.items():
        default = usual.get(key)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            if inner := _difference(value, default):
                found[key] = inner
        elif key not in usual or value != default:
            found[key] = value
    return found
