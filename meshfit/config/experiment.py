"""The settings of an experiment: every target with every scheme and every seed, all else equal."""

import json
import re
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    field_validator,
    model_validator,
)

from meshfit.errors import SchemeError, ViewError
from meshfit.fitting.settings import METHODS, Dtype, FirstOrderSettings, FitSettings, default_fit
from meshfit.images.specs import image_spec, spec_of_mapping
from meshfit.measuring.settings import MeasureSettings
from meshfit.mesh.cleaning_options import CleaningOptions, Keep, Repair, Surface
from meshfit.mesh.placing_options import Alignment, Normalisation
from meshfit.settings import DEFAULT_KIND, KIND_KEY, Settings
from meshfit.subdivision.registry import SURFACES, Definitions, canonical, entry_of, registry_with, schemes_on, spec_of

MAX_LEVELS = 8
"""The most subdivision levels that a source may have."""
KEYS_WITH_FILES = ("creases", "alpha", "landmarks", "weights", "fixed", "rigid")
"""Groups of settings of the source that may name a `file`."""
SOURCE_FILE_KEYS = (("source", "mesh"), ("source", "landmarks"), *(("source", key, "file") for key in KEYS_WITH_FILES))
"""Settings of the source that may be paths of files."""
TRUTH_KEY = ("target", "truth")
"""The setting that is the path of a file, or a pattern of paths."""
MADE_FROM_TARGET = ("target", "closed", "open", "wrap", "hull", "auto")
"""Values of `source.mesh` that stand for control meshes made from the trial's target."""
_OF_TARGET = {"levels": 0, "wanted_verts": 2562, "radius": None, "centre": None}
_SOURCE_DEFAULTS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(MADE_FROM_TARGET, _OF_TARGET),
    "sphere": {"levels": 3, "radius": 0.3, "project": "sphere"},
}
"""Defaults of the source's other settings that depend on its mesh."""
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
    if value in ("all", None):
        return None
    if value == "largest" or (isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= 1):
        return value
    raise ValueError(f"expected all, largest, or a share above 0 and up to 1, got {json.dumps(value, default=str)}")


def _require_one(settings: Settings, first: str, second: str) -> None:
    given = [name for name in (first, second) if getattr(settings, name) is not None]
    if len(given) != 1:
        raise ValueError(f"expected either {first} or {second}, got {'both' if given else 'neither'}")


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
SchemeSpec = Annotated[str, AfterValidator(_canonical_scheme)]
Count = Annotated[Literal["auto"] | Annotated[int, Field(ge=1)], WrapValidator(_auto_or_count)]
NonEmptyUnique = (Field(min_length=1), AfterValidator(_unique))
Align = Annotated[Alignment, BeforeValidator(lambda value: "center" if value == "centre" else value)]


class CreaseSettings(Settings):
    """Creases of the control mesh: by angle, or listed in a file."""

    angle: Annotated[float, Field(gt=0, le=180)] | None = None
    """Angle in degrees, above 0 and up to 180, between the normals of two faces, above which their edge is sharp."""
    file: str | None = None
    """Text file, relative to this one, with one crease per line: `a b` or `a b sharpness` for an edge, `a` for a
    corner; vertices are numbered from 0 as in the file of the control mesh."""
    sharpness: Annotated[float, Field(ge=0)] | None = None
    """Number of levels, such as 1.5, that edges stay sharp where the file gives none; null means all levels."""

    @model_validator(mode="after")
    def _either_angle_or_file(self) -> "CreaseSettings":
        _require_one(self, "angle", "file")
        return self


class AlphaSettings(Settings):
    """One alpha per vertex of the control mesh, from a text file or from the mesh file itself."""

    file: str | None = None
    """Text file, relative to this one, with one number per line for each vertex of the control mesh's file."""
    attribute: str | None = None
    """Name of a vertex property in the control mesh's file, which must be a PLY."""

    @model_validator(mode="after")
    def _either_file_or_attribute(self) -> "AlphaSettings":
        _require_one(self, "file", "attribute")
        return self


def _or_path(schema: dict[str, Any]) -> None:
    """Let a JSON Schema take a path in place of the settings that have it."""
    schema["anyOf"].append({"type": "string"})


