"""Problems of all kinds and sizes for the tests of batches, and the bytes by which outcomes are compared."""

import numpy as np

from meshfit.fitting.loop import FitResult
from meshfit.fitting.problem import Diverged, Problem
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron, octahedron, tetrahedron
from tests.fits import fit
from tests.shapes import mixed_closed, mixed_open, patch

TRIANGLE = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
LOOSE = Mesh(np.concatenate([mixed_open(5).verts, [[7.0, 8.0, 9.0]]]), mixed_open(5).faces)
BOOK = Mesh(np.concatenate([np.eye(3), [[0, 0, 0], [1, 1, 1]]]), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
FLAT = Mesh(0.3 * patch(4, 3).verts, patch(4, 3).faces)

PROBLEMS = [
    Problem(mixed_closed(), cube(), seed=4),
    Problem(TRIANGLE, octahedron(), seed=1),
    Problem(mixed_open(), FLAT, seed=2**40),
    Problem(FLAT, mixed_closed(7), seed=0),
    Problem(LOOSE, TRIANGLE, seed=3),
    Problem(BOOK, LOOSE, seed=1),
    Problem(icosahedron(), cube(), seed=4),
]
"""Closed, open, flat and not manifold; with a vertex of no face, and with no two faces at an edge."""

# At an edge term of weight 8 coarse sources fall into oscillations that grow until they are out of range.
SHAKY = {"losses": {"edge": 8.0}, "steps": 14}
LATE = [Problem(TRIANGLE, cube(), seed=5), Problem(tetrahedron(), mixed_closed(), seed=6)]
FAR = Problem(icosahedron(), Mesh(np.where([True, False, False], 1e30, cube().verts), cube().faces), seed=7)
OUTSIDE = Problem(Mesh(1e12 * cube().verts, cube().faces), cube(), seed=8)


def bytes_of(outcome: FitResult | Diverged) -> tuple[object, ...]:
    """Everything that must not depend on the rest of the batch."""
    if isinstance(outcome, Diverged):
        return (outcome.step, outcome.term, outcome.last_good.verts.tobytes(), outcome.trace.to_csv())
    return (outcome.mesh.verts.tobytes(), outcome.mesh.faces.tobytes(), outcome.trace.to_csv(), outcome.device)


def alone(problem: Problem, **changes: object) -> FitResult | Diverged:
    """Return the outcome of a problem fitted alone."""
    given = dict(vars(problem))
    polygons, source, _ = given.pop("polygons"), given.pop("source"), given.pop("own")
    try:
        return fit(polygons or source, **given, **changes)
    except Diverged as diverged:
        return diverged
