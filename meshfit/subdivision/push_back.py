"""Push-back: what smoothing does to old vertices is taken back by a share α, and new vertices follow them."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
