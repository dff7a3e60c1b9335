"""Refinement: some levels of a scheme on a connectivity, as sparse operators on anything given at its vertices."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.specs import Value
from meshfit.subdivision.assemble import assemble, vertex_attribute_carry
from meshfit.subdivision.choose import scheme_of, unfit
from meshfit.subdivision.curve_refine import refine_chains
from meshfit.subdivision.curve_scheme import CurveScheme
from meshfit.subdivision.refinement import CurveRefinement, Refinement
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.splits import divide
from meshfit.subdivision.triangle_scheme import TriangleScheme

ParameterValue = Value | NDArray[Any]


@overload
def refine(topology: Topology, scheme: Scheme, levels: int = 1) -> Refinement: ...
@overload
def refine(topology: Chains, scheme: Scheme, levels: int = 1) -> CurveRefinement: ...
def refine(topology: Topology | Chains, scheme: Scheme, levels: int = 1) -> Refinement | CurveRefinement:
    """Lay down `levels` levels of a scheme.

    Args:
        topology: of a mesh; or the chains of curves, for a scheme on curves.
        scheme: one on what is refined.
        levels: how many times.

    Raises:
        SchemeError: levels is negative, or the scheme refines something else.
        MeshError: the mesh is not an oriented manifold; a face, edge or vertex at fault is named. Or the curves branch.
    """
    if levels < 0:
        raise SchemeError(f"levels={levels} is not allowed: 0 or more is")
    if levels:
        _require_alphas(scheme, topology.num_verts)
    if isinstance(topology, Chains):
        if not isinstance(scheme, CurveScheme):
            raise unfit(scheme, "curves")
        return refine_chains(topology, scheme, levels)
    if not isinstance(scheme, TriangleScheme):
        raise unfit(scheme, "triangles")
    return _refine_triangles(topology, scheme, levels)


def _refine_triangles(topology: Topology, scheme: TriangleScheme, levels: int) -> Refinement:
    if levels:
        require_manifold(topology, "subdivision")
    num_coarse, operators = topology.num_verts, []
    for step in range(levels):
        division = divide(topology, scheme.split, step)
        operators.append(assemble(topology, scheme, division))
        if scheme.push_back is not None and np.ndim(scheme.push_back.alpha):
            finer = vertex_attribute_carry(topology, division) @ np.asarray(scheme.push_back.alpha)
            scheme = replace(scheme, push_back=replace(scheme.push_back, alpha=finer))
        topology = Topology(topology.num_verts + division.num_new, division.faces)
    return Refinement(num_coarse, tuple(operators), topology.faces)


@overload
def subdivide(mesh: Mesh, scheme: str | Scheme, levels: int = 1, **parameters: ParameterValue) -> Mesh: ...
@overload
def subdivide(mesh: Curves, scheme: str | Scheme, levels: int = 1, **parameters: ParameterValue) -> Curves: ...
def subdivide(
    mesh: Mesh | Curves, scheme: str | Scheme, levels: int = 1, **parameters: ParameterValue
) -> Mesh | Curves:
    """Refine a mesh, or curves, by some levels of a subdivision scheme.

    Args:
        mesh: an oriented manifold, closed or with boundary; or curves, for a scheme on curves.
        scheme: a spec such as `loop` or `interp-loop:alpha=0.5`, or a declared scheme.
        levels: how many times; each makes 4 faces of one (√3 schemes: 3, and they refine the boundary at every second
            level, so that two levels at once differ from one and one more where there is a boundary), or 2 segments of
            one (ternary schemes: 3). The ends of open curves stay where they are.
        **parameters: of the scheme, in place of those in the spec. `alpha` may be a (V,) array of one value a vertex.

    Example:
        >>> from meshfit.mesh.solids import icosahedron
        >>> subdivide(icosahedron(), "interp-loop", 2, alpha=0.5).num_faces
        320

        >>> subdivide(Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]]), "four-point", 3).num_segments
        16

    Raises:
        SchemeError: no such scheme or parameter, a value that is not allowed, or a scheme that refines something else.
        MeshError: the mesh or the curves cannot be refined; an edge or vertex at fault is named.
    """
    declared = _declared(scheme, parameters)
    if isinstance(mesh, Curves):
        curves = refine(Chains.of(mesh), declared, levels)
        return Curves(curves(mesh.verts), curves.chains.corners, curves.chains.sizes, curves.chains.closed)
    refinement = refine(Topology.of(mesh), declared, levels)
    return Mesh(refinement(mesh.verts), refinement.faces)


def _declared(scheme: str | Scheme, parameters: Mapping[str, ParameterValue]) -> Scheme:
    lists = {key: value for key, value in parameters.items() if np.ndim(value)}
    plain = {key: _plain(value) for key, value in parameters.items() if key not in lists}
    if isinstance(scheme, str):
        declared = scheme_of(scheme, **plain)
    elif plain:
        raise SchemeError(f"parameter '{next(iter(plain))}' goes with a scheme's name, not with a declared scheme")
    else:
        declared = scheme
    for key, value in lists.items():
        if key != "alpha":
            raise SchemeError(f"parameter '{key}' takes one value, not an array")
        declared = declared.with_alpha(np.asarray(value, dtype=np.float64))
    return declared


def _plain(value: ParameterValue) -> Value:
    return value.item() if isinstance(value, np.ndarray | np.generic) else value


def _require_alphas(scheme: Scheme, num_verts: int) -> None:
    alpha = scheme.push_back.alpha if scheme.push_back is not None else 0.0
    if np.ndim(alpha) and np.shape(alpha) != (num_verts,):
        raise MeshError(f"alpha has shape {np.shape(alpha)}; one value for each of {num_verts} verts is needed")
