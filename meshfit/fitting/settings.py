"""Settings of a fit. Importing them does not import torch, so that configs are read and checked quickly."""

import re
import warnings
from collections.abc import Sequence
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from meshfit.errors import ConfigError
from meshfit.fitting.external.tools import TOOLS, ToolName
from meshfit.fitting.registration.plan import Prior, Register, planned_steps
from meshfit.printable import printable
from meshfit.settings import DEFAULT_KIND, KIND_KEY, Settings, build
from meshfit.specs import suggest

MOST_STEPS = 1_000_000_000
"""The most steps of a fit, or of a part of it."""
Every = Annotated[int, Field(ge=1)]
Weight = Annotated[float, Field(ge=0)]
Fairness = Annotated[float, Field(gt=0)]
Dtype = Literal["float32", "float64"]
Direction = Literal["both", "to-target", "to-source"]
"""Pairs of points that pull: both ways, from the surface to the target, or from the target to the surface."""
VIEW_TERMS = ("silhouette", "depth", "normals")
"""Names of the terms that only a target of images has."""


class LossWeights(Settings):
    """Weight of each term of the objective; a term of weight 0 is traced but has no effect."""

    chamfer: Weight = 1.0
    """Weight (0 or more) of the chamfer term: mean squared distance to the nearest sample, summed both ways."""
    normal: Weight = 0.0
    """Weight (0 or more) of the normal term: mean 1 - |cos| to the normal of the nearest sample, summed both ways."""
    edge: Weight = 1.0
    """Weight (0 or more) of the edge term: mean squared edge length."""
    laplacian: Weight = 0.1
    """Weight (0 or more) of the Laplacian term: mean length of the Laplacian of the vertex positions."""
    consistency: Weight = 0.01
    """Weight (0 or more) of the normal-consistency term: mean 1 - cos between normals of adjacent faces."""
    silhouette: Weight | None = None
    """Weight (0 or more) of the silhouettes of a target of images: 1 - intersection over union with its masks; null
    means 1 for such targets, or 0 if it has a weight of depth or normals."""
    depth: Weight | None = None
    """Weight (0 or more) of the depth of a target of images: mean absolute difference to its depth maps; null means
    0."""
    normals: Weight | None = None
    """Weight (0 or more) of the normals of a target of images: mean 1 - cos to its maps of normals; null means 0."""

    @property
    def of_views(self) -> dict[str, float]:
        """The weights above 0 of the terms that a target of images has."""
        silhouette = self.silhouette if self.silhouette is not None else float(not (self.depth or self.normals))
        weights = {"silhouette": silhouette, "depth": self.depth or 0.0, "normals": self.normals or 0.0}
        return {name: weight for name, weight in weights.items() if weight > 0}


class ViewSettings(Settings):
    """Settings of a first-order fit to images."""

    blur: Annotated[float, Field(gt=0, le=100)] = 1.0
    """Width (above 0, at most 100) in pixels over which outlines are softened; the larger, the farther they pull."""
    per_step: Annotated[int, Field(ge=1)] = 4
    """Number of views (1 or more) drawn at each step; all of them if there are no more."""
    silhouette: Literal["iou", "squared"] = "iou"
    """Difference of silhouettes: `iou`, 1 - intersection over union, or `squared`, the mean squared difference."""


class Schedule(Settings):
    """Change of the learning rate over the steps."""

    name: Literal["constant", "cosine", "step"] = "constant"
    """`constant`; `cosine` decay to `final` times `lr`; or `step`, times `factor` after every `every` steps."""
    final: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Fraction of `lr` (0 to 1) that `cosine` ends at."""
    every: Annotated[int, Field(ge=1)] = 500
    """Number of steps (1 or more) between two reductions by `step`."""
    factor: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Factor (above 0, at most 1) of each reduction by `step`."""


class OptimizerSettings(Settings):
    """The optimiser, which turns gradients into steps."""

    name: Literal["sgd", "adam"] = "sgd"
    """Optimiser: `sgd` (with momentum) or `adam`."""
    lr: Annotated[float, Field(gt=0)] = 1.0
    """Learning rate (above 0)."""
    momentum: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """Momentum (0 or more, below 1) of `sgd`, or the first beta of `adam`."""
    schedule: Schedule = Schedule()
    """Change of the learning rate over the steps."""


