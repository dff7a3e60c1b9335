"""The analysis of one scheme: everything that is computed of it, in one piece of data."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil

import numpy as np

from meshfit.analysis.extraordinary_vertex import (
    BoundaryVertex,
    ExtraordinaryVertex,
    analyse_boundary,
    analyse_valence,
    largest_alpha,
    wheels,
)
from meshfit.analysis.regular_lattice import (
    RegularMask,
    Support,
    regular_mask,
    reproduced_degree,
    sum_rule_order,
    support_of,
)
from meshfit.analysis.regularity import continuity, holder_bound, regularity_of
from meshfit.analysis.stencil_meshes import StencilMeshes, stencil_meshes
from meshfit.errors import MeshError, SchemeError
from meshfit.subdivision.registry import Scheme

VALENCES = tuple(range(3, 13))
NEIGHBOURS = tuple(range(2, 9))
_REACH = 3
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Analysis:
    """What is computed of a scheme.

    Attributes:
        domain: what it refines: triangles, polygons or curves.
        odd: what may be extraordinary: `vertex`, `face` (dual schemes), or nothing.
        regular: the regular valence.
        dilation: fine edges along a coarse one after `steps` levels, which is when the lattice lies as before.
        steps: that number of levels.
        row_sums: the least and the largest sum of the weights of one vertex, on a patch and on wheels.
        reproduced: highest degree of polynomials that one level reproduces on the regular lattice.
        generated: highest degree of polynomials that are limits of some data there.
        s2: L2-Sobolev exponent of the limit there.
        stable: whether the shifts of its basis function are stable there.
        holder_bound: what its Hölder exponent cannot be larger than; None where it is unstable, so that none is known.
        continuity: the largest k for which it is shown to be C^k there; -1 for none.
        support: of the basis function there.
        places: one for each valence that it has a rule for; none on curves.
        unruled: the valences that it has no rule for.
        boundary: one for each number of neighbours of a boundary vertex; none where valences are not looked at.
        alphas: by valence at which C1 fails, the alpha from which it does, if it does not from alpha = 0.
    """

    domain: str
    odd: str
    regular: int
    dilation: int
    steps: int
    row_sums: tuple[float, float]
    reproduced: int
    generated: int
    s2: float
    stable: bool
    holder_bound: float | None
    continuity: int
    support: Support
    places: tuple[ExtraordinaryVertex, ...]
    unruled: tuple[int, ...]
    boundary: tuple[BoundaryVertex, ...]
    alphas: dict[int, float]

    @property
    def failing(self) -> tuple[int, ...]:
        """The valences at which the limit is not shown to be C1."""
        return tuple(each.valence for each in self.places if each.fault or self.continuity < 1)


def analyse(scheme: Scheme, valences: Sequence[int] = VALENCES) -> Analysis:
    """Compute what a scheme does on regular meshes and at extraordinary places, from the operators that it makes.

    Args:
        scheme: any that is declared, one's own too.
        valences: to look at, 3 or more each.

    Raises:
        SchemeError: its refined lattice is no lattice, its stencils are too wide, or it has an alpha for each vertex.
    """
    if np.ndim(scheme.alpha if scheme.alpha is not None else 0.0):
        raise SchemeError("a scheme is analysed for one alpha, not for one at each vertex")
    meshes = stencil_meshes(scheme)
    mask = regular_mask(meshes)
    order = sum_rule_order(mask)
    support = support_of(meshes, mask)
    regular = regularity_of(mask)
    bound = holder_bound(mask, order)
    odd = valences if meshes.wheel is not None else ()
    places = _places(meshes, mask, support.radius, odd)
    alphas = {each.valence: largest_alpha(scheme, mask.steps, each) for each in places if each.fault}
    neighbours = NEIGHBOURS if odd and meshes.fan is not None else ()
    return Analysis(
        domain=meshes.domain,
        odd=meshes.irregular,
        regular=meshes.regular,
        dilation=mask.dilation,
        steps=mask.steps,
        row_sums=_row_sums(meshes, mask.steps, [place.valence for place in places]),
        reproduced=reproduced_degree(meshes),
        generated=regular.accuracy - 1,
        s2=regular.s2,
        stable=regular.stable,
        holder_bound=bound if regular.stable else None,
        continuity=continuity(mask, order, regular, bound),
        support=support,
        places=places,
        unruled=tuple(valence for valence in odd if valence not in {place.valence for place in places}),
        boundary=_boundary(meshes, mask, ceil(support.radius - _ROUNDING), neighbours),
        alphas={valence: alpha for valence, alpha in alphas.items() if alpha is not None},
    )


def _places(
    meshes: StencilMeshes, mask: RegularMask, radius: float, valences: Sequence[int]
) -> tuple[ExtraordinaryVertex, ...]:
    """One for each valence, but for those at which the scheme cannot refine."""
    found = []
    for valence in valences:
        with suppress(MeshError):
            found.append(analyse_valence(meshes, mask, radius, valence))
    return tuple(found)


def _boundary(
    meshes: StencilMeshes, mask: RegularMask, rings: int, neighbours: Sequence[int]
) -> tuple[BoundaryVertex, ...]:
    """The same along the boundary."""
    found = []
    for count in neighbours:
        with suppress(MeshError):
            found.append(analyse_boundary(meshes, mask.steps, mask.dilation, rings, count))
    return tuple(found)


def _row_sums(meshes: StencilMeshes, steps: int, valences: Sequence[int]) -> tuple[float, float]:
    """Of every vertex on a patch and on wheels, near borders too."""
    refines = [meshes.patch(_REACH).refine, *(wheels(meshes, valence)(_REACH).refine for valence in valences)]
    operators = [operator for refine in refines for operator in refine(steps).operators]
    sums = np.concatenate([operator.sum(axis=1) for operator in operators])
    return float(sums.min()), float(sums.max())


_SAME = 1e-6


def verdict(analysis: Analysis) -> str:
    """How smooth the limit is, in one line."""
    where = "" if analysis.domain == "curves" else " on regular meshes"
    bound = f"s2 = {analysis.s2:.3f}"
    if analysis.continuity < 0:
        return f"continuity is not shown{where} ({bound})"
    known = analysis.holder_bound is not None and analysis.continuity + 1 >= analysis.holder_bound - _SAME
    least = "" if known else "at least "
    regular = f"{least}C{analysis.continuity}{where} ({bound})"
    if analysis.continuity < 1:
        return f"{regular}, not C1" if not least else regular
    parts = [regular]
    if analysis.failing:
        parts.append(f"C1 fails at {_named(analysis, analysis.failing)}")
    elif any(place.valence != analysis.regular for place in analysis.places):
        parts.append(f"C1 at {_named(analysis, [place.valence for place in analysis.places])}")
    if analysis.unruled:
        parts.append(f"no rule at {_named(analysis, analysis.unruled)}")
    return "; ".join(parts)


def warnings_of(analysis: Analysis) -> Iterator[str]:
    """For each valence at which C1 fails, though not on regular meshes, why."""
    if analysis.continuity < 1:
        return
    for place in analysis.places:
        if place.fault:
            alpha = analysis.alphas.get(place.valence)
            cure = "" if alpha is None else f"; it holds there for alpha < {alpha:.4f}"
            yield f"C1 fails at {_named(analysis, [place.valence])}: {place.fault}{cure}"


def curvature_of(analysis: Analysis, valence: int) -> str:
    """What becomes of curvatures there: bounded, flat or unbounded; empty where the limit is not C1."""
    place = next(place for place in analysis.places if place.valence == valence)
    return "" if valence in analysis.failing else place.spectrum.curvature


def _named(analysis: Analysis, valences: Sequence[int]) -> str:
    """`valence 3`, `valences 3 and 8 to 12`, or `faces of 3 corners`."""
    runs: list[list[int]] = []
    for valence in valences:
        if runs and valence == runs[-1][-1] + 1:
            runs[-1].append(valence)
        else:
            runs.append([valence])
    parts = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
    if analysis.odd == "face":
        return f"faces of {listed} corners"
    return f"valence{'s' if len(valences) > 1 else ''} {listed}"