class LandmarkSettings(Settings):
    """Landmarks of the source: named places, and where they belong on the target."""

    file: str
    """File, relative to this one: a CSV table, MeshMonk's `x,y,z` rows, or a point list of 3D Slicer (.fcsv,
    .mrk.json). It has pairs of places, or places on the source whose names `target.landmarks` has too."""
    hold_out: Annotated[float, Field(ge=0, le=1)] | tuple[str, ...] = 0.0
    """Landmarks that are only measured, to see what a fit has not been told: their names, or a share (0 to 1) of all;
    1 for all. Rows with `use: no` are held out in any case."""


class VertexValueSettings(Settings):
    """One value for each vertex of the control mesh, from a text file or from the mesh file itself."""

    file: str | None = None
    """Text file, relative to this one, with one number per line for each vertex of the control mesh's file."""
    attribute: str | None = None
    """Name of vertex data in the control mesh's file."""

    @model_validator(mode="after")
    def _either_file_or_attribute(self) -> "VertexValueSettings":
        _require_one(self, "file", "attribute")
        return self


class WrapSettings(Settings):
    """The alpha wrap that a source is made from, with lengths in the normalised frame."""

    alpha: Annotated[float, Field(gt=0)] | None = None
    """Length (above 0) below which gaps are closed; null chooses one, from the spacing of the points of a cloud, and by
    comparing the distance and the genus of three wraps."""
    offset: Annotated[float, Field(gt=0)] | None = None
    """Distance (above 0) of the wrap from the target; null means a thirtieth of alpha."""