class FirstOrderSettings(Settings):
    """A first-order fit: gradient descent on weighted losses. Lengths are in the target's normalised frame.

    Example:
        >>> import meshfit
        >>> settings = meshfit.FirstOrderSettings(steps=5, samples=100)
        >>> meshfit.fit("icosahedron", "cube", settings, device="cpu").trace.rows[-1][0]
        4
    """

    method: Literal["first-order"] = "first-order"
    """Engine: `first-order` moves the source's vertices along the gradient of the weighted losses."""
    steps: Annotated[int, Field(ge=0, le=MOST_STEPS)] = 2000
    """Number of optimiser steps (0 to 1,000,000,000)."""
    samples: Annotated[int, Field(ge=1)] = 5000
    """Number of points (1 or more) sampled at every step on each of source and target, uniformly by area."""
    losses: LossWeights = LossWeights()
    """Weights of the loss terms."""
    laplacian: Literal["uniform", "cotangent"] = "uniform"
    """Laplacian of the Laplacian term: `uniform` or `cotangent` weights of the neighbours."""
    optimizer: OptimizerSettings = OptimizerSettings()
    """The optimiser and its learning rate."""
    views: ViewSettings | None = None
    """Settings of the losses on images; null means the defaults."""
    trace_every: Every = 10
    """Number of steps (1 or more) from one row of `trace.csv` to the next; the first and last steps always have one."""
    snapshots: Every | None = None
    """Number of steps (1 or more) between snapshots for `meshfit animate`, or null for none; no effect on results.
    They are shapes alone: only results carry texture coordinates, colours and the like."""

    def fault_with(self, maps: Sequence[str] | None) -> str:
        """Return which setting of images does not go with a target, in words; empty if all do.

        Args:
            maps: what the images have besides masks, of `depth` and `normals`; None for a target without images.
        """
        given = [name for name in VIEW_TERMS if getattr(self.losses, name)]
        if maps is None:
            keys = [*(f"losses.{name}" for name in given), *(["views"] if self.views is not None else [])]
            return f"{keys[0]}: is for targets of images, and this is a mesh; remove it" if keys else ""
        lacking = [name for name in given if name != "silhouette" and name not in maps]
        return f"losses.{lacking[0]}: the images have no {lacking[0]}; remove it, or add maps of it" if lacking else ""


# Pydantic warns of a field that hides a method of every abstract class, which no settings use.
warnings.filterwarnings("ignore", message='Field name "register"')


