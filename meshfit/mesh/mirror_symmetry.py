"""Mirror symmetry of a mesh: the plane, and the vertex that is the mirror image of each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.errors import MeshError
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.nearest import Points, nearest_point_query
from meshfit.mesh.topology import Indices
from meshfit.units import count_text

TOLERANCE = 0.02
"""Largest distance from a vertex's mirror image to its partner, as a share of the diagonal."""
_ITERATIONS, _DIRECTIONS, _SAME = 100, 24, 1e-6


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """The plane of the points x with normal · x = offset."""

    normal: Float64[np.ndarray, "3"]
    offset: float

    @classmethod
    def between(cls, points: Points, images: Points) -> "MirrorPlane":
        """Return the plane in which points are, by least squares, the mirror images of others.

        Its normal n minimises the sum of |(I - 2 n nᵀ) u - w|² over the pairs (u, w) of points about their means: it
        is the eigenvector to the smallest eigenvalue of the sum of u wᵀ + w uᵀ.

        Args:
            points: (N, 3).
            images: (N, 3) where the mirror image of each should be.
        """
        centre, goal = points.mean(axis=0), images.mean(axis=0)
        products = (points - centre).T @ (images - goal)
        normal = np.linalg.eigh(products + products.T)[1][:, 0]
        return cls(normal, float(normal @ (centre + goal)) / 2)

    def reflected(self, points: Points) -> Points:
        """Return (N, 3) points mirrored in the plane."""
        return np.asarray(points - 2.0 * (points @ self.normal - self.offset)[:, None] * self.normal)


def symmetrised(verts: Verts, partner: Int64[np.ndarray, " V"], plane: MirrorPlane | None = None) -> Verts:
    """Return the positions nearest to (V, 3) vertices at which each is the mirror image of its partner.

    Args:
        verts: (V, 3).
        partner: (V,) as `mirror_partners` returns them.
        plane: of the mirror; that in which the vertices are nearest to it if None.
    """
    plane = plane or MirrorPlane.between(verts, verts[partner])
    return np.asarray((verts + plane.reflected(verts[partner])) / 2)


def mirror_partners(mesh: Mesh) -> Int64[np.ndarray, " V"]:
    """Return the vertex that is the mirror image of each; of a vertex on the plane, itself.

    The plane is looked for by iterated closest points between the vertices and their mirror images, from planes across
    the principal axes and, where these lead nowhere, from planes in all directions. Of several, that across the x axis
    is taken, or the nearest to it.

    Raises:
        MeshError: some vertex has no partner to within `TOLERANCE` of the diagonal.
    """
    verts = mesh.verts
    diagonal = float(np.linalg.norm(np.ptp(verts, axis=0)))
    nearest = nearest_point_query(verts)
    offsets = verts - verts.mean(axis=0)
    found: list[_Symmetry] = []
    for normals in (np.linalg.eigh(offsets.T @ offsets)[1].T, _directions()):
        found += [_Symmetry.settled(verts, nearest, normal, TOLERANCE * diagonal) for normal in normals]
        if not min(each.unpaired.sum() for each in found):
            break
    best = min(found, key=lambda each: (int(each.unpaired.sum()), each.gap))
    if best.unpaired.any():
        raise MeshError(best.describe_unpaired(verts, diagonal))
    equal = [each for each in found if not each.unpaired.any() and each.gap <= best.gap + _SAME * diagonal]
    return max(equal, key=lambda each: abs(float(each.plane.normal[0]))).partner


@dataclass(frozen=True, eq=False)
class _Symmetry:
    """A plane, and the pairs that it makes.

    Attributes:
        plane: the plane.
        partner: (V,) the vertex nearest to the mirror image of each.
        unpaired: (V,) vertices whose partner has another partner, or is too far away.
        gap: largest distance between a mirror image and its partner.
    """

    plane: MirrorPlane
    partner: Indices
    unpaired: np.ndarray
    gap: float

    @classmethod
    def settled(
        cls, verts: Verts, nearest: Callable[[Points], Indices], normal: Float64[np.ndarray, "3"], farthest: float
    ) -> "_Symmetry":
        """Return the plane on which iterated closest points settle."""
        plane, partner = MirrorPlane(normal, float(normal @ verts.mean(axis=0))), np.arange(0)
        for _ in range(_ITERATIONS):
            before, partner = partner, nearest(plane.reflected(verts))
            if np.array_equal(before, partner):
                break
            plane = MirrorPlane.between(verts, verts[partner])
        gaps = np.linalg.norm(plane.reflected(verts) - verts[partner], axis=1)
        unpaired = (partner[partner] != np.arange(len(verts))) | (gaps > farthest)
        return cls(plane, partner, unpaired, float(gaps.max()))

    def describe_unpaired(self, verts: Verts, diagonal: float) -> str:
        gaps = np.linalg.norm(self.plane.reflected(verts) - verts[self.partner], axis=1)
        worst = int(np.argmax(np.where(self.unpaired, gaps, -1.0)))
        place = ", ".join(f"{value:.4g}" for value in verts[worst])
        return (
            f"not mirror-symmetric: {int(self.unpaired.sum()):,} of {count_text(len(verts), 'vertex')} have no partner "
            f"on the other side; the mirror image of vertex {worst} at ({place}) is {100 * gaps[worst] / diagonal:.2g} "
            f"% of the diagonal away from the nearest vertex, and at most {100 * TOLERANCE:.2g} % and one to one is "
            "allowed"
        )


def _directions() -> Float64[np.ndarray, "D 3"]:
    """Return unit vectors spread over half of a sphere, along a spiral."""
    number = np.arange(_DIRECTIONS)
    height = (number + 0.5) / _DIRECTIONS
    angle, radius = number * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
