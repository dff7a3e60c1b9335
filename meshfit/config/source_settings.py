"""Settings of sources: the mesh, its place, its refinement, and what is known of it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    model_validator,
)

from meshfit.mesh.cleaning_options import CleaningOptions, Repair
from meshfit.mesh.placing_options import Alignment
from meshfit.settings import Settings

MAX_LEVELS = 8
"""The most subdivision levels that a source may have."""
KEYS_WITH_FILES = ("creases", "alpha", "landmarks", "weights", "fixed", "rigid")
"""Groups of settings of the source that may name a `file`."""
SOURCE_FILE_KEYS = (("source", "mesh"), ("source", "landmarks"), *(("source", key, "file") for key in KEYS_WITH_FILES))
"""Settings of the source that may be paths of files."""
MADE_FROM_TARGET = ("target", "closed", "open", "wrap", "hull", "auto")
"""Values of `source.mesh` that stand for control meshes made from the trial's target."""
_OF_TARGET = {"levels": 0, "wanted_verts": 2562, "radius": None, "centre": None}
_SOURCE_DEFAULTS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(MADE_FROM_TARGET, _OF_TARGET),
    "sphere": {"levels": 3, "radius": 0.3, "project": "sphere"},
}
"""Defaults of the source's other settings that depend on its mesh."""


def _require_one(settings: Settings, first: str, second: str) -> None:
    given = [name for name in (first, second) if getattr(settings, name) is not None]
    if len(given) != 1:
        raise ValueError(f"expected either {first} or {second}, got {'both' if given else 'neither'}")


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