class GaussNewtonSettings(Settings):
    """A Gauss–Newton fit, coarse to fine. Lengths are in the target's normalised frame.

    Example:
        >>> import meshfit
        >>> meshfit.GaussNewtonSettings(levels=2, coarse_steps=20).steps
        89
    """

    # Settings without the key are first-order.
    model_config = ConfigDict(json_schema_extra={"required": [KIND_KEY]})

    method: Literal["gauss-newton"] = "gauss-newton"
    """Engine: `gauss-newton` solves for the step of all vertices at once, level by level of the scheme."""
    connectivity: Literal["remeshed", "fixed"] = "remeshed"
    """Faces of the result: `remeshed` adapts them to the target; `fixed` keeps the source's, refined by the scheme."""
    variables: Literal["verts", "control"] = "verts"
    """Unknowns: the `verts` of the surface, or those of a coarse `control` mesh that is refined to the surface."""
    limit: bool = False
    """Whether to fit the limit surface; requires `variables: control` and the scheme `loop`."""
    verts: Annotated[int, Field(ge=100)] = 10242
    """Largest number of vertices (100 or more) of a `remeshed` result, or of its control mesh; the rough shape of a
    `fixed` fit has a quarter of it, or as many as the source if that has more."""
    decimate_from: Annotated[float, Field(ge=1, le=10)] = 2.4
    """Number of vertices of a `remeshed` surface, relative to `verts` (1 to 10), from which it is decimated by quadrics
    before the last steps, which puts vertices where it bends; at most 60,000 vertices, and 1 for no decimation."""
    levels: Annotated[int, Field(ge=0, le=5)] = 1
    """Number of subdivision levels (0 to 5) from coarse to fine, or from the control mesh to the surface."""
    coarse_steps: Annotated[int, Field(ge=0, le=MOST_STEPS)] = 40
    """Number of steps (0 to 1,000,000,000) of each search for the rough shape."""
    tries: Annotated[int, Field(ge=1, le=10)] = 3
    """Largest number of searches (1 to 10) for the rough shape; each restarts from the source, with more vertices, and
    only while parts of the surface stay off the target. A source that is near to the target needs none. Above 1, a fit
    that ends with parts joined which the target has apart is followed by a second one; the nearer is the result."""
    level_steps: Annotated[int, Field(ge=1, le=MOST_STEPS)] = 8
    """Number of steps (1 to 1,000,000,000) at each level."""
    last_steps: Annotated[int, Field(ge=0, le=MOST_STEPS)] = 5
    """Number of final steps (0 to 1,000,000,000) on the finest level."""
    start_fairness: Fairness | None = None
    """Weight of smoothness (above 0) at the start of each level; null means 0.2, or 0.05 for a source that is near to
    the target."""
    fairness: Fairness | None = None
    """Weight of smoothness (above 0) at the end of each level; null means 0.1, or 0.02 for a near source."""
    last_fairness: Fairness | None = None
    """Weight of smoothness (above 0) at the end of the last steps; null means 0.02, or 0.005 for a near source
    or with decimation."""
    noise: Literal["auto"] | Weight = "auto"
    """Standard deviation (0 or more) of the target's points or vertices across its surface: the more, the smoother the
    result. `auto` estimates it; 0 follows every point. It is in the normalised frame."""
    robust: Literal["auto", "off"] = "auto"
    """Outliers of the target: `auto` leaves out stray points of a cloud and spikes of a mesh that has noise, and lets
    points far from the surface count little once those around them are reached; `off` follows every point."""
    direction: Direction = "both"
    """Pairs of points that pull: `both`; `to-target`, from the surface to its nearest points on the target, for targets
    larger than the source; or `to-source`, from the target to the surface, for targets that show only a part."""
    register: Register = "off"
    """Registration of the source, each of whose vertices has a meaning: `rigid` finds its pose, `near-rigid` also bends
    it, so that vertices go where they belong; requires `connectivity: fixed`. Where sizes differ, so does its scale.
    `soft` also lets parts grow and shrink, for another shape of the same kind, such as animal to animal.
    `auto` registers meshes from files: `rigid` if a pose is enough, `near-rigid` if not, and `off` if none serves."""
    symmetric: bool = False
    """Whether a registered source that is mirror-symmetric stays so: each vertex of the result is the mirror image of
    its partner. The plane of the result moves with it."""
    offset: float = 0.0
    """Distance of the result from the target along its normals: above 0 outside it, as skin is over bone, below 0
    inside. It is in the normalised frame."""
    trace_every: Every = 1
    """Number of steps (1 or more) from one row of `trace.csv` to the next; the first and last steps always have one."""
    snapshots: Every | None = None
    """Number of steps (1 or more) between snapshots for `meshfit animate`, or null for none; no effect on results.
    They are shapes alone: only results carry texture coordinates, colours and the like."""

    @property
    def steps(self) -> int:
        """Total number of steps."""
        levels = 2 if self.variables == "control" else self.levels + 1
        unregistered = self.tries * self.coarse_steps + levels * self.level_steps + self.last_steps
        if self.prior is None:
            return unregistered
        refined = self.levels * self.level_steps + (self.last_steps if self.levels else 0)
        # Those of a fit that turns out not to be a registration are planned, too.
        return len(planned_steps(self.prior)) + refined + (unregistered if self.register == "auto" else 0)

    @property
    def prior(self) -> Prior | None:
        """Prior of the registration; None without one."""
        if self.register != "auto":
            return None if self.register == "off" else self.register
        return "near-rigid" if self.connectivity == "fixed" and self.variables == "verts" else None

    @model_validator(mode="after")
    def _registered_source_keeps_its_faces(self) -> "GaussNewtonSettings":
        if self.register not in ("off", "auto") and (self.connectivity != "fixed" or self.variables != "verts"):
            raise ValueError("register: requires connectivity: fixed and variables: verts, so that vertices stay")
        return self

    @model_validator(mode="after")
    def _symmetric_source_is_registered(self) -> "GaussNewtonSettings":
        if self.symmetric and self.prior is None:
            raise ValueError("symmetric: only a registration keeps a source symmetric; set register, or remove it")
        return self


