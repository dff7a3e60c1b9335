"""Spheres: solids refined level by level, with every vertex projected onto the sphere."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float64
from scipy.sparse import csr_array

from meshfit.doors import no_type_check
from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.normalisation import placed
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import icosahedron
from meshfit.mesh.topology import Topology
from meshfit.printable import value_text
from meshfit.subdivision.refine import Refinement, refine
from meshfit.subdivision.registry import Scheme
from meshfit.subdivision.triangles.scheme import MIDPOINT

MAX_LEVEL = 8


@no_type_check
def icosphere(level: int = 4) -> Mesh:
    """Return the unit sphere as an icosahedron whose edges are halved, and whose vertices are projected, some times.

    Args:
        level: 0 to 8; a level has 10 · 4^level + 2 vertices, 2,562 at level 4.

    Example:
        >>> import meshfit
        >>> meshfit.icosphere(2)
        Mesh(162 verts, 320 faces, box 2 × 2 × 2)

    Raises:
        MeshError: another level.
    """
    if isinstance(level, bool) or not isinstance(level, int) or not 0 <= level <= MAX_LEVEL:
        raise MeshError(f"level: expected an integer from 0 to {MAX_LEVEL}, got {value_text(level)}")
    sphere = refined_sphere(MIDPOINT, level)
    assert isinstance(sphere, Mesh)  # noqa: S101  of a scheme on triangles
    return sphere


def refined_sphere(scheme: Scheme, levels: int, radius: float = 1.0) -> Mesh | PolygonMesh:
    """Return a sphere about the origin whose vertices are those of an icosahedron, refined by a scheme."""
    solid = icosahedron()
    refinement = refine(Topology.of(solid), scheme, levels)
    verts = refined_on_sphere(placed(solid.verts, radius), refinement.operators)
    return Mesh(verts, refinement.faces) if isinstance(refinement, Refinement) else refinement.mesh(verts)


def refined_on_sphere(verts: Verts, operators: Iterable[csr_array]) -> Float64[np.ndarray, "W 3"]:
    """Refine vertices level by level, and project them onto a sphere before the first level and after each.

    The sphere is centred at the mean of the vertices and passes through the farthest of them.
    """
    centre = verts.mean(axis=0)
    radius = np.linalg.norm(verts - centre, axis=1).max()

    def projected(verts: Verts) -> Verts:
        offset = verts - centre
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        return np.asarray(centre + offset * (radius / length))

    refined = projected(verts)
    for operator in operators:
        refined = projected(operator @ refined)
    return refined
