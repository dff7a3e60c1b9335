"""The bend between neighbouring faces."""

from jaxtyping import Float
from torch import Tensor

from meshfit.loss.surface import FaceGeometry, Surface


def consistency(faces: FaceGeometry, surface: Surface) -> Float[Tensor, ""]:
    """Mean over pairs of faces with a common edge of 1 - cos of the angle between their normals; 0 on a plane.

    It is 0, too, where no two faces have a common edge.
    """
    one, other = surface.face_pairs
    cosine = (faces.normals.index_select(0, one) * faces.normals.index_select(0, other)).sum(1)
    return (1 - surface.pair_sign * cosine).sum() / max(len(cosine), 1)
