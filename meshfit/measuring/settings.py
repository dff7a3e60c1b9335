"""Settings of the measurement."""

import json
import math
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field, ValidationError, WrapValidator

from meshfit.mesh.cleaning_options import Surface
from meshfit.settings import Settings

TAU_OF_FILES = "0.5%"
"""The distance of the F-scores of meshes in a unit of their own, where none is given."""

LENGTH_OR_SHARE = "a number above 0, or N% of the target's diagonal"
"""The allowed values of a length, in words."""


def share_of_diagonal(text: str) -> float | None:
    """Return the number of a text such as `0.5%`, as a fraction; None if it is none, or not above 0."""
    try:
        share = float(text.strip().removesuffix("%")) / 100
    except ValueError:
        return None
    return share if text.strip().endswith("%") and 0 < share < math.inf else None


def _length_or_share(value: Any, validate: Callable[[Any], Any]) -> Any:  # noqa: ANN401  any YAML value
    """Report one error in place of one for each of the two types."""
    try:
        checked = validate(value)
    except ValidationError:
        checked = ""
    if isinstance(checked, str) and share_of_diagonal(checked) is None:
        raise ValueError(f"expected {LENGTH_OR_SHARE}, got {json.dumps(value, default=str)}")
    return checked


Length = Annotated[Annotated[float, Field(gt=0)] | Annotated[str, Field(pattern="%$")], WrapValidator(_length_or_share)]
"""A length in the frame of the vertices, or `N%` of the diagonal of the target's bounding box."""


class MeasureSettings(Settings):
    """Settings of the measurement; lengths are in the frame of both meshes.

    Example:
        >>> import meshfit
        >>> settings = meshfit.MeasureSettings(samples=1000, points=1000, f_score_tau=0.2)
        >>> meshfit.measure("cube", "cube", settings).f_score.f1
        1.0
    """

    surface: Surface = "all"
    """Surfaces that distances, scores and creases are between: `all` of both meshes, or what can be seen of them from
    outside, `outer`, so that parts hidden inside others do not count. Mesh quality is that of the whole result."""
    samples: Annotated[int, Field(ge=100)] = 200_000
    """Number of area-uniform points, 100 or more, on each surface for the Hausdorff, mean and RMS distances; the
    Hausdorff distance uses all vertices and edge midpoints as well."""
    points: Annotated[int, Field(ge=100)] = 30_000
    """Number of area-uniform points, 100 or more, on each surface for chamfer, F-score and normal consistency, and
    on the creases of each for the edge scores."""
    f_score_tau: Length = 0.01
    """Distance, above 0, within which a point counts as matched in the F-score and the edge scores; `N%` is of the
    diagonal of the target's bounding box."""
    crease_angle: Annotated[float, Field(gt=0, lt=180)] = 30.0
    """Least angle in degrees, above 0 and below 180, between the normals of the two faces of an edge that counts as a
    crease in the edge scores."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the points, the same for all trials, so that equal results measure the same."""

    def tau(self, diagonal: float) -> float:
        """Return the distance of the F-scores.

        Args:
            diagonal: of the target's bounding box.
        """
        share = share_of_diagonal(self.f_score_tau) if isinstance(self.f_score_tau, str) else None
        return float(self.f_score_tau) if share is None else share * diagonal
