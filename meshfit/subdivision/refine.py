"""Refinement: some levels of a scheme laid down on a connectivity, or on a mesh."""

from collections.abc import Mapping
from functools import partial
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.specs import Value
from meshfit.subdivision.creases import Creases, require_matching_creases
from meshfit.subdivision.curves.assemble import refine_chains
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.assemble import assemble_polygons
from meshfit.subdivision.polygons.scheme import LINEAR, PolygonScheme, PolygonSplit
from meshfit.subdivision.polygons.splits import PolygonDivision, divide_polygons
from meshfit.subdivision.push_back import with_carried_alpha
from meshfit.subdivision.refinement import CurveRefinement, PolygonRefinement, Refinement
from meshfit.subdivision.registry import resolve, wrong_domain
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.triangles.assemble import assemble, vertex_attribute_carry
from meshfit.subdivision.triangles.scheme import Split, TriangleScheme
from meshfit.subdivision.triangles.splits import divide
from meshfit.subdivision.triangles.table import MIDPOINT

ParameterValue = Value | NDArray[Any]


@overload
def refine(
    topology: Topology, scheme: TriangleScheme, levels: int = 1, creases: Creases | None = None
) -> Refinement: ...
@overload
def refine(topology: Topology | PolygonTopology, scheme: PolygonScheme, levels: int = 1) -> PolygonRefinement: ...
@overload
def refine(
    topology: Topology | PolygonTopology, scheme: Scheme, levels: int = 1, creases: Creases | None = None
) -> Refinement | PolygonRefinement: ...
@overload
def refine(topology: Chains, scheme: Scheme, levels: int = 1) -> CurveRefinement: ...
def refine(
    topology: Topology | PolygonTopology | Chains, scheme: Scheme, levels: int = 1, creases: Creases | None = None
) -> Refinement | PolygonRefinement | CurveRefinement:
    """Lay down `levels` levels of a scheme.

    Args:
        topology: triangles or polygons, where a scheme on polygons takes triangles as such; or the chains of curves.
        scheme: one on what is refined.
        levels: how many times.
        creases: sharp edges and corners of this topology, for loop, interp-loop and midpoint.

    Raises:
        SchemeError: levels is negative, the scheme refines something else, or it takes no creases.
        MeshError: the mesh is not an oriented manifold, or has a place that the scheme has no rule for; a face, edge or
            vertex at fault is named. Or the curves branch.
    """
    if levels < 0:
        raise SchemeError(f"levels={levels} is not allowed: 0 or more is")
    if creases is not None:
        require_takes_creases(scheme)
    if levels:
        _require_alphas(scheme, topology.num_verts)
    if isinstance(topology, Chains):
        if not isinstance(scheme, CurveScheme):
            raise wrong_domain(scheme, "curves")
        return refine_chains(topology, scheme, levels)
    if isinstance(scheme, CurveScheme):
        raise wrong_domain(scheme, "triangles" if isinstance(topology, Topology) else "polygons")
    return _refine_surface(topology, scheme, levels, creases)


def _refine_surface(
    topology: Topology | PolygonTopology, scheme: TriangleScheme | PolygonScheme, levels: int, creases: Creases | None
) -> Refinement | PolygonRefinement:
    if levels:
        require_manifold(topology, "subdivision")
    if isinstance(scheme, PolygonScheme):
        polygons = topology if isinstance(topology, PolygonTopology) else PolygonTopology.of(topology)
        return _refine_polygons(polygons, scheme, levels)
    if isinstance(topology, PolygonTopology):
        raise SchemeError(
            "this scheme refines triangles, and the mesh is of polygons: triangulate it, or choose a scheme on "
            "polygons, such as catmull-clark"
        )
    if creases is not None:
        require_matching_creases(creases, topology)
    return _refine_triangles(topology, scheme, levels, creases)


def _refine_triangles(topology: Topology, scheme: TriangleScheme, levels: int, creases: Creases | None) -> Refinement:
    num_coarse, operators = topology.num_verts, list[csr_array]()
    for step in range(levels):
        division = divide(topology, scheme.split, step)
        operators.append(assemble(topology, scheme, division, creases))
        scheme = with_carried_alpha(scheme, partial(vertex_attribute_carry, topology, division))
        topology = Topology(topology.num_verts + division.num_new, division.faces)
        creases = None if creases is None else creases.finer(topology.num_verts, topology.edges)
    return Refinement(num_coarse, tuple(operators), topology.faces, creases)


def _refine_polygons(topology: PolygonTopology, scheme: PolygonScheme, levels: int) -> PolygonRefinement:
    num_coarse, operators = topology.num_verts, list[csr_array]()
    for step in range(levels):
        division = divide_polygons(topology, scheme.split, step)
        operators.append(assemble_polygons(topology, scheme, division))
        scheme = with_carried_alpha(scheme, partial(_linear_carry, topology, scheme, division))
        topology = division.finer
    return PolygonRefinement(num_coarse, tuple(operators), topology)


def _linear_carry(topology: PolygonTopology, scheme: PolygonScheme, division: PolygonDivision) -> csr_array:
    return assemble_polygons(topology, LINEAR[scheme.split], division)


