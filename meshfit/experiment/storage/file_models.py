"""Models of the JSON files of a run, which are validated when they are read: what commands rely on, and its types.

Other members are allowed and kept as they are, since files of later versions may have some.
"""

import json
import textwrap
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

_LONGEST_VALUE = 60
_LARGEST_INTEGER = 2**63
_EXPECTED = {
    "string": "text",
    "int": "a whole number",
    "float": "a number",
    "finite": "a finite number",
    "bool": "true or false",
    "list": "a list",
    "tuple": "a list",
    "dict": "an object",
    "model": "an object",
}
"""Names of expected types, by the first part of the type of a pydantic error."""


class FileModel(BaseModel):
    """Members of a JSON object, none of them converted."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False, frozen=True)


Whole = Annotated[int, Field(ge=-_LARGEST_INTEGER, le=_LARGEST_INTEGER)]
Count = Annotated[int, Field(ge=0, le=_LARGEST_INTEGER)]
Amount = Annotated[float, Field(ge=0)]
Object = dict[str, Any]

_ABSENT: Any = None
"""Default of an object that a file need not have; null in its place is refused."""


class ResultSettings(FileModel):
    """Settings of a trial in its result, in which each group is an object."""

    targets: Annotated[list[str], Field(min_length=1)]
    schemes: Annotated[list[str], Field(min_length=1)] = [""]
    seeds: list[Count] = []
    source: Object = {}
    target: Object = {}
    fit: Object = {}
    measure: Object = {}
    define: Object = {}


class FitFacts(FileModel):
    """Record of a fit."""

    steps: Count | None = None
    device: str | None = None
    final_loss: float | None = None


class FrameFacts(FileModel):
    """Map from the target's own frame to the normalised one."""

    centre: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    scale: Annotated[float, Field(gt=0)] | None = None
    normalise: str | None = None
    written: str | None = None


class AlignFacts(FileModel):
    """Record of an alignment."""

    method: str
    turn_degrees: float
    scale: float
    distance: float | None = None
    other_turn_degrees: float | None
    other_distance: float | None = None

    @model_validator(mode="after")
    def _has_both_distances(self) -> "AlignFacts":
        if self.other_turn_degrees is not None and None in (self.distance, self.other_distance):
            raise ValueError("no distance of a pose")
        return self


class SourceFacts(FileModel):
    """Record of a source."""

    made_from: str | None = None
    reason: str | None = None
    wrap: dict[str, float] = {}
    align: AlignFacts | None = None

    @model_validator(mode="after")
    def _has_reason(self) -> "SourceFacts":
        if self.made_from is not None and self.reason is None:
            raise ValueError("no reason")
        return self


class CloudFacts(FileModel):
    """Record of a target that is a cloud of points."""

    points: Count
    spacing: float
    normals: str


class ImagesFacts(FileModel):
    """Record of a target of images."""

    views: Count
    held_out: Count
    compared_with: Literal["truth", "depth", "hull"]


class ToolFacts(FileModel):
    """Record of an external tool."""

    name: str
    version: str | None


class Check(FileModel):
    """A check of a verdict."""

    name: str
    passed: bool
    value: float | None = None
    threshold: float | None = None
    text: str = ""


class VerdictFacts(FileModel):
    """The verdict on a result."""

    sound: bool
    checks: list[Check] = []


class OverlapFacts(FileModel):
    """Record of the masks of a result besides metrics."""

    worst_view: str = ""


class FileFacts(FileModel):
    """Size in bytes and SHA-256 of a mesh of a trial."""

    bytes: Count
    sha256: str


class ResultContent(FileModel):
    """Content of `result.json`, without its metrics."""

    schema_version: Count
    identity: str
    experiment: str
    target: str
    target_title: str
    scheme: str
    seed: Whole
    variant: str | None = None
    settings: ResultSettings
    inputs: dict[str, str] = {}
    fit: FitFacts = _ABSENT
    frame: FrameFacts = _ABSENT
    source: SourceFacts = _ABSENT
    seconds: dict[str, Amount] = {}
    warnings: list[str] = []
    shortfalls: list[str] = []
    verdict: VerdictFacts = _ABSENT
    finished: str | None = None
    versions: dict[str, str | None] = {}
    platform: dict[str, str | None] = {}
    cloud: CloudFacts = _ABSENT
    images: ImagesFacts = _ABSENT
    tool: ToolFacts = _ABSENT
    iou: OverlapFacts = _ABSENT
    register_: Annotated[Object, Field(alias="register")] = {}
    farthest: Object = {}
    files: dict[str, FileFacts] = {}


class MeasurementContent(FileModel):
    """Content of `measurement.json`."""

    of: Object
    values: Object
    settings: Object
    versions: dict[str, str | None]
    finished: str


class FailureContent(FileModel):
    """Content of `failure.json`."""

    kind: str = "error"
    message: str = ""
    step: Count | None = None
    attempts: Count = 1
    identity: str | None = None
    error: str | None = None
    traceback: list[str] = []
    frame: FrameFacts = _ABSENT


class ProgressContent(FileModel):
    """Content of `progress.json`."""

    phase: str
    step: Count
    steps: Count
    loss: float | None
    host: str
    pid: Count
    started: str
    updated: str


class PlannedContent(FileModel):
    """A trial in `plan.json`."""

    folder: str
    identity: str
    target: str
    target_title: str
    scheme: str
    seed: Whole
    variant: str
    steps: Count
    origin: Count | None = None
    file: str | None = None
    sha256: str | None = None


class OriginContent(FileModel):
    """What several trials of a plan share."""

    settings: Object
    inputs: dict[str, str]


class ViewContent(FileModel):
    """Settings of pictures in `plan.json`."""

    up: str = "auto"


class PlanContent(FileModel):
    """Content of `plan.json`."""

    schema_version: Count
    written: str
    workers: Count
    trials: list[PlannedContent]
    origins: list[OriginContent] = []
    targets: list[str] | None = None
    schemes: list[str] | None = None
    variants: list[str] | None = None
    view: ViewContent = ViewContent()


def fault_in(model: type[FileModel], content: object) -> str | None:
    """Return what is wrong with the content of a file in some words; None if it follows the model."""
    try:
        model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    else:
        return None
    place, kind = ".".join(map(str, first["loc"])), first["type"]
    if kind == "missing" or (kind == "too_short" and not first["input"]):
        return f"no {place}"
    if kind == "value_error":
        return f"{place}: {first['msg'].removeprefix('Value error, ')}"
    if kind.startswith(("greater_than", "less_than")):
        return f"{place} is {shortened_value(first['input'])}, which is impossible"
    expected = _EXPECTED.get(kind.partition("_")[0])
    return f"{place} is {shortened_value(first['input'])}" + (f", expected {expected}" if expected else "")


def shortened_value(value: object) -> str:
    """Return a value of a JSON file as text, at most 60 characters of it."""
    return textwrap.shorten(json.dumps(value), _LONGEST_VALUE, placeholder=" …")
