"""The paper's Table 1: Hausdorff distances, as published, and the two ways of reading them."""

from collections.abc import Mapping
from types import MappingProxyType

PAPER_METRIC = "hausdorff.symmetric"
"""The metric that the paper's numbers stand beside; which Hausdorff distance they are, the paper does not say."""
PAPER_TARGETS = ("bunny", "mousehead")

_CELLS = {
    "by column": (("bunny", "loop"), ("bunny", "interp-loop"), ("mousehead", "loop"), ("mousehead", "interp-loop")),
    "by row": (("bunny", "loop"), ("mousehead", "loop"), ("bunny", "interp-loop"), ("mousehead", "interp-loop")),
}
# The table reaches us as a flat list of numbers, so which cell the two in the middle belong to is not certain.
_PUBLISHED = (0.025621, 0.035352, 0.07518, 0.013013)

LIKELIER = "by column"
OTHER = "by row"
READINGS: Mapping[str, Mapping[tuple[str, str], float]] = MappingProxyType(
    {reading: MappingProxyType(dict(zip(cells, _PUBLISHED, strict=True))) for reading, cells in _CELLS.items()}
)


def paper_value(target: str, scheme: str, reading: str = LIKELIER) -> float | None:
    """The paper's number for a target and a scheme, or None if it has none.

    Only the scheme as the paper has it counts: one with a parameter set, `interp-loop:alpha=0.5`, has no number.
    """
    return READINGS[reading].get((target, scheme))


def value_beside(metric: str, target: str, scheme: str) -> float | None:
    """The paper's number, where it has one, and the metric is the one that it may stand beside."""
    return paper_value(target, scheme) if metric == PAPER_METRIC else None
