"""Settings of the measurement."""

from typing import Annotated

from pydantic import Field

from meshfit.settings import Settings


class MeasureSettings(Settings):
    """Settings of the measurement; lengths are in the frame of both meshes.

    Example:
        >>> import meshfit
        >>> settings = meshfit.MeasureSettings(samples=1000, points=1000, f_score_tau=0.2)
        >>> meshfit.measure("cube", "cube", settings).f_score.f1
        1.0
    """

    samples: Annotated[int, Field(ge=100)] = 200_000
    """Number of area-uniform points, 100 or more, on each surface for the Hausdorff, mean and RMS distances; the
    Hausdorff distance uses all vertices and edge midpoints as well."""
    points: Annotated[int, Field(ge=100)] = 30_000
    """Number of area-uniform points, 100 or more, on each surface for chamfer, F-score and normal consistency, and
    on the creases of each for the edge scores."""
    f_score_tau: Annotated[float, Field(gt=0)] = 0.01
    """Distance, above 0, within which a point counts as matched in the F-score and the edge scores."""
    crease_angle: Annotated[float, Field(gt=0, lt=180)] = 30.0
    """Least angle in degrees, above 0 and below 180, between the normals of the two faces of an edge that counts as a
    crease in the edge scores."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the points, the same for all trials, so that equal results measure the same."""
