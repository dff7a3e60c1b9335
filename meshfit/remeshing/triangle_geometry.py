"""The shape of triangles: normals and smallest angles."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor


def dot(a: Float[Tensor, "N 3"], b: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Inner products of rows."""
    products = a * b
    return products[:, 0] + products[:, 1] + products[:, 2]


def length_of(vectors: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Lengths of rows."""
    return dot(vectors, vectors).sqrt()


def unit(vectors: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Rows over their lengths; 0 stays 0."""
    return vectors / length_of(vectors).clamp_min(torch.finfo(vectors.dtype).tiny)[:, None]


def corners_of(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """Three times (F, 3), the positions of the corners."""
    first, second, third = (verts.index_select(0, faces[:, k]) for k in range(3))
    return first, second, third


def area_vectors(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> Float[Tensor, "F 3"]:
    """Vectors across the faces, as long as twice their areas."""
    a, b, c = corners_of(verts, faces)
    across: Tensor = torch.linalg.cross(b - a, c - a)
    return across


def turned_over(on_sphere: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], least: float = 0.0) -> Bool[Tensor, " F"]:
    """Which faces of verts on a sphere are seen from outside the wrong way round, or are needles.

    Args:
        on_sphere: (V, 3) unit vectors.
        faces: (F, 3) vertex indices.
        least: six times the volume below a face, over its longest side squared, that it has to exceed.
    """
    a, b, c = corners_of(on_sphere, faces)
    volume = dot(torch.linalg.cross(a, b), c)
    if not least:
        return ~(volume > 0)
    longest = torch.stack([dot(side, side) for side in (b - a, c - b, a - c)]).amax(0)
    return ~(volume > least * longest)


def normal_and_sine(
    a: Float[Tensor, "N 3"], b: Float[Tensor, "N 3"], c: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
    """The unit normals, 0 without area, and the sines of the smallest angles of triangles.

    The smallest angle lies across from the shortest side, so that its sine is the double area over the two others.
    """
    tiny = torch.finfo(a.dtype).tiny
    ab, bc, ca = b - a, c - b, a - c
    across = torch.linalg.cross(ab, bc)
    double_area = length_of(across)
    p, q, r = (length_of(side) for side in (ab, bc, ca))
    shortest = torch.minimum(torch.minimum(p, q), r)
    return across / double_area.clamp_min(tiny)[:, None], double_area * shortest / (p * q * r).clamp_min(tiny)