def _plain_arguments(command: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse arguments that a log cannot show, and placeholders that do not exist."""
    for part in command:
        if printable(part) != part:
            raise ValueError(f"control characters in {part!r}; remove them")
        for name in re.findall(r"\{(\w+)\}", part):
            if name not in PLACEHOLDERS:
                raise ValueError(f"'{{{name}}}' in {part!r} stands for nothing: {suggest(name, PLACEHOLDERS)}")
    if not command[0].strip():
        raise ValueError("the program, which comes first, has no name")
    return command


PLACEHOLDERS = ("source", "target", "result", "folder", "seed", "threads")
"""Names in braces that stand for paths and numbers in an external command."""

_Command = Annotated[
    tuple[str, ...],
    Field(min_length=1, max_length=1000),
    BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value),
    AfterValidator(_plain_arguments),
]


class ExternalSettings(Settings):
    """A fit by another tool: a command, or one of the ready entries. Lengths are in the target's normalised frame.

    Example:
        >>> import meshfit
        >>> meshfit.ExternalSettings(tool="poisson", options={"depth": 6}).tool_options.depth
        6
    """

    model_config = ConfigDict(json_schema_extra={"required": [KIND_KEY]})

    method: Literal["external"] = "external"
    """Engine: `external` runs another tool in a process of its own, and measures what it writes."""
    tool: ToolName | None = None
    """Ready entry: `poisson`, `alpha-wrap`, `quadric`, `nricp`, `pycpd`, `meshmonk` or `reach-for-the-spheres`."""
    options: dict[str, bool | int | float | str | None] = Field(default_factory=dict)
    """Options of the ready entry, such as `{depth: 9}`."""
    command: _Command | None = None
    """Program and arguments, run without a shell in an empty folder, with `{source}`, `{target}` and `{result}` for
    the files to read and to write, and `{seed}`, `{threads}` and `{folder}`; requires `--allow-commands`."""
    version_command: _Command | None = None
    """Program and arguments that print the version of the command, whose first line is recorded; null for none."""
    format: Literal["ply", "obj", "off", "stl"] = "ply"
    """Format of the files that a command reads and writes."""
    environment: tuple[str, ...] = ()
    """Names of environment variables that a command gets besides PATH, HOME, language and number of threads."""
    time_limit: Annotated[float, Field(gt=0)] = 3600.0
    """Seconds (above 0) after which the tool is stopped and the trial has failed."""
    memory_limit: Annotated[float, Field(gt=0)] | None = None
    """Memory in MB (above 0) at which the tool is stopped and the trial has failed; null for no limit."""

    @property
    def steps(self) -> int:
        """Total number of steps: the tool is one."""
        return 1

    @property
    def snapshots(self) -> None:
        """Number of steps between snapshots: there are none."""

    @property
    def name(self) -> str:
        """The ready entry, or the name of the program, or of the script that an interpreter runs."""
        return self.tool or command_name(self.command or ())

    @property
    def tool_options(self) -> Settings:
        """The options of the ready entry.

        Raises:
            ConfigError: there is none.
        """
        if self.tool is None:
            raise ConfigError("fit.options: a command has none; give them as arguments")
        return build(TOOLS[self.tool].options, self.options)

    @property
    def depends_on_seed(self) -> bool:
        """Whether another seed may give another result."""
        if self.tool is not None:
            return TOOLS[self.tool].seeded
        return any("{seed}" in part for part in self.command or ())

    @property
    def takes_points(self) -> bool:
        """Whether the target may be a cloud of points: for some tools, and for commands that get a file of points."""
        return self.format != "stl" if self.tool is None else TOOLS[self.tool].points

    @model_validator(mode="after")
    def _either_tool_or_command(self) -> "ExternalSettings":
        if (self.tool is None) == (self.command is None):
            given = "neither" if self.tool is None else "both"
            raise ValueError(f"expected either tool or command, got {given}; tools: {', '.join(TOOLS)}")
        if self.tool is not None:
            self._require_keys_of_tool()
        elif self.options:
            raise ValueError("options: a command has none; give them as arguments")
        elif not any("{result" in part for part in self.command or ()):
            raise ValueError("command: none of its arguments holds {result}, the file to write")
        return self

    def __hash__(self) -> int:
        """Hash the JSON text, since options are a dict, which has no hash."""
        return hash(self.model_dump_json())

    def _require_keys_of_tool(self) -> None:
        for key, default in (("version_command", None), ("format", "ply"), ("environment", ())):
            if getattr(self, key) != default:
                raise ValueError(f"{key}: only a command has it, and this is the tool {self.tool}")
        try:
            _ = self.tool_options
        except ConfigError as error:
            raise ValueError("; ".join(f"options.{fault}" for fault in error.faults)) from None


def command_name(command: Sequence[str]) -> str:
    """Return the name of a command in tables and logs: that of the program, or of the script that it interprets."""
    names = [PurePath(part).name for part in command]
    if len(names) > 1 and re.fullmatch(r"python[\d.]*|bash|sh|node|perl|ruby|julia|Rscript", names[0]):
        return next((name for name in names[1:] if not name.startswith("-") and "{" not in name), names[0])
    return names[0] if names else ""


def _method(settings: Any) -> str:  # noqa: ANN401  settings, or a mapping to build them from
    if isinstance(settings, dict):
        return str(settings.get(KIND_KEY, DEFAULT_KIND))
    return str(getattr(settings, KIND_KEY, DEFAULT_KIND))


FitSettings = Annotated[
    Annotated[FirstOrderSettings, Tag("first-order")]
    | Annotated[GaussNewtonSettings, Tag("gauss-newton")]
    | Annotated[ExternalSettings, Tag("external")],
    Discriminator(_method),
]
"""Settings of a fit by any engine, distinguished by `method`, which defaults to `first-order`."""

METHODS: dict[str, type[FirstOrderSettings] | type[GaussNewtonSettings] | type[ExternalSettings]] = {
    "first-order": FirstOrderSettings,
    "gauss-newton": GaussNewtonSettings,
    "external": ExternalSettings,
}


def default_fit(method: str) -> dict[str, Any]:
    """Return the default of every setting of a method, as plain data."""
    return METHODS[method].model_construct().model_dump(mode="json")