@overload
def subdivide(
    mesh: Mesh, scheme: TriangleScheme, levels: int = 1, *, creases: Creases | None = None, **parameters: ParameterValue
) -> Mesh: ...
@overload
def subdivide(
    mesh: Mesh | PolygonMesh,
    scheme: PolygonScheme,
    levels: int = 1,
    *,
    creases: None = None,
    **parameters: ParameterValue,
) -> PolygonMesh: ...
@overload
def subdivide(
    mesh: Mesh | PolygonMesh,
    scheme: str | Scheme,
    levels: int = 1,
    *,
    creases: Creases | None = None,
    **parameters: ParameterValue,
) -> Mesh | PolygonMesh: ...
@overload
def subdivide(
    mesh: Curves, scheme: str | Scheme, levels: int = 1, *, creases: None = None, **parameters: ParameterValue
) -> Curves: ...
def subdivide(
    mesh: Mesh | PolygonMesh | Curves,
    scheme: str | Scheme,
    levels: int = 1,
    *,
    creases: Creases | None = None,
    **parameters: ParameterValue,
) -> Mesh | PolygonMesh | Curves:
    """Refine a mesh, or curves, by some levels of a subdivision scheme.

    Args:
        mesh: an oriented manifold, closed or with boundary; of triangles, or of polygons for a scheme on these. Or
            curves, for a scheme on curves.
        scheme: a spec such as `loop` or `interp-loop:alpha=0.5`, or a declared scheme.
        levels: how many times; each makes 4 faces of one (√3 schemes: 3, √2 schemes: 2, and both refine the boundary at
            every second level, so that two levels at once differ from one and one more where there is a boundary), or 2
            segments of one (ternary schemes: 3). The ends of open curves stay where they are.
        creases: sharp edges and corners, for loop, interp-loop and midpoint; as `creases_by_angle` finds them.
        **parameters: of the scheme, in place of those in the spec. `alpha` may be a (V,) array of one value a vertex.

    Example:
        >>> from meshfit.mesh.solids import icosahedron
        >>> subdivide(icosahedron(), "interp-loop", 2, alpha=0.5).num_faces
        320

        >>> subdivide(Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]]), "four-point", 3).num_segments
        16

    Returns:
        A mesh of triangles from a scheme on triangles, one of polygons from a scheme on polygons, and curves of curves.

    Raises:
        SchemeError: no such scheme or parameter, a value that is not allowed, or a scheme that refines something else
            or takes no creases.
        MeshError: the mesh or the curves cannot be refined; an edge or vertex at fault is named.
    """
    declared = _declared(scheme, parameters)
    if isinstance(mesh, Curves):
        curves = refine(Chains.of(mesh), declared, levels)
        return Curves(curves(mesh.verts), curves.chains.corners, curves.chains.sizes, curves.chains.closed)
    if creases is not None and isinstance(scheme, str):
        require_takes_creases(declared, scheme)
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    refinement = refine(topology, declared, levels, creases)
    verts = refinement(mesh.verts)
    if isinstance(refinement, Refinement):
        return Mesh(verts, refinement.faces)
    return refinement.mesh(verts)


def _declared(scheme: str | Scheme, parameters: Mapping[str, ParameterValue]) -> Scheme:
    lists = {key: value for key, value in parameters.items() if np.ndim(value)}
    plain = {key: _plain(value) for key, value in parameters.items() if key not in lists}
    declared = resolve(scheme, **plain)
    for key, value in lists.items():
        if key != "alpha":
            raise SchemeError(f"parameter '{key}' takes one value, not an array")
        declared = declared.with_alpha(np.asarray(value, dtype=np.float64))
    return declared


def _plain(value: ParameterValue) -> Value:
    return value.item() if isinstance(value, np.ndarray | np.generic) else value


def require_takes_creases(scheme: Scheme, name: str = "this scheme") -> None:
    """Refuse a scheme whose rule along a curve is no rule for creases.

    Args:
        scheme: which.
        name: what to call it.

    Raises:
        SchemeError: it takes none.
    """
    if not (isinstance(scheme, TriangleScheme) and scheme.takes_creases):
        raise SchemeError(f"{name} takes no creases; loop, interp-loop and midpoint do")


def _require_alphas(scheme: Scheme, num_verts: int) -> None:
    alpha = scheme.push_back.alpha if scheme.push_back is not None else 0.0
    if np.ndim(alpha) and np.shape(alpha) != (num_verts,):
        raise MeshError(f"alpha has shape {np.shape(alpha)}; one value for each of {num_verts} verts is needed")


def linear_scheme(scheme: Scheme) -> Scheme | None:
    """The scheme that keeps old verts and puts those of the same split between them; None where old edges are lost."""
    if isinstance(scheme, PolygonScheme):
        return LINEAR.get(scheme.split)
    return MIDPOINT if scheme.split is Split.QUADRISECT else None


# On a large closed surface of triangles, which has three edges and two faces for each vertex, the first level, and any
# that follows it on the polygons that it leaves.
_ON_TRIANGLES: dict[PolygonSplit, tuple[float, float]] = {
    PolygonSplit.QUADS: (6.0, 4.0),
    PolygonSplit.SQRT2: (3.0, 2.0),
    PolygonSplit.TERNARY: (13.0, 9.0),
    PolygonSplit.DUAL: (6.0, 4.0),
}


def growth(scheme: Scheme, levels: int) -> float:
    """About how many verts come of each by some levels on triangles; four at each for any scheme on triangles."""
    if not isinstance(scheme, PolygonScheme):
        return 4.0**levels
    first, later = _ON_TRIANGLES[scheme.split]
    return first * later ** (levels - 1) if levels else 1.0
