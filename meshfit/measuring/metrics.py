"""The metrics of a result: their titles and units, which direction is better, and how they are printed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from meshfit.errors import ConfigError
from meshfit.specs import suggest

LENGTH, SQUARED_LENGTH = "length", "length²"


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes:
        title: its name in tables and captions.
        smaller_is_better: whether smaller values are better; None where neither direction is.
        format: format spec of its values.
        unit: `length` in the unit of the vertices, its square, or one such as `°` or `s`; empty for shares and counts.
    """

    title: str
    smaller_is_better: bool | None
    format: str
    unit: str = ""

    @property
    def whole(self) -> bool:
        """Whether values are counts, or true or false."""
        return self.format in ("d", "")

    def text(self, value: int | float | bool | None) -> str:  # noqa: FBT001  a value of the metric
        """Return a value as text; a missing one is a dash."""
        if value is None or isinstance(value, bool):
            return "–" if value is None else str(value)
        return format(value, self.format)


def _less(title: str, spec: str, unit: str = "") -> Metric:
    return Metric(title, smaller_is_better=True, format=spec, unit=unit)


def _more(title: str, spec: str, unit: str = "") -> Metric:
    return Metric(title, smaller_is_better=False, format=spec, unit=unit)


def _neutral(title: str, spec: str, unit: str = "") -> Metric:
    return Metric(title, smaller_is_better=None, format=spec, unit=unit)


def _length(title: str) -> Metric:
    return _less(title, ".4g", LENGTH)


_SHARE, _COUNT, _ANGLE = ".4f", "d", ".2f"

MEASURED: Mapping[str, Metric] = MappingProxyType(
    {
        "hausdorff.forward": _length("Hausdorff distance, result to target"),
        "hausdorff.backward": _length("Hausdorff distance, target to result"),
        "hausdorff.symmetric": _length("Hausdorff distance"),
        "hausdorff.percent_of_diagonal": _less("Hausdorff distance, % of diagonal", ".3f", "%"),
        "distance.mean": _length("mean distance"),
        "distance.rms": _length("RMS distance"),
        "distance.forward_mean": _length("mean distance, result to target"),
        "distance.backward_mean": _length("mean distance, target to result"),
        "distance.forward_rms": _length("RMS distance, result to target"),
        "distance.backward_rms": _length("RMS distance, target to result"),
        "distance.forward_p50": _length("median distance, result to target"),
        "distance.forward_p90": _length("90th percentile, result to target"),
        "distance.forward_p95": _length("95th percentile, result to target"),
        "distance.forward_p99": _length("99th percentile, result to target"),
        "distance.backward_p50": _length("median distance, target to result"),
        "distance.backward_p90": _length("90th percentile, target to result"),
        "distance.backward_p95": _length("95th percentile, target to result"),
        "distance.backward_p99": _length("99th percentile, target to result"),
        "chamfer.l1": _length("chamfer distance L1"),
        "chamfer.l2_squared": _less("chamfer distance L2²", ".4g", SQUARED_LENGTH),
        "f_score.f1": _more("F-score", _SHARE),
        "f_score.precision": _more("precision", _SHARE),
        "f_score.recall": _more("recall", _SHARE),
        "normal_consistency.signed": _more("normal consistency", _SHARE),
        "normal_consistency.absolute": _more("normal consistency, unsigned", _SHARE),
        "normal_angle.mean": _less("mean normal angle (°)", _ANGLE, "°"),
        "normal_angle.p50": _less("median normal angle (°)", _ANGLE, "°"),
        "normal_angle.p90": _less("normal angle, 90th percentile (°)", _ANGLE, "°"),
        "normal_angle.p95": _less("normal angle, 95th percentile (°)", _ANGLE, "°"),
        "normal_angle.p99": _less("normal angle, 99th percentile (°)", _ANGLE, "°"),
        "edges.chamfer": _length("edge chamfer distance"),
        "edges.f1": _more("edge F-score", _SHARE),
        "edges.precision": _more("edge precision", _SHARE),
        "edges.recall": _more("edge recall", _SHARE),
        "quality.self_intersecting_faces": _less("self-intersecting faces", _COUNT),
        "quality.flipped_faces": _less("flipped faces", _COUNT),
        "quality.degenerate_faces": _less("degenerate faces", _COUNT),
        "quality.smallest_angle": _more("smallest angle (°)", _ANGLE, "°"),
        "quality.watertight": _more("watertight", ""),
        "quality.components": _neutral("components", _COUNT),
        "quality.euler_number": _neutral("Euler number", _COUNT),
        "quality.verts": _neutral("vertices", _COUNT),
        "quality.faces": _neutral("faces", _COUNT),
    }
)
"""The metrics of a `Measurement`, by dotted name. Those of the edges are None where there are no creases."""

