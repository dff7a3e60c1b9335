"""The characteristic map: the limit of the planar net around an odd place whose coordinates are eigenvectors of λ1.

The surface there is C1 if λ1 leads and this map is regular and injective (Reif 1995).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128

from meshfit.mesh.polygon_topology import PolygonTopology
from meshfit.subdivision.analysis.bench import Wheel
from meshfit.subdivision.analysis.local_matrix import PAD, LocalMatrix

_REFINED = 8
_FLAT = 1e-9


def characteristic_net(matrix: LocalMatrix, wheel: Wheel) -> Complex128[np.ndarray, " V"]:
    """(V,) the control net of the map on a wheel, vertex 1 at 1 unless it is at 0; nan outside the matrix's rings."""
    values, vectors = np.linalg.eig(matrix.block(1))
    vector = vectors[:, np.argmax(np.abs(values))]
    spoke = vector[0] or 1.0
    turn = np.exp(2j * np.pi * np.arange(matrix.valence) / matrix.valence)
    net = np.full(len(wheel.places), np.nan, dtype=np.complex128)
    net[: int(wheel.hub)] = 0
    net[wheel.turns[wheel.ring <= matrix.rings]] = (vector / spoke)[:, None] * turn
    return net


def is_regular(wheel_of: Callable[[int], Wheel], matrix: LocalMatrix, steps: int, dilation: int) -> bool:
    """Whether the map keeps the orientation of every face, and of every corner in it, once it is refined some times.

    Args:
        wheel_of: number of rings → a wheel.
        matrix: the local matrix, of one ring more than the surface around the centre depends on.
        steps: of the scheme, that make one scalar dilation.
        dilation: fine edges along a coarse one after so many steps.
    """
    wheel = wheel_of(matrix.rings + PAD)
    net = characteristic_net(matrix, wheel)
    levels = steps * max(1, round(np.log(_REFINED) / np.log(dilation)))
    finer = wheel.refine(levels)
    corners = corner_turns(finer.topology, finer.carry(net))
    return bool((corners[np.isfinite(corners)] > _FLAT).all())


def corner_turns(topology: PolygonTopology, places: Complex128[np.ndarray, " V"]) -> np.ndarray:
    """(C,) the sine of the angle at the head of each half-edge, from it to the one that follows; nan off the net."""
    along = places[topology.head] - places[topology.tail]
    onward = along[topology.following(np.arange(len(along)))]
    size = np.abs(along) * np.abs(onward)
    return np.asarray(np.divide((along.conj() * onward).imag, size, out=np.full(len(size), -1.0), where=size != 0))
