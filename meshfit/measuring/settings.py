"""What a measurement takes its figures from."""

from typing import Annotated

from pydantic import Field

from meshfit.settings import Settings


class MeasureSettings(Settings):
    """How a result is measured against its target; lengths are in the frame that both meshes are given in."""

    samples: Annotated[int, Field(ge=100)] = 200_000
    """Area-uniform points on each surface for the Hausdorff, mean and RMS distances.
    The Hausdorff distance takes all verts and edge midpoints as well."""
    points: Annotated[int, Field(ge=100)] = 30_000
    """Area-uniform points on each surface for chamfer, F-score and normal consistency."""
    f_score_tau: Annotated[float, Field(gt=0)] = 0.01
    """The distance within which a point counts as matched in the F-score."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the points; the same for every trial, so that one result always gets the same figures."""
