"""New defects: faces that cross, fold over or lost their area in a result, and did not in its source."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from meshfit.measuring.quality import degenerate_faces, flipped_faces
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology


@dataclass(frozen=True)
class NewDefects:
    """Defects of a result that its source, with the same faces, does not have.

    Attributes:
        crossing_pairs: pairs of faces that cross, and do not in the source.
        crossing_faces: faces in such pairs.
        flipped_faces: see `flipped_faces` of a mesh's quality.
        degenerate_faces: see `degenerate_faces` of a mesh's quality.
    """

    crossing_pairs: int
    crossing_faces: int
    flipped_faces: int
    degenerate_faces: int


def new_defects(source: Mesh, result: Mesh) -> NewDefects:
    """Count the defects of a result that its source, with the same faces, does not have."""
    topology = Topology.of(result)
    count = result.num_faces
    before, after = (pairs @ np.array([count, 1]) for pairs in map(crossing_pairs, (source, result)))
    new = np.setdiff1d(after, before)
    flipped = flipped_faces(result, topology) & ~flipped_faces(source, topology)
    degenerate = degenerate_faces(result) & ~degenerate_faces(source)
    return NewDefects(
        crossing_pairs=len(new),
        crossing_faces=len(np.unique(np.concatenate([new // count, new % count]))),
        flipped_faces=int(flipped.sum()),
        degenerate_faces=int(degenerate.sum()),
    )


def crossing_pairs(mesh: Mesh) -> Int64[np.ndarray, "P 2"]:
    """Return (P, 2) pairs of faces that cross, the lower first."""
    import torch  # measurements without a source do without it

    from meshfit.remeshing.self_intersections import intersecting_pairs

    return intersecting_pairs(torch.tensor(mesh.verts), torch.tensor(mesh.faces)).numpy()