CORRESPONDING: Mapping[str, Metric] = MappingProxyType(
    {
        "vertex_error.rms": _length("vertex error"),
        "vertex_error.p50": _length("median vertex error"),
        "vertex_error.p99": _length("99th percentile of the vertex error"),
        "vertex_error.max": _length("largest vertex error"),
        "vertex_error.percent_of_diagonal": _less("vertex error, % of diagonal", ".3f", "%"),
        "landmark_error.rms": _length("landmark error"),
        "landmark_error.max": _length("largest landmark error"),
        "landmark_error.left_out_rms": _length("error of landmarks left out"),
        "landmark_error.left_out_max": _length("largest error of landmarks left out"),
        "stretch.p50": _less("median stretch", ".3f"),
        "stretch.p99": _less("99th percentile of the stretch", ".3f"),
        "new_defects.crossing_pairs": _less("new pairs of crossing faces", _COUNT),
        "new_defects.crossing_faces": _less("new crossing faces", _COUNT),
        "new_defects.flipped_faces": _less("new flipped faces", _COUNT),
        "new_defects.degenerate_faces": _less("new degenerate faces", _COUNT),
        "unmatched.source": _less("unmatched share of the source", _SHARE),
    }
)
"""The metrics of results whose vertices are those of a source: against where these belong, and against the source."""

OF_IMAGES: Mapping[str, Metric] = MappingProxyType(
    {
        "iou.mean": _more("mask IoU", _SHARE),
        "iou.least": _more("least mask IoU", _SHARE),
        "iou.held_out_mean": _more("mask IoU on views held out", _SHARE),
        "iou.held_out_least": _more("least mask IoU on views held out", _SHARE),
    }
)
"""The metrics of results that images were the target of; those of views held out are None without such views."""

OF_MEASUREMENTS: Mapping[str, Metric] = MappingProxyType({**MEASURED, **CORRESPONDING, **OF_IMAGES})
"""The metrics that a `Measurement` may have."""

METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        **OF_MEASUREMENTS,
        "source.area": _neutral("area of the source", ".6g", SQUARED_LENGTH),
        "source.verts": _neutral("vertices of the source", _COUNT),
        "source.faces": _neutral("faces of the source", _COUNT),
        "seconds.fit": _less("fitting time (s)", ".4g", "s"),
        "seconds.measure": _less("measuring time (s)", ".4g", "s"),
        "peak_memory_mb": _less("peak memory (MB)", ".4g", "MB"),
    }
)
"""All metrics of a result: those of its measurement, those of the source, which no seed affects, time and memory.

Not every result has those of `CORRESPONDING` and `OF_IMAGES`.
"""

DEFAULT_METRIC = "hausdorff.symmetric"
DEFAULT_METRIC_OF_CLOUDS = "distance.backward_rms"
"""The metric of tables of fits to points: distances to points are too large by a share of their spacing, and a scan
that shows only a part is no measure of what a result adds to it."""

DEFAULT_METRIC_OF_IMAGES = "iou.mean"
"""The metric of tables of fits to masks alone, of which no true shape is known."""

NO_SIDE = "the target is a cloud of points without normals; estimated ones have no side"
"""Why a signed normal consistency is missing."""

_SETTINGS = {
    "hausdorff.samples": "measure.samples",
    "chamfer.points": "measure.points",
    "f_score.tau": "measure.f_score_tau",
}
"""Values beside the metrics of a measurement that are settings."""


_MAIN = {
    "hausdorff": DEFAULT_METRIC,
    "distance": "distance.mean",
    "chamfer": "chamfer.l1",
    "f_score": "f_score.f1",
    "normal_consistency": "normal_consistency.signed",
    "normal_angle": "normal_angle.mean",
    "edges": "edges.f1",
    "vertex_error": "vertex_error.rms",
    "landmark_error": "landmark_error.rms",
    "stretch": "stretch.p99",
    "new_defects": "new_defects.crossing_faces",
    "unmatched": "unmatched.source",
    "iou": "iou.mean",
}
"""The metric that a group's name alone stands for."""


_NEGATIVE = {"quality.euler_number": -math.inf, "normal_consistency.signed": -1.0}
_LARGEST = {_SHARE: 1.0, _ANGLE: 180.0}
_ROUNDING = 1e-6


@cache
def possible_range(name: str) -> tuple[float, float]:
    """Return the least and the largest value that a metric can have."""
    largest = _LARGEST.get(METRICS[name].format, math.inf)
    return _NEGATIVE.get(name, 0.0) - _ROUNDING, largest + _ROUNDING


def metric_named(name: str) -> str:
    """Return the metric that a group's name stands for, such as `hausdorff`; other names stay as they are."""
    return _MAIN.get(name, name)


def require_metric(name: str) -> None:
    """Refuse an unknown metric.

    Raises:
        ConfigError: there is no such metric; the message suggests the nearest.
    """
    if name in _SETTINGS:
        raise ConfigError(f"'{name}' is the setting {_SETTINGS[name]}, not a metric: {suggest(name, METRICS)}")
    if name not in METRICS:
        raise ConfigError(f"'{name}' is not a metric: {suggest(name, METRICS)}")
