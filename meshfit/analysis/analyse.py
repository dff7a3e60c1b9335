"""Analysis of a scheme: its smoothness on regular meshes, at extraordinary vertices and along boundaries."""

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
_SAME = 1e-6


@dataclass(frozen=True)
class Analysis:
    """Properties of a scheme.

    Attributes:
        domain: triangles, polygons or curves.
        irregular: the element that may be extraordinary: `vertex`, `face` (dual schemes), or empty.
        regular: the regular valence.
        dilation: fine edges along a coarse one after `steps` levels.
        steps: number of levels after which the fine lattice is a scaled copy of the coarse one.
        row_sums: the smallest and the largest sum of the weights of one vertex, on a patch and on wheels.
        reproduced: highest degree of polynomials that one level reproduces on the regular lattice.
        generated: highest degree of polynomials that are limits of some data there.
        s2: L2-Sobolev exponent of the limit there.
        stable: whether the shifts of its basis function are stable there.
        holder_bound: upper bound of its Hölder exponent there; None where the shifts are unstable.
        continuity: the largest k for which it is shown to be C^k there; -1 for none.
        support: of the basis function there.
        extraordinary: one for each valence that it has a rule for; none on curves.
        unsupported: the valences that it has no rule for.
        boundary: one for each number of neighbours of a boundary vertex; none if no valences were asked for.
        alphas: by valence at which C1 fails, the α from which it fails, unless it fails from α = 0.
    """

    domain: str
    irregular: str
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
    extraordinary: tuple[ExtraordinaryVertex, ...]
    unsupported: tuple[int, ...]
    boundary: tuple[BoundaryVertex, ...]
    alphas: dict[int, float]

    @property
    def failing(self) -> tuple[int, ...]:
        """The valences at which the limit is not shown to be C1."""
        return tuple(vertex.valence for vertex in self.extraordinary if vertex.fault or self.continuity < 1)


def analyse(scheme: Scheme, valences: Sequence[int] = VALENCES) -> Analysis:
    """Analyse a scheme by the operators that it makes on stencil meshes.

    Args:
        scheme: a built-in or user-defined scheme.
        valences: of the extraordinary vertices (or faces) to analyse, each 3 or more.

    Raises:
        SchemeError: its refined lattice is not a lattice, its stencils are too wide, or it has an α for each vertex.
    """
    if scheme.alpha is not None and np.ndim(scheme.alpha):
        raise SchemeError("a scheme is analysed for one alpha, not for one alpha per vertex")
    meshes = stencil_meshes(scheme)
    mask = regular_mask(meshes)
    order = sum_rule_order(mask)
    support = support_of(meshes, mask)
    regular = regularity_of(mask)
    bound = holder_bound(mask, order)
    valences = valences if meshes.wheel is not None else ()
    extraordinary = _extraordinary(meshes, mask, support.radius, valences)
    supported = [vertex.valence for vertex in extraordinary]
    alphas = {vertex.valence: largest_alpha(scheme, mask.steps, vertex) for vertex in extraordinary if vertex.fault}
    neighbours = NEIGHBOURS if valences and meshes.fan is not None else ()
    return Analysis(
        domain=meshes.domain,
        irregular=meshes.irregular,
        regular=meshes.regular,
        dilation=mask.dilation,
        steps=mask.steps,
        row_sums=_row_sums(meshes, mask.steps, supported),
        reproduced=reproduced_degree(meshes),
        generated=regular.accuracy - 1,
        s2=regular.s2,
        stable=regular.stable,
        holder_bound=bound if regular.stable else None,
        continuity=continuity(mask, order, regular, bound),
        support=support,
        extraordinary=extraordinary,
        unsupported=tuple(valence for valence in valences if valence not in supported),
        boundary=_boundary(meshes, mask, ceil(support.radius - _ROUNDING), neighbours),
        alphas={valence: alpha for valence, alpha in alphas.items() if alpha is not None},
    )


def _extraordinary(
    meshes: StencilMeshes, mask: RegularMask, radius: float, valences: Sequence[int]
) -> tuple[ExtraordinaryVertex, ...]:
    """Analyse each valence at which the scheme can refine."""
    vertices = []
    for valence in valences:
        with suppress(MeshError):
            vertices.append(analyse_valence(meshes, mask, radius, valence))
    return tuple(vertices)


def _boundary(
    meshes: StencilMeshes, mask: RegularMask, rings: int, neighbours: Sequence[int]
) -> tuple[BoundaryVertex, ...]:
    """Analyse each number of neighbours of a boundary vertex at which the scheme can refine."""
    vertices = []
    for count in neighbours:
        with suppress(MeshError):
            vertices.append(analyse_boundary(meshes, mask.steps, mask.dilation, rings, count))
    return tuple(vertices)


def _row_sums(meshes: StencilMeshes, steps: int, valences: Sequence[int]) -> tuple[float, float]:
    """Return the extreme row sums over every vertex of a patch and of wheels, borders included."""
    refines = [meshes.patch(_REACH).refine, *(wheels(meshes, valence)(_REACH).refine for valence in valences)]
    operators = [operator for refine in refines for operator in refine(steps).operators]
    sums = np.concatenate([operator.sum(axis=1) for operator in operators])
    return float(sums.min()), float(sums.max())


def verdict(analysis: Analysis) -> str:
    """Return one line on the smoothness of the limit."""
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
    elif any(vertex.valence != analysis.regular for vertex in analysis.extraordinary):
        parts.append(f"C1 at {_named(analysis, [vertex.valence for vertex in analysis.extraordinary])}")
    if analysis.unsupported:
        parts.append(f"no rule at {_named(analysis, analysis.unsupported)}")
    return "; ".join(parts)


def warnings_of(analysis: Analysis) -> Iterator[str]:
    """Yield the reason for each valence at which C1 fails, if the limit is C1 on regular meshes."""
    if analysis.continuity < 1:
        return
    for vertex in analysis.extraordinary:
        if vertex.fault:
            alpha = analysis.alphas.get(vertex.valence)
            remedy = "" if alpha is None else f"; it holds there for alpha < {alpha:.4f}"
            yield f"C1 fails at {_named(analysis, [vertex.valence])}: {vertex.fault}{remedy}"


def curvature_of(analysis: Analysis, valence: int) -> str:
    """Return the limit of curvatures at a valence: bounded, flat or unbounded; empty where the limit is not C1."""
    vertex = next(vertex for vertex in analysis.extraordinary if vertex.valence == valence)
    return "" if valence in analysis.failing else vertex.spectrum.curvature


def _named(analysis: Analysis, valences: Sequence[int]) -> str:
    """Write `valence 3`, `valences 3 and 8 to 12`, or `faces of 3 corners`."""
    runs: list[list[int]] = []
    for valence in valences:
        if runs and valence == runs[-1][-1] + 1:
            runs[-1].append(valence)
        else:
            runs.append([valence])
    parts = [f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
    if analysis.irregular == "face":
        return f"faces of {listed} corners"
    return f"valence{'s' if len(valences) > 1 else ''} {listed}"
