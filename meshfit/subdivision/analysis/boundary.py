"""The surface at a vertex on the boundary: the eigenvalues around it."""

from dataclasses import dataclass

import numpy as np

from meshfit.errors import SchemeError
from meshfit.subdivision.analysis.bench import Bench
from meshfit.subdivision.analysis.local_matrix import MOST_RINGS, PAD
from meshfit.subdivision.analysis.matching import match_fan
from meshfit.subdivision.analysis.spectrum import TIE, eigenvalues


@dataclass(frozen=True)
class BoundaryPlace:
    """What a scheme does at a boundary vertex amid regular ones.

    Attributes:
        neighbours: of the vertex; one more than it has faces.
        moduli: of the three largest eigenvalues but the 1 of constants.
        curve: the eigenvalue of the boundary curve's tangent.
    """

    neighbours: int
    moduli: tuple[float, float, float]
    curve: float

    @property
    def in_order(self) -> bool:
        """Whether two eigenvalues lead, and the curve's is one of them: the tangent plane then holds its tangent."""
        first, second, third = self.moduli
        leads = min(abs(self.curve - first), abs(self.curve - second)) <= TIE
        return leads and first < 1 - TIE and second - third > TIE * second


def study_boundary(bench: Bench, steps: int, dilation: int, rings: int, neighbours: int) -> BoundaryPlace:
    """Look at boundary verts of so many neighbours.

    Args:
        bench: with fans.
        steps: of the scheme, that make one scalar dilation.
        dilation: fine edges along a coarse one after so many steps.
        rings: how many decide on the surface around the vertex.
        neighbours: 2 or more.

    Raises:
        SchemeError: no number of rings follows from itself, or there are no such verts.
    """
    if bench.fan is None or neighbours < 2:
        raise SchemeError(f"{bench.name} have no boundary verts of {neighbours} neighbours to analyse: 2 or more is")
    for number in range(rings, MOST_RINGS + 1):
        fan = bench.fan(neighbours, number + PAD)
        finer = fan.refine(steps)
        inside = fan.ring <= number
        rows = finer.rows(match_fan(fan, finer.topology, fan.locate(steps), number)[inside])
        if not rows[:, ~inside].any():
            found = eigenvalues(rows[:, inside].astype(np.complex128))
            others = np.delete(found, int(np.argmin(np.abs(found - 1))))
            first, second, third, *_ = np.append(np.abs(others), np.zeros(3)).tolist()
            return BoundaryPlace(neighbours, (first, second, third), 1 / dilation)
    raise SchemeError(f"this scheme cannot be analysed: {MOST_RINGS} rings at a boundary do not follow from them")
