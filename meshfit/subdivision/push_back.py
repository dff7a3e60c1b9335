"""Push-back: what smoothing does to old vertices is taken back by a share α, and new vertices follow them."""

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.triangles.scheme import TriangleScheme

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Scheme = TypeVar("_Scheme", TriangleScheme, PolygonScheme, CurveScheme)


def pushed_back(
    alpha: "float | NDArray[np.float64]", between: csr_array, even: csr_array, odd: csr_array
) -> tuple[csr_array, csr_array]:
    """E + αD and O + M αD, with the displacement D = I - E.

    Args:
        alpha: one value, or one for each vertex.
        between: M, (N, V) linear interpolation of the new vertices.
        even: E, (V, V) the rule of the old vertices.
        odd: O, (N, V) that of the new ones.
    """
    num_verts = even.shape[1]
    alphas = np.broadcast_to(np.asarray(alpha, dtype=np.float64), (num_verts,))
    displacement = diags_array(alphas) @ (eye_array(num_verts, format="csr") - even)
    return csr_array(even + displacement), csr_array(odd + between @ displacement)


def with_carried_alpha(scheme: _Scheme, carry: Callable[[], csr_array]) -> _Scheme:
    """The scheme for the next level: one α for all is the same there, one for each vertex goes with the vertices.

    Args:
        scheme: of this level.
        carry: makes the (V + N, V) operator that takes values at the vertices to the next level; asked if it is needed.
    """
    if scheme.push_back is None or not np.ndim(scheme.push_back.alpha):
        return scheme
    return scheme.with_alpha(carry() @ np.asarray(scheme.push_back.alpha))
