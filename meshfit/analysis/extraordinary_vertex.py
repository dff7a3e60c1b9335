"""Smoothness at an extraordinary vertex, or face for dual schemes, and at a vertex on the boundary.

The characteristic map is the limit of the planar net around the vertex whose coordinates are eigenvectors of λ1. The
surface there is C1 if λ1 leads and this map is regular and injective (Reif 1995).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Complex128
from scipy.optimize import brentq

from meshfit.analysis.local_matrix import MOST_RINGS, PAD, LocalMatrix, invariant_matrix, map_fan
from meshfit.analysis.regular_lattice import RegularMask
from meshfit.analysis.spectrum import TIE, Spectrum, eigenvalues, spectrum_of
from meshfit.analysis.stencil_meshes import StencilMeshes, Wheel, stencil_meshes
from meshfit.errors import SchemeError
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.registry import Scheme

_REFINED = 8  # fine edges along a coarse one, at least about, where the orientation of the map is tested
_FLAT = 1e-9
_ROUNDING = 1e-9
_EXACT = 1e-9
_FEWEST_SPOKES = 3


def characteristic_net(matrix: LocalMatrix, wheel: Wheel) -> Complex128[np.ndarray, " V"]:
    """Return the (V,) control net of the map on a wheel, with vertex 1 at 1; nan outside the matrix's rings."""
    values, vectors = np.linalg.eig(matrix.block(1))
    vector = vectors[:, np.argmax(np.abs(values))]
    spoke = vector[0] or 1.0
    turn = np.exp(2j * np.pi * np.arange(matrix.valence) / matrix.valence)
    net = np.full(len(wheel.places), np.nan, dtype=np.complex128)
    net[: int(wheel.hub)] = 0
    net[wheel.turns[wheel.ring <= matrix.rings]] = (vector / spoke)[:, None] * turn
    return net


def is_regular(wheel_of: Callable[[int], Wheel], matrix: LocalMatrix, steps: int, dilation: int) -> bool:
    """Return whether the refined map keeps the orientation of every corner of every face.

    Args:
        wheel_of: number of rings → a wheel.
        matrix: the local matrix, with one ring more than the surface around the centre depends on.
        steps: levels of the scheme that make one scalar dilation.
        dilation: fine edges along a coarse one after these steps.
    """
    wheel = wheel_of(matrix.rings + PAD)
    net = characteristic_net(matrix, wheel)
    levels = steps * max(1, round(np.log(_REFINED) / np.log(dilation)))
    finer = wheel.refine(levels)
    corners = corner_turns(finer.topology, finer.carry(net))
    return bool((corners[np.isfinite(corners)] > _FLAT).all())


def corner_turns(topology: PolygonTopology, places: Complex128[np.ndarray, " V"]) -> np.ndarray:
    """Return the (C,) sine of the angle from each half-edge to the following one; nan off the net."""
    along = places[topology.head] - places[topology.tail]
    onward = along[topology.following(np.arange(len(along)))]
    size = np.abs(along) * np.abs(onward)
    return np.asarray(np.divide((along.conj() * onward).imag, size, out=np.full(len(size), -1.0), where=size != 0))


@dataclass(frozen=True)
class ExtraordinaryVertex:
    """A vertex (for dual schemes a face) of one valence among regular ones.

    Attributes:
        spectrum: the leading eigenvalues of the local matrix.
        rings: number of rings of the matrix.
        regular_map: whether the characteristic map keeps its orientation.
    """

    spectrum: Spectrum
    rings: int
    regular_map: bool

    @property
    def valence(self) -> int:
        """The number of edges, or of corners of a face."""
        return self.spectrum.valence

    @property
    def fault(self) -> str:
        """The reason why the surface is not C1 here, if it is C1 on regular meshes; empty where it is (Reif 1995)."""
        return self.spectrum.fault or ("" if self.regular_map else "the characteristic map folds")


