"""Vectors, and the normals, areas and angles of triangles."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor


def dot(a: Float[Tensor, "N 3"], b: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Return inner products of rows, rounded the same for every row."""
    products = a * b
    return products[:, 0] + products[:, 1] + products[:, 2]


def length_of(vectors: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Return lengths of rows."""
    return dot(vectors, vectors).sqrt()


def unit(vectors: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Return rows divided by their lengths; 0 stays 0."""
    return vectors / length_of(vectors).clamp_min(torch.finfo(vectors.dtype).tiny)[:, None]


def corners_of(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """Return three (F, 3) tensors, the positions of the corners."""
    first, second, third = (verts.index_select(0, faces[:, k]) for k in range(3))
    return first, second, third


def double_area_vectors(verts: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> Float[Tensor, "F 3"]:
    """Return normal vectors of the faces, of twice their area as length."""
    a, b, c = corners_of(verts, faces)
    vectors: Tensor = torch.linalg.cross(b - a, c - a)
    return vectors


def turned_over(on_sphere: Float[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], least: float = 0.0) -> Bool[Tensor, " F"]:
    """Return which faces on a sphere are turned over, seen from outside, or are needles.

    Args:
        on_sphere: (V, 3) unit vectors.
        faces: (F, 3) vertex indices.
        least: least six-fold volume below a face over its longest side squared.
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
    """Return the unit normals of triangles, 0 without area, and the sines of their smallest angles.

    The smallest angle is opposite the shortest side; its sine is the double area over the product of the other two.
    """
    tiny = torch.finfo(a.dtype).tiny
    ab, bc, ca = b - a, c - b, a - c
    across = torch.linalg.cross(ab, bc)
    double_area = length_of(across)
    p, q, r = (length_of(side) for side in (ab, bc, ca))
    shortest = torch.minimum(torch.minimum(p, q), r)
    return across / double_area.clamp_min(tiny)[:, None], double_area * shortest / (p * q * r).clamp_min(tiny)
