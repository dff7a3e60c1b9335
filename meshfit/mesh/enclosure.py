"""Space that a surface encloses for balls of some radius, which pass only through openings wider than they are."""

import numpy as np

from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.sampling import sample_surface

# Cells per radius, fewer where they are more than so many, but not below the third number; samples of the surface per
# cell that it passes through, and the most samples.
_FINE, _MOST_CELLS, _COARSE = 6.0, 1_000_000, 2.5
_DENSE, _MOST_SAMPLES = 4.0, 2_000_000


def enclosed_volume(mesh: Mesh, radius: float) -> float:
    """Return the volume that no ball of a radius reaches from far away without touching the surface, on a grid.

    Args:
        mesh: faces of any kind; openings narrower than the balls count as closed.
        radius: of the balls.
    """
    from scipy import ndimage  # planning does without it

    box = float(np.prod(np.ptp(mesh.verts, axis=0) + 2 * radius))
    fine = float(np.clip(radius * (_MOST_CELLS / box) ** (1 / 3), _COARSE, _FINE))
    cell = radius / fine
    count = min(_MOST_SAMPLES, int(_DENSE * float(face_areas(mesh).sum()) / cell**2) + 1)
    points = np.concatenate([mesh.verts, sample_surface(mesh, count, np.random.default_rng(0)).points])
    low, margin = points.min(axis=0), int(fine) + 3
    cells = ((points - low) / cell).astype(np.int64) + margin
    free = np.ones(cells.max(axis=0) + margin + 1, dtype=bool)
    free[tuple(cells.T)] = False
    centres = ndimage.distance_transform_edt(free) > fine
    labels = ndimage.label(centres)[0]
    reached = ndimage.distance_transform_edt(labels != labels[0, 0, 0]) <= fine
    return float((~reached).sum()) * cell**3