def analyse_valence(meshes: StencilMeshes, mask: RegularMask, radius: float, valence: int) -> ExtraordinaryVertex:
    """Analyse one valence.

    Args:
        meshes: with wheels.
        mask: on the regular lattice.
        radius: of the basis function, in rings; so many rings determine the surface around the centre.
        valence: number of spokes, 3 or more.

    Raises:
        SchemeError: every number of rings depends on further rings.
    """
    wheel_of = wheels(meshes, valence)
    matrix = invariant_matrix(wheel_of, mask.steps, ceil(radius - _ROUNDING))
    wider = invariant_matrix(wheel_of, mask.steps, matrix.rings + 1)
    regular = is_regular(wheel_of, wider, mask.steps, mask.dilation)
    return ExtraordinaryVertex(spectrum_of(matrix), matrix.rings, regular)


def wheels(meshes: StencilMeshes, valence: int) -> Callable[[int], Wheel]:
    """Return the wheels of one valence: number of rings → wheel.

    Raises:
        SchemeError: the domain has no extraordinary vertices, or the valence is below 3.
    """
    make = meshes.wheel
    if make is None or valence < _FEWEST_SPOKES:
        raise SchemeError(
            f"{meshes.domain} have no extraordinary vertices of valence {valence}; 3 or more is allowed, on surfaces"
        )
    return lambda rings: make(valence, rings)


def largest_alpha(scheme: Scheme, steps: int, vertex: ExtraordinaryVertex) -> float | None:
    """Return the α at which another eigenvalue overtakes λ1, from α = 0 on; None if it never or already does.

    Args:
        scheme: as it is analysed, with its own α.
        steps: levels of the scheme that make one scalar dilation.
        vertex: its analysis at one valence.
    """
    if scheme.alpha is None or vertex.spectrum.gap > TIE * vertex.spectrum.leading.modulus:
        return None

    def gap(alpha: float) -> float:
        blend = scheme.with_alpha(alpha)
        matrix = invariant_matrix(wheels(stencil_meshes(blend), vertex.valence), steps, vertex.rings)
        return spectrum_of(matrix).gap

    given = float(scheme.alpha)
    if gap(0.0) <= TIE:
        return None
    return float(brentq(gap, 0.0, given, xtol=_EXACT)) if gap(given) < 0 else given


@dataclass(frozen=True)
class BoundaryVertex:
    """A vertex on the boundary among regular ones.

    Attributes:
        neighbours: number of neighbours, one more than faces.
        moduli: of the three largest eigenvalues besides the 1 of constants.
        curve: the eigenvalue of the boundary curve's tangent.
    """

    neighbours: int
    moduli: tuple[float, float, float]
    curve: float

    @property
    def in_order(self) -> bool:
        """Whether two eigenvalues lead, one of them the curve's, so that the tangent plane contains its tangent."""
        first, second, third = self.moduli
        leads = min(abs(self.curve - first), abs(self.curve - second)) <= TIE
        return leads and first < 1 - TIE and second - third > TIE * second


def analyse_boundary(meshes: StencilMeshes, steps: int, dilation: int, rings: int, neighbours: int) -> BoundaryVertex:
    """Analyse boundary vertices with some number of neighbours.

    Args:
        meshes: with fans.
        steps: levels of the scheme that make one scalar dilation.
        dilation: fine edges along a coarse one after these steps.
        rings: number of rings that determine the surface around the vertex.
        neighbours: 2 or more.

    Raises:
        SchemeError: every number of rings depends on further rings, or there are no such vertices.
    """
    if meshes.fan is None or neighbours < 2:
        raise SchemeError(f"{meshes.domain} have no boundary vertices of {neighbours} neighbours; 2 or more is allowed")
    for number in range(rings, MOST_RINGS + 1):
        fan = meshes.fan(neighbours, number + PAD)
        finer = fan.refine(steps)
        inside = fan.ring <= number
        rows = finer.rows(map_fan(fan, finer.topology, fan.locate(steps), number)[inside])
        if not rows[:, ~inside].any():
            values = eigenvalues(rows[:, inside].astype(np.complex128))
            others = np.delete(values, int(np.argmin(np.abs(values - 1))))
            first, second, third, *_ = np.append(np.abs(others), np.zeros(3)).tolist()
            return BoundaryVertex(neighbours, (first, second, third), 1 / dilation)
    raise SchemeError(f"this scheme cannot be analysed: {MOST_RINGS} rings at a boundary depend on further rings")
