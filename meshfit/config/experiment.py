"""The settings of an experiment: every target with every scheme and every seed, all else equal."""

import json
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from meshfit.config.source_settings import SourceSettings
from meshfit.config.target_settings import Target, TargetSettings
from meshfit.errors import SchemeError
from meshfit.fitting.settings import METHODS, Dtype, FirstOrderSettings, FitSettings, default_fit
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.cleaning_options import CleaningOptions, Repair
from meshfit.mesh.placing_options import Normalisation
from meshfit.settings import DEFAULT_KIND, KIND_KEY, Settings
from meshfit.subdivision.registry import SURFACES, Definitions, canonical, entry_of, registry_with, schemes_on, spec_of

NO_EFFECT_ON_RESULTS: dict[str, Any] = {
    **dict.fromkeys(("write_frame", "view", "jobs", "threads", "retries", "sweep"), True),
    "fit": {"snapshots", "time_limit", "memory_limit"},
}
"""Settings that control only how trials are run or written, or that are resolved when trials are planned."""
_OWN_SCHEMES = {
    "my-loop": {
        "edge": {"end": "3/8", "opposite": "1/8"},
        "vertex": "5/8 - (3/8 + cos(2*pi/n)/4)^2",
        "boundary": "cubic-bspline",
    },
    "softer": {"base": "my-loop", "alpha": 0.5},
}


def _unique(values: tuple[object, ...]) -> tuple[object, ...]:
    counts = Counter(values)
    if len(counts) < len(values):
        raise ValueError(f"duplicate entry {min(str(value) for value, count in counts.items() if count > 1)}")
    return values


