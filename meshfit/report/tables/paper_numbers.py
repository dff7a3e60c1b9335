"""Table 1 of the paper: Hausdorff distances as published, and two ways of reading them."""

from collections.abc import Mapping
from types import MappingProxyType

PAPER_METRIC = "hausdorff.symmetric"
"""The metric that the paper's numbers are shown with; the paper does not say which Hausdorff distance they are."""
PAPER_TARGETS = ("bunny", "mousehead")

_CELLS = {
    "by column": (("bunny", "loop"), ("bunny", "interp-loop"), ("mousehead", "loop"), ("mousehead", "interp-loop")),
    "by row": (("bunny", "loop"), ("mousehead", "loop"), ("bunny", "interp-loop"), ("mousehead", "interp-loop")),
}
# Only a flat list of the numbers is known, so the cells of the two in the middle are uncertain.
_PUBLISHED = (0.025621, 0.035352, 0.07518, 0.013013)

LIKELIER = "by column"
OTHER = "by row"
READINGS: Mapping[str, Mapping[tuple[str, str], float]] = MappingProxyType(
    {reading: MappingProxyType(dict(zip(cells, _PUBLISHED, strict=True))) for reading, cells in _CELLS.items()}
)


def paper_value(target: str, scheme: str, reading: str = LIKELIER) -> float | None:
    """Return the paper's number for a target and a scheme; None if there is none, as for schemes with parameters."""
    return READINGS[reading].get((target, scheme))


def published_value(metric: str, target: str, scheme: str) -> float | None:
    """Return the paper's number to show with a metric; None if there is none, or for other metrics."""
    return paper_value(target, scheme) if metric == PAPER_METRIC else None
