"""A fit in the coordinates given, as the engines make it: nothing is normalised, aligned, or compared before it."""

import warnings
from typing import Any

import meshfit.fitting.fit
from meshfit.errors import MeshfitWarning
from meshfit.fitting.loop import FitResult

_COMPARED = (
    "source and target differ in topology|the target is open \\(|the points show an open surface|the bounding boxes of "
    "source|the (source|target) is .* times as large as|target: .* far off the others"
)


def fit(*args: Any, **keys: Any) -> FitResult:
    """Fit as `meshfit.fit` does, with no warnings of differences between source and target."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", _COMPARED, MeshfitWarning)
        return meshfit.fitting.fit.fit(*args, **{"normalise": "none", "align": "none"} | keys)
