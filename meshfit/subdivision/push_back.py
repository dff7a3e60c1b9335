"""Push-back operators: old vertices get back a share α of their displacement, and new vertices follow them."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, eye_array

from meshfit.subdivision.scheme import BaseScheme

S = TypeVar("S", bound=BaseScheme)


def push_back(
    alpha: float | NDArray[np.float64], linear: csr_array, even: csr_array, odd: csr_array
) -> tuple[csr_array, csr_array]:
    """Return E + αD and O + M αD, with the displacement D = I - E.

    Args:
        alpha: one value, or one for each vertex.
        linear: M, (N, V) linear interpolation of the new vertices.
        even: E, (V, V) the rule of the old vertices.
        odd: O, (N, V) that of the new ones.
    """
    num_verts = even.shape[1]
    alphas = np.broadcast_to(np.asarray(alpha, dtype=np.float64), (num_verts,))
    displacement = diags_array(alphas) @ (eye_array(num_verts, format="csr") - even)
    return csr_array(even + displacement), csr_array(odd + linear @ displacement)


def carry_alpha(scheme: S, linear: Callable[[], csr_array]) -> S:
    """Return the scheme for the next level, where an α for each vertex is interpolated linearly.

    Args:
        scheme: of this level.
        linear: makes the (V + N, V) operator of linear interpolation; called only if α differs by vertex.
    """
    if scheme.alpha is None or not np.ndim(scheme.alpha):
        return scheme
    return scheme.with_alpha(linear() @ np.asarray(scheme.alpha))
