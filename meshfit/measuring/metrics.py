"""The metrics of a result: their titles, which direction is better, and how they are printed."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from meshfit.errors import ConfigError
from meshfit.specs import suggest


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes:
        title: its name in tables and captions.
        smaller_is_better: whether smaller values are better; None where neither direction is.
        format: format spec of its values.
    """

    title: str
    smaller_is_better: bool | None
    format: str

    @property
    def whole(self) -> bool:
        """Whether values are counts, or true or false."""
        return self.format in ("d", "")


def _less(title: str, spec: str) -> Metric:
    return Metric(title, smaller_is_better=True, format=spec)


def _more(title: str, spec: str) -> Metric:
    return Metric(title, smaller_is_better=False, format=spec)


def _neutral(title: str, spec: str) -> Metric:
    return Metric(title, smaller_is_better=None, format=spec)


_LENGTH, _SHARE, _COUNT = ".4g", ".4f", "d"

MEASURED: Mapping[str, Metric] = MappingProxyType(
    {
        "hausdorff.forward": _less("Hausdorff distance, result to target", _LENGTH),
        "hausdorff.backward": _less("Hausdorff distance, target to result", _LENGTH),
        "hausdorff.symmetric": _less("Hausdorff distance", _LENGTH),
        "hausdorff.samples": _neutral("samples per direction", _COUNT),
        "hausdorff.percent_of_diagonal": _less("Hausdorff distance, % of diagonal", ".3f"),
        "distance.mean": _less("mean distance", _LENGTH),
        "distance.rms": _less("RMS distance", _LENGTH),
        "distance.forward_mean": _less("mean distance, result to target", _LENGTH),
        "distance.backward_mean": _less("mean distance, target to result", _LENGTH),
        "distance.forward_rms": _less("RMS distance, result to target", _LENGTH),
        "distance.backward_rms": _less("RMS distance, target to result", _LENGTH),
        "chamfer.l1": _less("chamfer distance L1", _LENGTH),
        "chamfer.l2_squared": _less("chamfer distance L2²", _LENGTH),
        "chamfer.points": _neutral("points per surface", _COUNT),
        "f_score.tau": _neutral("F-score distance τ", "g"),
        "f_score.f1": _more("F-score", _SHARE),
        "f_score.precision": _more("precision", _SHARE),
        "f_score.recall": _more("recall", _SHARE),
        "normal_consistency.signed": _more("normal consistency", _SHARE),
        "normal_consistency.absolute": _more("normal consistency, unsigned", _SHARE),
        "quality.self_intersecting_faces": _less("self-intersecting faces", _COUNT),
        "quality.flipped_faces": _less("flipped faces", _COUNT),
        "quality.degenerate_faces": _less("degenerate faces", _COUNT),
        "quality.smallest_angle": _more("smallest angle (°)", ".2f"),
        "quality.watertight": _more("watertight", ""),
        "quality.components": _neutral("components", _COUNT),
        "quality.euler_number": _neutral("Euler number", _COUNT),
        "quality.verts": _neutral("vertices", _COUNT),
        "quality.faces": _neutral("faces", _COUNT),
    }
)
"""The metrics of a `Measurement`, by dotted name."""

METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        **MEASURED,
        "source.area": _neutral("area of the source", ".6g"),
        "source.verts": _neutral("vertices of the source", _COUNT),
        "source.faces": _neutral("faces of the source", _COUNT),
    }
)
"""All metrics of a result: those of its measurement, and those of the source, which no seed affects."""

DEFAULT_METRIC = "hausdorff.symmetric"


def require_metric(name: str) -> None:
    """Refuse an unknown metric.

    Raises:
        ConfigError: there is no such metric; the message suggests the nearest.
    """
    if name not in METRICS:
        raise ConfigError(f"'{name}' is not a metric: {suggest(name, METRICS)}")
