"""The settings of an experiment: targets × schemes × seeds over one set of everything else."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from meshfit.errors import SchemeError
from meshfit.fitting.settings import METHODS, Dtype, FirstOrderSettings, FitSettings
from meshfit.measuring.settings import MeasureSettings
from meshfit.settings import KIND_KEY, Settings
from meshfit.subdivision.registry import SURFACES, Definitions, canonical, entry_of, registry_with, schemes_on, spec_of


def _unique(values: tuple[object, ...]) -> tuple[object, ...]:
    twice = {value for value in values if values.count(value) > 1}
    if twice:
        raise ValueError(f"{sorted(map(str, twice))[0]} is listed twice; once is enough")
    return values


def _count(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:  # noqa: ANN401  whatever was written
    """One message in place of one for each of the two that are allowed."""
    try:
        return validate(value)
    except ValidationError:
        raise ValueError(f"found {json.dumps(value, default=str)}; auto or an integer from 1 on is needed") from None


def _canonical_scheme(text: str, info: ValidationInfo) -> str:
    """Checked after `define`, which stands before `schemes` for that reason; where it is at fault, that is told."""
    if "define" not in info.data:
        return text
    registry = registry_with(info.data["define"])
    try:
        spec = canonical(text, registry)
    except SchemeError as error:
        raise ValueError(str(error)) from None
    if entry_of(spec_of(spec).name, registry).domain == "curves":
        raise ValueError(f"{spec} refines curves, and experiments fit surfaces: allowed: {schemes_on(*SURFACES)}")
    return spec


SchemeSpec = Annotated[str, AfterValidator(_canonical_scheme)]
Count = Annotated[Literal["auto"] | Annotated[int, Field(ge=1)], WrapValidator(_count)]
# What says how the work is done, or is spent when the trials are planned, and moves no number.
NO_EFFECT_ON_RESULTS: dict[str, Any] = {
    **dict.fromkeys(("jobs", "threads", "retries", "sweep"), True),
    "fit": {"snapshots"},
}

# Settings of the source that may be the paths of files.
SOURCE_FILE_KEYS = (("source", "mesh"), ("source", "creases", "file"), ("source", "alpha", "file"))

MAX_LEVELS = 8
"""Levels of subdivision that a source may have."""

Listed = (Field(min_length=1), AfterValidator(_unique))


_OWN_SCHEMES = {
    "my-loop": {
        "edge": {"end": "3/8", "opposite": "1/8"},
        "vertex": "5/8 - (3/8 + cos(2*pi/n)/4)^2",
        "boundary": "cubic-bspline",
    },
    "softer": {"base": "my-loop", "alpha": 0.5},
}


class CreaseSettings(Settings):
    """Where the control mesh is creased: by angle, or as a file lists it."""

    angle: Annotated[float, Field(gt=0, le=180)] | None = None
    """Edges are sharp whose faces make more than so many degrees."""
    file: str | None = None
    """A text file, relative to this one, with a line each: `a b` or `a b sharpness` for an edge, `a` for a corner.
    Verts are counted from 0 as the file of the control mesh has them."""
    sharpness: Annotated[float, Field(ge=0)] | None = None
    """Levels that edges stay sharp for, such as 1.5, where the file has no other number; null for ever."""

    @model_validator(mode="after")
    def _one_way(self) -> "CreaseSettings":
        if (self.angle is None) == (self.file is None):
            raise ValueError(f"found {'neither' if self.file is None else 'both'}; either angle or file is needed")
        return self


class AlphaSettings(Settings):
    """Where each vertex of the control mesh has its alpha from."""

    file: str | None = None
    """A text file, relative to this one, with a number a line for each vertex of the control mesh's file."""
    attribute: str | None = None
    """A property of the verts of the control mesh's file, a PLY."""

    @model_validator(mode="after")
    def _one_way(self) -> "AlphaSettings":
        if (self.attribute is None) == (self.file is None):
            raise ValueError(f"found {'neither' if self.file is None else 'both'}; either file or attribute is needed")
        return self