class SourceSettings(Settings):
    """The source: a control mesh, its preparation, and its refinement by the scheme."""

    mesh: str = "icosahedron"
    """Control mesh: `target`, the trial's target with few faces; `closed`, the same with its holes filled; `wrap`, one
    closed surface around it; `open`, an open surface through the points of a cloud; `hull`, the visual hull of images;
    `auto`, the target, or a wrap where it is a cloud, a soup around which a wrap lies close, or an outer surface in
    open pieces, `open` where a cloud shows less than three quarters of its wrap, and `hull` for images; `sphere`, a
    small one inside the target; `icosahedron`,
    `octahedron`, `tetrahedron`, `cube`, `icosphere` or `icosphere:level=N`; the name of a target, or the path of a mesh
    file."""
    decimate: Annotated[int, Field(ge=4)] | None = None
    """Number of faces, 4 or more, to which the control mesh is reduced first; null keeps all. Of a source made from the
    target, `wanted_verts` chooses it."""
    wrap: WrapSettings | None = None
    """Lengths of the wrap where `mesh` is `wrap` or `auto`: `{alpha: LENGTH, offset: LENGTH}`; null chooses both."""
    weld: Annotated[float, Field(gt=0)] | None = None
    """Distance, in the unit of the control mesh's file, up to which boundary vertices are joined; null joins equal
    positions only."""
    repair: Repair = "split"
    """Treatment of vertices and edges where the mesh is not manifold: `split` separates the faces; `refuse` leaves
    them, so that subdivision and the Gauss–Newton engine refuse the mesh."""
    levels: Annotated[int, Field(ge=0, le=MAX_LEVELS)] = 4
    """Number of subdivision levels, from 0 to 8; 4 unless given, but 0 for a source made from the target, and 3 for
    `sphere`."""
    wanted_verts: Annotated[int, Field(ge=4)] | None = None
    """Wanted number of vertices, 4 or more: each scheme gets the number of levels that comes nearest to it, in place of
    `levels`; null uses `levels`. The control mesh of a source made from the target is decimated so that `levels` levels
    of splits in four reach it, 2,562 unless given; it is the same for all schemes."""
    radius: Annotated[float, Field(gt=0)] | None = 1.0
    """Distance of the control mesh's farthest vertex from the mean of its vertices after scaling; null keeps its
    size, as all sources made from the target do."""
    radius_of: Literal["area", "volume"] | None = None
    """`area` or `volume` scales the refined source to the area or volume of a ball of this radius, so that all schemes
    start from sources of the same size; null scales the control mesh."""
    centre: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    """Position of the mean of the control mesh's vertices in the normalised frame; null keeps its place, as all sources
    made from the target do. Also accepted as `center`."""
    frame: Literal["target"] | None = None
    """Frame of a control mesh from a file: `target` if it is in the coordinates and the unit of the target's file, as
    meshes that were aligned in another program are: it is normalised together with the target, and keeps its place and
    its size, as `radius` and `centre` are null then. null takes its coordinates for normalised ones."""
    align: Align = "none"
    """Alignment of the refined source with the target: `none`; `center` or `centre`, by centroids; `box`, by bounding
    boxes, each axis by its own scale; `pca`, by centroids, principal axes and sizes of what the two share, in the best
    pose that is found; `icp`, by iterated closest points. The target may show a part of the source, or the other way
    round. Of poses that lie about as well, the least turn is taken, and a warning given."""
    project: Literal["none", "sphere"] = "none"
    """`sphere` projects the vertices of the control mesh and of each level onto the sphere about its centre."""
    creases: CreaseSettings | None = None
    """Sharp edges of the control mesh under loop, interp-loop and midpoint: `{angle: DEGREES}` or `{file: PATH}`, each
    with an optional `sharpness`; null means boundaries alone."""
    alpha: AlphaSettings | None = None
    """One alpha per vertex of the control mesh, in place of the schemes' own: `{file: PATH}` or `{attribute: NAME}`;
    null means none."""
    landmarks: Annotated[LandmarkSettings | None, Field(json_schema_extra=_or_path)] = None
    """Landmarks, which a registration brings to where they belong: `{file: FILE}` with an optional `hold_out`, or the
    path alone; null means none."""
    weights: VertexValueSettings | None = None
    """Confidence in the data at each vertex, 0 or more, for a registration: `{attribute: NAME}` or `{file: PATH}`; a
    vertex of weight 0 follows the others; null means the same everywhere."""
    fixed: VertexValueSettings | None = None
    """Vertices that a registration leaves where `align` puts them, other than 0: `{attribute: NAME}` or `{file: PATH}`.
    No other pose is looked for then; null means none."""
    rigid: VertexValueSettings | None = None
    """Label of the part that moves rigidly in a registration, such as an eyeball, for each vertex; 0 or less for those
    that are free: `{attribute: NAME}` or `{file: PATH}`; null means no parts."""

    @property
    def cleaning(self) -> CleaningOptions:
        """The options for cleaning the control mesh's file."""
        return CleaningOptions(self.weld or 0.0, self.repair)

    @property
    def is_made_from_target(self) -> bool:
        """Whether the control mesh depends on the target."""
        return self.mesh in MADE_FROM_TARGET

    @classmethod
    def with_dependent_defaults(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return plain data with the defaults that depend on the mesh."""
        if isinstance(data.get("landmarks"), str):
            data = {**data, "landmarks": {"file": data["landmarks"]}}
        mesh = data.get("mesh")
        defaults = _SOURCE_DEFAULTS.get(mesh, {}) if isinstance(mesh, str) else {}
        if data.get("frame") is not None:
            defaults = {**defaults, "radius": None, "centre": None}
        if data.get("decimate") is not None:
            defaults = {key: value for key, value in defaults.items() if key != "wanted_verts"}
        return {**defaults, **data}

    @model_validator(mode="after")
    def _radius_of_something(self) -> "SourceSettings":
        if self.radius_of is not None and (self.is_made_from_target or self.radius is None):
            why = f"mesh: {self.mesh}" if self.is_made_from_target else "radius: null"
            raise ValueError(f"radius_of: has no effect with {why}; remove it")
        return self

    @model_validator(mode="after")
    def _frame_keeps_the_place(self) -> "SourceSettings":
        if self.frame is None:
            return self
        if self.is_made_from_target or self.mesh == "sphere":
            raise ValueError(f"frame: has no effect with mesh: {self.mesh}; set mesh to a file, or remove it")
        for key in ("radius", "centre"):
            if getattr(self, key) is not None:
                raise ValueError(f"frame: target keeps place and size; remove {key}, or frame")
        return self

    @model_validator(mode="after")
    def _wrap_needs_a_mesh(self) -> "SourceSettings":
        if self.wrap is not None and self.mesh not in ("wrap", "auto"):
            raise ValueError(f"wrap: has no effect with mesh: {self.mesh}; set mesh: wrap, or remove it")
        return self


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
