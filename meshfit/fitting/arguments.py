"""Checks of the values that `fit` and `fit_batch` are given."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, MeshError, MeshfitWarning
from meshfit.fitting.settings import METHODS, FitSettings
from meshfit.mesh.cleaning import outward
from meshfit.mesh.cleaning_options import as_keep
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud, no_closed_surface
from meshfit.mesh.separate_pieces import describe_floaters, kept_pieces
from meshfit.printable import option_text, value_text
from meshfit.settings import Settings, build, override
from meshfit.specs import suggest


@no_type_check
def settings_of(settings: FitSettings | None, overrides: Mapping[str, Any]) -> FitSettings:
    """Return settings with some keys replaced, checked; those of a method's defaults if none are given.

    Raises:
        ConfigError: a key or a value is not allowed.
    """
    changes = {key: _plain(value) for key, value in overrides.items() if value is not None}
    if settings is not None and not isinstance(settings, tuple(METHODS.values())):
        names = "FirstOrderSettings, GaussNewtonSettings or ExternalSettings"
        raise ConfigError(f"settings: expected {names}, got {value_text(settings)}")
    method = changes.get("method", "first-order" if settings is None else settings.method)
    if not isinstance(method, str) or method not in METHODS:
        raise ConfigError(f"method: got {option_text(method)}; {suggest(str(method), METHODS)}")
    _require_keys(changes, method)
    if settings is None or settings.method != method:
        return build(METHODS[method], changes)
    return override(settings, changes)


def _plain(value: Any) -> Any:  # noqa: ANN401  any value of a setting
    return value.model_dump() if isinstance(value, Settings) else value


def _require_keys(changes: Mapping[str, Any], method: str) -> None:
    """Refuse keys that only the other engine has, and name it."""
    allowed = METHODS[method].model_fields
    for key in changes:
        engine = next((name for name, model in METHODS.items() if key in model.model_fields), None)
        if key not in allowed and engine is not None:
            text = f"no such key: it is one of method='{engine}', and this is '{method}'"
            raise ConfigError(f"{key}: {text}; allowed: {', '.join(allowed)}")


@no_type_check
def require_one_of(key: str, value: str, allowed: Sequence[str]) -> Any:  # noqa: ANN401  one of several literals
    """Return an option, and refuse one that is not allowed."""
    if not isinstance(value, str) or value not in allowed:
        raise ConfigError(f"{key}: got {option_text(value)}; {suggest(str(value), allowed)}")
    return value


@no_type_check
def require_whole(key: str, value: int, least: int) -> None:
    """Refuse what is not a whole number, or one that is too small."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ConfigError(f"{key}: expected a whole number of at least {least}, got {value_text(value)}")


def require_surface(mesh: Mesh | PointCloud, name: str) -> None:
    """Refuse a mesh without area, and coordinates that are not finite."""
    finite = np.isfinite(mesh.verts).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: vertex {int(np.flatnonzero(~finite)[0])} has a coordinate that is not finite")
    if isinstance(mesh, PointCloud):
        return
    if not mesh.num_faces or not face_areas(mesh).sum() > 0:
        raise MeshError(f"{name}: the mesh has no area")


@no_type_check
def require_closable(target: Mesh | PointCloud, *, own: bool) -> None:
    """Refuse points without a closed surface, unless a source of the caller's own may be open."""
    if isinstance(target, PointCloud) and not own and (fault := no_closed_surface(target)):
        raise MeshError(f"target: {fault}")


@no_type_check
def with_pieces(
    target: Mesh | PointCloud, keep: Literal["all", "largest"] | float | None, *, has_images: bool
) -> Mesh | PointCloud:
    """Return a target, turned outwards if pieces are left out, with the pieces that are kept.

    Raises:
        ConfigError: an option that is not allowed, or images.

    Warns:
        MeshfitWarning: small pieces are far off the others, and are not left out.
    """
    try:
        chosen = as_keep(keep)
    except ValueError:
        allowed = "'all', 'largest', or a share above 0 and up to 1"
        raise ConfigError(f"keep: expected {allowed}, got {value_text(keep)}") from None
    if chosen is None:
        if not has_images and (floaters := describe_floaters(target)):
            text = f"target: {floaters} draw the fit to them; set keep='largest' if they are no part of the shape"
            warnings.warn(text, MeshfitWarning, stacklevel=3)
        return target
    if has_images:
        raise ConfigError("keep: images have no pieces to choose from before the fit; remove it")
    turned = outward(target)
    parts = kept_pieces(turned, chosen)
    return target if parts is turned else parts
