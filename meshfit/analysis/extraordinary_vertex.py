"""The characteristic map: the limit of the planar net around an odd place whose coordinates are eigenvectors of λ1.

The surface there is C1 if λ1 leads and this map is regular and injective (Reif 1995).
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


_ROUNDING = 1e-9
_LEAST = 3


@dataclass(frozen=True)
class ExtraordinaryVertex:
    """What a scheme does at a vertex, or for dual schemes a face, of one valence amid regular ones.

    Attributes:
        spectrum: the leading eigenvalues of the local matrix.
        rings: how many rings the matrix is over.
        regular_map: whether the characteristic map keeps its orientation.
    """

    spectrum: Spectrum
    rings: int
    regular_map: bool

    @property
    def valence(self) -> int:
        """The number of edges, or of corners."""
        return self.spectrum.valence

    @property
    def fault(self) -> str:
        """Why the surface is not C1 here, where it is on regular meshes; empty where it is (Reif 1995)."""
        return self.spectrum.fault or ("" if self.regular_map else "the characteristic map folds")


def analyse_valence(meshes: StencilMeshes, mask: RegularMask, radius: float, valence: int) -> ExtraordinaryVertex:
    """Look at one valence.

    Args:
        meshes: with wheels.
        mask: on its regular lattice.
        radius: of the basis function, in rings: so many rings decide on the surface around the centre.
        valence: number of spokes, 3 or more.

    Raises:
        SchemeError: no number of rings follows from itself.
    """
    wheel_of = wheels(meshes, valence)
    matrix = invariant_matrix(wheel_of, mask.steps, ceil(radius - _ROUNDING))
    wider = invariant_matrix(wheel_of, mask.steps, matrix.rings + 1)
    regular = is_regular(wheel_of, wider, mask.steps, mask.dilation)
    return ExtraordinaryVertex(spectrum_of(matrix), matrix.rings, regular)


def wheels(meshes: StencilMeshes, valence: int) -> Callable[[int], Wheel]:
    """Number of rings → the wheel of that valence.

    Raises:
        SchemeError: nothing is extraordinary in this meshes, or a wheel has fewer than 3 spokes.
    """
    make = meshes.wheel
    if make is None or valence < _LEAST:
        raise SchemeError(f"{meshes.domain} have nothing of valence {valence} to analyse: 3 or more is, off curves")
    return lambda rings: make(valence, rings)


_EXACT = 1e-9


def largest_alpha(scheme: Scheme, steps: int, place: ExtraordinaryVertex) -> float | None:
    """The α at which another eigenvalue overtakes λ1 at a valence; None where it does not on the way from α = 0.

    Args:
        scheme: as it is analysed, with its own α.
        steps: of the scheme, that make one scalar dilation.
        place: what it does at that valence.
    """
    if scheme.alpha is None or place.spectrum.gap > TIE * place.spectrum.leading.modulus:
        return None

    def gap(alpha: float) -> float:
        blend = scheme.with_alpha(alpha)
        matrix = invariant_matrix(wheels(stencil_meshes(blend), place.valence), steps, place.rings)
        return spectrum_of(matrix).gap

    given = float(scheme.alpha)
    if gap(0.0) <= TIE:
        return None
    return float(brentq(gap, 0.0, given, xtol=_EXACT)) if gap(given) < 0 else given


@dataclass(frozen=True)
class BoundaryVertex:
    """What a scheme does at a boundary vertex amid regular ones.

    Attributes:
        neighbours: of the vertex; one more than it has faces.
        moduli: of the three largest eigenvalues but the 1 of constants.
        curve: the eigenvalue of the boundary curve's tangent.
    """

    neighbours: int
    moduli: tuple[float, float, float]
    curve: float

    @property
    def in_order(self) -> bool:
        """Whether two eigenvalues lead, and the curve's is one of them: the tangent plane then holds its tangent."""
        first, second, third = self.moduli
        leads = min(abs(self.curve - first), abs(self.curve - second)) <= TIE
        return leads and first < 1 - TIE and second - third > TIE * second


def analyse_boundary(meshes: StencilMeshes, steps: int, dilation: int, rings: int, neighbours: int) -> BoundaryVertex:
    """Look at boundary verts of so many neighbours.

    Args:
        meshes: with fans.
        steps: of the scheme, that make one scalar dilation.
        dilation: fine edges along a coarse one after so many steps.
        rings: how many decide on the surface around the vertex.
        neighbours: 2 or more.

    Raises:
        SchemeError: no number of rings follows from itself, or there are no such verts.
    """
    if meshes.fan is None or neighbours < 2:
        raise SchemeError(f"{meshes.domain} have no boundary verts of {neighbours} neighbours to analyse: 2 or more is")
    for number in range(rings, MOST_RINGS + 1):
        fan = meshes.fan(neighbours, number + PAD)
        finer = fan.refine(steps)
        inside = fan.ring <= number
        rows = finer.rows(map_fan(fan, finer.topology, fan.locate(steps), number)[inside])
        if not rows[:, ~inside].any():
            found = eigenvalues(rows[:, inside].astype(np.complex128))
            others = np.delete(found, int(np.argmin(np.abs(found - 1))))
            first, second, third, *_ = np.append(np.abs(others), np.zeros(3)).tolist()
            return BoundaryVertex(neighbours, (first, second, third), 1 / dilation)
    raise SchemeError(f"this scheme cannot be analysed: {MOST_RINGS} rings at a boundary do not follow from them")