class SourceSettings(Settings):
    """The source: a control mesh, and what is done to it before the fit. The scheme refines it."""

    mesh: str = "icosahedron"
    """The control mesh: `icosahedron`, `octahedron`, `tetrahedron`, `cube`, `icosphere` or `icosphere:level=N`,
    the name of a target, or the path of a mesh file."""
    decimate: Annotated[int, Field(ge=4)] | None = None
    """Reduce the control mesh to about so many faces first; null leaves it as it is."""
    levels: Annotated[int, Field(ge=0, le=MAX_LEVELS)] = 4
    """Levels of subdivision by the scheme."""
    wanted_verts: Annotated[int, Field(ge=4)] | None = None
    """In place of `levels`: as many as bring the number of verts nearest to this, so that schemes that make more verts
    of one at a level than others do can be compared; null leaves it to `levels`."""
    radius: Annotated[float, Field(gt=0)] | None = 1.0
    """Scale the control mesh so that its farthest vertex is this far from its centre; null keeps its size."""
    centre: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    """Where to put the mean of the control mesh's verts, in the normalised frame; null keeps its place."""
    align: Literal["none", "center", "pca", "icp"] = "none"
    """How it is then placed on the target: `none`; `center`, centroid on centroid; `pca`, principal axes and size as
    well; `icp`, by nearest points after that."""
    project: Literal["none", "sphere"] = "none"
    """`sphere` puts the verts of the control mesh and of each level on the sphere about its centre."""
    creases: CreaseSettings | None = None
    """Edges of the control mesh that stay sharp under loop, interp-loop and midpoint: `{angle: DEGREES}` or
    `{file: PATH}`, each with a `sharpness` if it is to wear off; null for boundaries alone."""
    alpha: AlphaSettings | None = None
    """An alpha for each vertex of the control mesh, in place of the schemes' own: `{file: PATH}` or
    `{attribute: NAME}`; null for none."""


class ExperimentSettings(Settings):
    """An experiment: every target with every scheme and every seed."""

    targets: Annotated[tuple[str, ...], *Listed] = ("bunny", "mousehead")
    """Named targets (see `meshfit targets`) or paths of mesh files, relative to this file."""
    define: Annotated[Definitions, Field(examples=[_OWN_SCHEMES])] = Field(default_factory=dict)
    """Schemes of your own by name, which `schemes` may then list: by their masks, or as a push-back of another scheme
    towards interpolation."""
    schemes: Annotated[tuple[SchemeSpec, ...], *Listed] = ("loop", "interp-loop")
    """Subdivision schemes (see `meshfit schemes`), with parameters as in `interp-loop:alpha=0.5`; names in `define`, or
    paths of files that hold such a definition, relative to this file."""
    seeds: Annotated[tuple[Annotated[int, Field(ge=0, lt=2**32)], ...], *Listed] = (0,)
    """Seeds of the samples; table cells are means over them."""
    normalise: Literal["tutorial", "box", "none"] = "tutorial"
    """Frame of all lengths. `tutorial`: target's mean at 0, largest |coordinate| 1. `box`: box centred, diagonal 1."""
    write_frame: Literal["normalised", "target"] = "normalised"
    """Frame that `source.ply` and `result.ply` are written in: the normalised one, or the target file's own."""
    source: SourceSettings = SourceSettings()
    """The source: a control mesh, and what is done to it before the fit."""
    fit: FitSettings = FirstOrderSettings()
    """What is minimised, how, and for how long."""
    measure: MeasureSettings = MeasureSettings()
    """How results are measured."""
    device: str = "auto"
    """`auto` (CUDA where there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or `mps`."""
    dtype: Dtype = "float32"
    """Precision of the fit."""
    jobs: Count = "auto"
    """Trials side by side on the CPU; `auto`: one for each core. Results do not depend on it."""
    retries: Annotated[int, Field(ge=0, le=10)] = 1
    """How often a trial is run once more, alone, after its process was killed or memory ran out. Other failures would
    only come again."""
    threads: Count = "auto"
    """Threads to search nearest points with in each trial on the CPU; `auto`: two where cores are left over, else one.
    Results do not depend on it."""
    sweep: dict[str, Any] = Field(default_factory=dict)
    """Settings to vary, each combination a row of the table: `fit.losses.edge: [0.1, 1.0]` for a grid; under `zip`,
    lists that go in step; under `variants`, names with the settings that each of them changes."""

    @model_validator(mode="after")
    def _refined_once(self) -> "ExperimentSettings":
        for key in ("creases", "alpha"):
            if getattr(self.source, key) is not None and self.fit.method != "first-order":
                raise ValueError(
                    f"source.{key}: for fit.method first-order; found {self.fit.method}, whose own levels know of none"
                )
        return self

    def __hash__(self) -> int:
        """Of its JSON text: a sweep is plain data, which has no hash."""
        return hash(self.model_dump_json())


_WITHOUT_EFFECT = {"jobs", "threads"}


def default_settings(method: str = "first-order") -> dict[str, Any]:
    """Every setting that a result may depend on, at its default, as plain data.

    Args:
        method: the engine that the settings of the fit are for.
    """
    plain = ExperimentSettings().model_dump(mode="json", exclude=_WITHOUT_EFFECT)
    fit = METHODS.get(method)
    return plain | ({"fit": fit().model_dump(mode="json")} if fit else {})


def non_default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of some settings, as plain data, that are not at their defaults, in the order that they come in."""
    fit = settings.get("fit")
    method = fit.get(KIND_KEY, "first-order") if isinstance(fit, Mapping) else "first-order"
    found = _difference(settings, default_settings(method))
    if method != "first-order" and "fit" in settings:
        found["fit"] = {KIND_KEY: method} | found.get("fit", {})
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
