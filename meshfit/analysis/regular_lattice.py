"""A scheme on the regular lattice: its mask, the support of its basis function, and its polynomials."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.analysis.stencil_meshes import Patch, StencilMeshes
from meshfit.errors import SchemeError

_REACH = 9
_REACH_OF_POLYNOMIALS = 7  # a larger patch would only add rounding to high powers
_MOST_STEPS = 4
_WHOLE = 1e-8
_ZERO = 1e-14
_HIGHEST_DEGREE = 11
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class RegularMask:
    """The weights a(k) that one coarse value contributes to the fine lattice: fine(k) = Σ_j a(k - m j) coarse(j).

    Attributes:
        offsets: (K, D) k, in units of the fine lattice and in its basis, from where the coarse value lies; multiples
            of 1/2 for dual schemes, whose new vertices do not lie on old ones.
        weights: (K,) a(k).
        dilation: m, the number of fine edges along a coarse one.
        steps: levels after which the fine lattice is a scaled copy of the coarse one: 2 for √3 and √2, else 1.
    """

    offsets: Float64[np.ndarray, "K D"]
    weights: Float64[np.ndarray, " K"]
    dilation: int
    steps: int

    @property
    def dimension(self) -> int:
        """D, of the lattice."""
        return int(self.offsets.shape[1])

    @property
    def whole_offsets(self) -> Int64[np.ndarray, "K D"]:
        """(K, D) the offsets rounded down to integers; unchanged where they are integers."""
        return np.asarray(np.rint(self.offsets - _part(self.offsets)), dtype=np.int64)


def regular_mask(meshes: StencilMeshes) -> RegularMask:
    """Read the mask off a column of the operator on a patch.

    New vertices are located by refining the lattice's coordinates, which schemes with symmetric masks reproduce.

    Raises:
        SchemeError: the fine lattice is never a scaled copy of the coarse one.
    """
    patch = meshes.patch(_REACH)
    for steps in range(1, _MOST_STEPS + 1):
        mask = _mask_after(patch, steps)
        if mask is not None:
            return mask
    raise SchemeError(
        f"this scheme cannot be analysed: after {_MOST_STEPS} steps its vertices are not a finer copy of the lattice"
    )


def _mask_after(patch: Patch, steps: int) -> RegularMask | None:
    finer = patch.refine(steps)
    inner = patch.regular(finer)
    places = finer.carry(patch.places)[inner]
    dimension = patch.places.shape[1]
    density = int(((places > -0.5 - _WHOLE) & (places < 0.5 - _WHOLE)).all(axis=1).sum())
    dilation = round(density ** (1 / dimension))
    if dilation < 2 or dilation**dimension != density:
        return None
    offsets = dilation * places
    if np.abs(offsets - _part(offsets) - np.rint(offsets - _part(offsets))).max() > _WHOLE:
        return None
    origin = (patch.places == 0).all(axis=1) * 1.0
    weights = finer.carry(origin)[inner]
    kept = np.abs(weights) > _ZERO
    part = _part(offsets)
    return RegularMask(np.rint(offsets[kept] - part) + part, weights[kept], dilation, steps)


def _part(offsets: Float64[np.ndarray, "K D"]) -> Float64[np.ndarray, " D"]:
    """Return the common fraction of the offsets: 0, or 1/2 for dual schemes."""
    return np.asarray(np.rint(2 * offsets[0]) % 2 / 2)


@dataclass(frozen=True)
class Support:
    """Support of the basis function, the limit of the data that are 1 at one vertex and 0 at all others.

    Attributes:
        radius: of its convex hull, in rings of faces around its vertex; on a curve, in edges.
        stencils: the fewest and the most coarse vertices that a new vertex of one level depends on.
        mask: number of fine vertices that depend on a coarse one, after a scalar dilation.
    """

    radius: float
    stencils: tuple[int, int]
    mask: int


def support_of(meshes: StencilMeshes, mask: RegularMask) -> Support:
    """Return the support: a mask on points Ω has its limit on Ω / m + Ω / m² + …, with the hull of Ω / (m - 1)."""
    radius = float(meshes.distance(mask.offsets).max()) / (mask.dilation - 1)
    sizes = _stencil_sizes(meshes)
    return Support(radius, (int(sizes.min()), int(sizes.max())), len(mask.weights))


def _stencil_sizes(meshes: StencilMeshes) -> Float64[np.ndarray, " N"]:
    patch = meshes.patch(_REACH)
    finer = patch.refine(1)
    inner = patch.regular(finer)
    used = abs(finer.operators[0]) > _ZERO
    return np.asarray(used.sum(axis=1)[inner], dtype=np.float64)


def reproduced_degree(meshes: StencilMeshes) -> int:
    """Return the highest degree up to which one level maps values of polynomials to their values, or -1."""
    patch = meshes.patch(_REACH_OF_POLYNOMIALS)
    finer = patch.refine(1)
    inner = patch.regular(finer)
    coarse, fine = patch.places / _REACH_OF_POLYNOMIALS, finer.carry(patch.places)[inner] / _REACH_OF_POLYNOMIALS
    for degree in range(_HIGHEST_DEGREE + 1):
        refined = finer.carry(monomials(coarse, degree))[inner]
        if np.abs(refined - monomials(fine, degree)).max() > _TOLERANCE:
            return degree - 1
    return _HIGHEST_DEGREE


def sum_rule_order(mask: RegularMask) -> int:
    """Return the order κ of the sum rules: polynomials of degree below κ are generated.

    Order κ: Σ_j a(m j + ε) p(m j + ε) is the same for every ε, for every polynomial p of degree below κ (Jia 1998,
    Characterization of smoothness of multivariate refinable functions in Sobolev spaces).
    """
    offsets = mask.whole_offsets
    _, coset = np.unique(offsets % mask.dilation, axis=0, return_inverse=True)
    scale = max(1, int(np.abs(offsets).max()))
    places = offsets / scale
    count = mask.dilation**mask.dimension
    for degree in range(_HIGHEST_DEGREE + 1):
        moments = np.zeros((count, len(list(_powers(mask.dimension, degree)))))
        np.add.at(moments, coset.reshape(-1), mask.weights[:, None] * monomials(places, degree))
        if np.abs(moments - moments[0]).max() > _TOLERANCE:
            return degree
    return _HIGHEST_DEGREE + 1


def monomials(places: Float64[np.ndarray, "N D"], degree: int) -> Float64[np.ndarray, "N M"]:
    """Return the (N, M) values of every monomial of exactly that degree."""
    return np.stack([np.prod(places ** np.array(power), axis=1) for power in _powers(places.shape[1], degree)], axis=1)


def _powers(dimension: int, degree: int) -> Iterator[tuple[int, ...]]:
    return (power for power in product(range(degree + 1), repeat=dimension) if sum(power) == degree)
