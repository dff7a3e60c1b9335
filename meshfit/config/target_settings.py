"""Settings of targets, and targets as configs name them."""

import json
import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    WithJsonSchema,
    field_validator,
)

from meshfit.errors import ViewError
from meshfit.images.specs import image_spec, spec_of_mapping
from meshfit.mesh.cleaning_options import Keep, Surface, as_keep
from meshfit.settings import Settings

TRUTH_KEY = ("target", "truth")
"""The setting that is the path of a file, or a pattern of paths."""


def _canonical_target(value: Any) -> Any:  # noqa: ANN401  any YAML value
    """Return the text of a target of images that is given as a mapping, or as a text in other words."""
    try:
        if isinstance(value, Mapping):
            return str(spec_of_mapping(value))
        if isinstance(value, str) and value.startswith(("views:", "images:")):
            return str(image_spec(value))
    except ViewError as error:
        raise ValueError(str(error)) from None
    return value


def _canonical_keep(value: Any) -> Any:  # noqa: ANN401  any YAML value
    """Return the pieces to keep, with null for all."""
    try:
        return as_keep(value)
    except ValueError:
        got = json.dumps(value, default=str)
    raise ValueError(f"expected all, largest, or a share above 0 and up to 1, got {got}")


_VIEW_KEYS: dict[str, Any] = {
    "of": {"type": "string"},
    "count": {"type": "integer", "minimum": 1},
    "size": {"type": "integer", "minimum": 8},
    "kind": {"enum": ["pinhole", "orthographic"]},
    "depth": {"type": "boolean"},
    "normals": {"type": "boolean"},
    "hold_out": {"type": "integer", "minimum": 0},
}
_IMAGE_KEYS: dict[str, Any] = {
    **{key: {"type": "string"} for key in ("images", "cameras", "truth")},
    **{key: _VIEW_KEYS[key] for key in ("depth", "normals", "hold_out")},
}


def _mapping_schema(properties: dict[str, Any], required: str) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": [required], "additionalProperties": False}


_TARGET_SCHEMA = {
    "anyOf": [
        {"type": "string"},
        _mapping_schema({"views": _mapping_schema(_VIEW_KEYS, "of")}, "views"),
        _mapping_schema(_IMAGE_KEYS, "images"),
    ]
}
_KEEP_SCHEMA = {
    "anyOf": [
        {"enum": ["all", "largest", None]},
        {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
    ]
}
Target = Annotated[str, BeforeValidator(_canonical_target), WithJsonSchema(_TARGET_SCHEMA)]


class TargetSettings(Settings):
    """Knowledge of the targets besides their files, and the part of them that counts."""

    surface: Surface = "all"
    """Part of a target's surface that is fitted to and measured from: `all`, or what can be seen of it from outside,
    `outer`: then parts that lie inside others are left out, and a source made from the target is one skin."""
    keep: Annotated[Keep, BeforeValidator(_canonical_keep), WithJsonSchema(_KEEP_SCHEMA)] = None
    """Pieces of a target that are fitted to and measured from: `all` or null; `largest`, that of the largest area;
    or a share (above 0, up to 1) for those of at least this share of it. Parts nearer to each other than 1 % of the
    extent are one piece, in meshes, soups and clouds. The frame is that of the pieces that are kept."""
    sensor: tuple[float, float, float] | None = None
    """Position that a scan was taken from, in the coordinates and the unit of the target's file, towards which the
    normals of its points are oriented where the file has none; null orients them from neighbour to neighbour, outwards.
    Targets must be clouds of points."""
    landmarks: str | None = None
    """File of places on the target whose names `source.landmarks` has too, in the coordinates of the target's file; in
    its name, `{target}` stands for that of the trial's target, as in `landmarks/{target}.csv`; null if the file of the
    source has pairs."""
    truth: str | None = None
    """File with the places where the vertices of the source belong, for `vertex_error`, in the coordinates of the
    target's file: a mesh, or points, with as many vertices as the file of the source, its control mesh, or the refined
    source. In its name, `{target}` and `{scheme}` stand for those of a trial, as in `truth/{target}.ply`; null means
    that none are known."""

    @field_validator("truth")
    @classmethod
    def _known_placeholders(cls, value: str | None) -> str | None:
        for name in re.findall(r"\{([^{}]*)\}", value or ""):
            if name not in ("target", "scheme"):
                raise ValueError(f"{{{name}}} stands for nothing; allowed: {{target}}, {{scheme}}")
        return value