def _auto_or_count(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:  # noqa: ANN401  any YAML value
    """Report one error in place of one for each of the two types."""
    try:
        return validate(value)
    except ValidationError:
        raise ValueError(f"expected auto or an integer of 1 or more, got {json.dumps(value, default=str)}") from None


def _canonical_scheme(text: str, info: ValidationInfo) -> str:
    """Check a scheme against those of `define`, which is validated first; skip the check if that one failed."""
    if "define" not in info.data:
        return text
    registry = registry_with(info.data["define"])
    try:
        spec = canonical(text, registry)
    except SchemeError as error:
        raise ValueError(str(error)) from None
    if entry_of(spec_of(spec).name, registry).domain == "curves":
        raise ValueError(f"{spec} refines curves, and experiments fit surfaces; allowed: {schemes_on(*SURFACES)}")
    return spec


SchemeSpec = Annotated[str, AfterValidator(_canonical_scheme)]
Count = Annotated[Literal["auto"] | Annotated[int, Field(ge=1)], WrapValidator(_auto_or_count)]
NonEmptyUnique = (Field(min_length=1), AfterValidator(_unique))


class ViewSettings(Settings):
    """The view of pictures."""

    up: Literal["auto", "x", "y", "z"] = "auto"
    """Axis that points up in pictures: `x`, `y` or `z`; `auto` takes z where a target stands on a base along z, else y.
    Without effect on results; the next `meshfit run` brings it to the pictures of complete trials."""


class ExperimentSettings(Settings):
    """An experiment: every target with every scheme and every seed."""

    # Top-level keys of a config that begin with "x-" hold values for YAML aliases.
    model_config = ConfigDict(json_schema_extra={"patternProperties": {"^x-": {}}})

    targets: Annotated[tuple[Target, ...], *NonEmptyUnique] = ("bunny", "mousehead")
    """Named targets (see `meshfit targets`) or paths of files of meshes or points, relative to this file. Points (PLY,
    OBJ, XYZ, PTS, PCD, LAS and the like without faces) need `fit.method: gauss-newton`. Images: a folder with cameras
    (`transforms.json`, or COLMAP's text files), `{images: FOLDER, cameras: FILE}` with an optional `truth: MESH`, or
    `{views: {of: bunny, count: 12}}`, rendered from cameras around a mesh with optional `size`, `kind`, `depth` and
    `normals`; `hold_out` keeps that many views aside for the mask IoU."""
    target: TargetSettings = TargetSettings()
    """Knowledge of the targets besides their files, and the part of them that counts."""
    define: Annotated[Definitions, Field(examples=[_OWN_SCHEMES])] = Field(default_factory=dict)
    """Your own schemes by name, for `schemes` to list: defined by their masks, or as a push-back of another scheme
    towards interpolation."""
    schemes: Annotated[tuple[SchemeSpec, ...], *NonEmptyUnique] = ("loop", "interp-loop")
    """Subdivision schemes (see `meshfit schemes`), with parameters as in `interp-loop:alpha=0.5`; names in `define`, or
    paths of files with such a definition, relative to this file."""
    seeds: Annotated[tuple[Annotated[int, Field(ge=0, lt=2**32)], ...], *NonEmptyUnique] = (0,)
    """Seeds of the samples, from 0 to 4294967295; table cells are means over them."""
    normalise: Normalisation = "tutorial"
    """Frame of all lengths: `tutorial` puts the target's mean at 0 and its largest |coordinate| at 1, `sphere` its mean
    at 0 and its farthest vertex at distance 1; `box` puts its bounding box's centre at 0 and diagonal at 1, `cube` its
    centre at 0 and longest side at 1; `none` keeps its coordinates."""
    weld: Annotated[float, Field(gt=0)] | None = None
    """Distance, in the unit of the target's file, up to which boundary vertices are joined; null joins equal positions
    only."""
    repair: Repair = "split"
    """Treatment of vertices and edges where the mesh is not manifold: `split` separates the faces; `refuse` leaves
    them, so that subdivision and the Gauss–Newton engine refuse the mesh."""
    write_frame: Literal["target", "normalised"] = "target"
    """Frame of `result.ply` and the other meshes of a trial, without effect on numbers: `target` is the target file's
    own, with its unit; `normalised` is that of all lengths. `meshfit save` converts from one to the other."""
    source: SourceSettings = SourceSettings()
    """The source: a control mesh, its preparation, and its refinement by the scheme."""
    fit: FitSettings = FirstOrderSettings()
    """The fit: its engine, losses and length."""
    measure: MeasureSettings = MeasureSettings()
    """The measurement of results."""
    view: ViewSettings = ViewSettings()
    """The view of pictures."""
    device: str = "auto"
    """Device of the fit: `auto` (CUDA if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or `mps`."""
    dtype: Dtype = "float32"
    """Floating-point precision of the fit."""
    jobs: Count = "auto"
    """Number of trials to run at once on the CPU, without effect on results; `auto` means one per core."""
    retries: Annotated[int, Field(ge=0, le=10)] = 1
    """Number of times, from 0 to 10, that a trial is repeated alone after its process was killed or memory ran out;
    other failures are not repeated."""
    threads: Count = "auto"
    """Number of threads for nearest-neighbour search in each trial on the CPU, without effect on results; `auto` means
    two if there are spare cores, else one."""
    sweep: dict[str, Any] = Field(default_factory=dict)
    """Settings to vary, one table row per combination: `fit.losses.edge: [0.1, 1.0]` for a grid, lists under `zip` to
    vary in step, names under `variants` with the settings that each changes, and `sample: {points: 200}` with `ranges`
    for points spread over ranges."""

    @classmethod
    def with_dependent_defaults(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return plain data with the defaults of the source that depend on its mesh."""
        source = data.get("source")
        if not isinstance(source, Mapping):
            return data
        return {**data, "source": SourceSettings.with_dependent_defaults(source)}

    @property
    def cleaning(self) -> CleaningOptions:
        """The options for cleaning the targets' files."""
        return CleaningOptions(self.weld or 0.0, self.repair)

    @model_validator(mode="after")
    def _creases_and_alpha_need_first_order(self) -> "ExperimentSettings":
        for key in ("creases", "alpha"):
            if getattr(self.source, key) is not None and self.fit.method != "first-order":
                raise ValueError(
                    f"source.{key}: {self.fit.method} fits without {key}; set fit.method: first-order, or remove it"
                )
        return self

    @model_validator(mode="after")
    def _guidance_needs_a_registration(self) -> "ExperimentSettings":
        source = self.source
        if self.target.landmarks is not None and source.landmarks is None:
            raise ValueError("target.landmarks: source.landmarks has the places on the source; set it, too")
        given = [key for key in ("landmarks", "weights", "fixed", "rigid") if getattr(source, key) is not None]
        if given and source.is_made_from_target:
            raise ValueError(
                f"source.{given[0]}: the source is made from the target ({source.mesh}), and no vertex of it is known "
                "before; set source.mesh to a file"
            )
        if source.landmarks is not None and source.landmarks.hold_out == 1:
            given.remove("landmarks")
        if given and getattr(self.fit, "prior", None) is None:
            alone = ", or source.landmarks.hold_out: 1 to measure alone" if given[0] == "landmarks" else ""
            raise ValueError(
                f"source.{given[0]}: only a registration uses it; set fit.method: gauss-newton, fit.connectivity: "
                f"fixed and fit.register: near-rigid{alone}"
            )
        return self

    def __hash__(self) -> int:
        """Hash the JSON text, since a sweep is plain data, which has no hash."""
        return hash(self.model_dump_json())


def canonical_key(key: str) -> str:
    """Return a dotted key in the spelling under which it is stored."""
    return "source.centre" if key == "source.center" else key


def with_canonical_keys(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested settings with their keys in the spelling under which they are stored."""
    source = data.get("source")
    if not isinstance(source, Mapping) or "center" not in source or "centre" in source:
        return dict(data)
    return {**data, "source": {"centre" if key == "center" else key: value for key, value in source.items()}}


def default_settings(method: str = "first-order") -> dict[str, Any]:
    """Return the default of every setting that may affect results, as plain data.

    Args:
        method: the engine of the fit.
    """
    plain = ExperimentSettings().model_dump(mode="json", exclude={"jobs", "threads", "view"})
    return plain | ({"fit": default_fit(method)} if method in METHODS else {})


def non_default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings, given as plain data, that differ from their defaults; the order is kept."""
    fit = settings.get("fit")
    method = fit.get(KIND_KEY, DEFAULT_KIND) if isinstance(fit, Mapping) else DEFAULT_KIND
    result = _difference(settings, default_settings(method))
    if method != DEFAULT_KIND and "fit" in settings:
        result["fit"] = {KIND_KEY: method} | result.get("fit", {})
    return result


def _difference(settings: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in settings.items():
        default = defaults.get(key)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            if inner := _difference(value, default):
                result[key] = inner
        elif key not in defaults or value != default:
            result[key] = value
    return result
