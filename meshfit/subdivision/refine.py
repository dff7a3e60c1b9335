"""Refinement: some levels of a scheme laid down on a connectivity, or applied to a mesh or to curves.

A `Refinement` has the operators of its levels, which act on numpy arrays and torch tensors, and the finest faces.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from math import prod
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array

from meshfit.doors import no_type_check
from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.any_mesh import MeshLike, as_mesh, as_topology
from meshfit.mesh.curves import Chains, Curves, require_chains
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Faces, Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.printable import value_text
from meshfit.specs import Value
from meshfit.subdivision.attributes import refined_attributes
from meshfit.subdivision.creases import Creases, require_creases, require_matching_creases
from meshfit.subdivision.curves.assemble import assemble_curves
from meshfit.subdivision.curves.assemble import linear_carry as linear_carry_on_curves
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.growth import require_memory_for_levels
from meshfit.subdivision.polygons.assemble import assemble_polygons
from meshfit.subdivision.polygons.scheme import LINEAR_SCHEMES, PolygonScheme
from meshfit.subdivision.polygons.splits import divide_polygons
from meshfit.subdivision.push_back import carry_alpha
from meshfit.subdivision.registry import Scheme, resolve, wrong_domain
from meshfit.subdivision.triangles.assemble import assemble, linear_carry
from meshfit.subdivision.triangles.scheme import MIDPOINT, Split, TriangleScheme
from meshfit.subdivision.triangles.splits import divide
from meshfit.units import count_text

if TYPE_CHECKING:
    import torch

ParameterValue = Value | NDArray[Any]
Values = TypeVar("Values", np.ndarray, "torch.Tensor")


def _sparse_tensor(operator: csr_array, dtype: "torch.dtype", device: "torch.device | str") -> "torch.Tensor":
    """Return the operator as a sparse COO tensor; its products are differentiable on every device."""
    import torch  # plans refine sources without it

    entries = coo_array(operator)
    indices = torch.stack([torch.as_tensor(entries.row.astype("int64")), torch.as_tensor(entries.col.astype("int64"))])
    values = torch.as_tensor(entries.data, dtype=dtype)
    return torch.sparse_coo_tensor(
        indices, values, tuple(operator.shape), is_coalesced=True, check_invariants=False
    ).to(device)


@dataclass(frozen=True, eq=False)
class Operators:
    """Operators of some levels.

    Attributes:
        num_coarse: V, the number of coarse vertices.
        operators: one sparse operator for each level, coarsest first.
    """

    num_coarse: int
    operators: tuple[csr_array, ...]

    @property
    def num_fine(self) -> int:
        """V', the number of vertices of the finest level."""
        return self.operators[-1].shape[0] if self.operators else self.num_coarse

    @property
    def _counts(self) -> str:
        levels = count_text(len(self.operators), "level")
        return f"{levels}, {self.num_coarse:,} to {count_text(self.num_fine, 'vert')}"

    @cached_property
    def matrix(self) -> csr_array:
        """Product of all levels: sparse (V', V), verts_fine = matrix @ verts_coarse."""
        product = csr_array(eye_array(self.num_coarse, format="csr"))
        for operator in self.operators:
            product = csr_array(operator @ product)
        return product

    def __call__(self, values: Values) -> Values:
        """Refine positions or any other values given at the coarse vertices.

        Args:
            values: (V, …) numpy array or torch tensor. The map is linear and differentiable.

        Returns:
            (V', …) of the same kind, dtype and device; integers come back as float64.

        Raises:
            MeshError: the number of rows is not the number of coarse vertices.
        """
        if len(values) != self.num_coarse:
            raise MeshError(f"found {len(values)} values; expected one for each of {self.num_coarse} coarse vertices")
        rest = values.shape[1:]
        if isinstance(values, np.ndarray):
            rows = values.reshape(self.num_coarse, prod(rest))
            for operator in self.operators:
                rows = operator @ rows
            fine = rows.reshape(-1, *rest)
            return fine.astype(values.dtype) if np.issubdtype(values.dtype, np.floating) else fine
        import torch

        tensor = values if values.is_floating_point() else values.double()
        flat = tensor.reshape(self.num_coarse, prod(rest))
        for operator in self.operators:
            flat = torch.sparse.mm(_sparse_tensor(operator, tensor.dtype, tensor.device), flat)
        return flat.reshape(-1, *rest)


@dataclass(frozen=True, eq=False)
class Refinement(Operators):
    """Some levels of a scheme on triangles: a linear map of values at the coarse vertices to the fine ones.

    Attributes:
        faces: (F', 3) the finest faces.
        creases: the creases that remain on the finest level; None if there were none.

    Example:
        >>> import meshfit
        >>> refinement = meshfit.refine("tetrahedron", "loop", 3)
        >>> refinement.matrix.shape
        (130, 4)
    """

    faces: Faces
    creases: Creases | None = None

    def __repr__(self) -> str:
        """Return the numbers of levels, vertices and faces."""
        return f"Refinement({self._counts}, {count_text(len(self.faces), 'face')})"


@dataclass(frozen=True, eq=False)
class CurveRefinement(Operators):
    """Some levels of a scheme on curves: a linear map of values at the coarse vertices to the fine ones.

    Attributes:
        chains: the finest chains.

    Example:
        >>> import meshfit
        >>> corner = meshfit.Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]])
        >>> meshfit.refine(corner, "four-point", 2)
        CurveRefinement(2 levels, 3 to 9 verts, 1 chain)
    """

    chains: Chains

    def __repr__(self) -> str:
        """Return the numbers of levels, vertices and chains."""
        return f"CurveRefinement({self._counts}, {count_text(len(self.chains.sizes), 'chain')})"


@dataclass(frozen=True, eq=False)
class PolygonRefinement(Operators):
    """Some levels of a scheme on polygons.

    Attributes:
        finest: the finest connectivity.
    """

    finest: PolygonTopology

    def __repr__(self) -> str:
        """Return the numbers of levels, vertices and faces."""
        return f"PolygonRefinement({self._counts}, {count_text(self.finest.num_faces, 'face')})"

    def mesh(self, verts: Verts) -> PolygonMesh:
        """Return the finest faces with their vertices at these positions."""
        return PolygonMesh(verts, self.finest.corners, self.finest.sizes)


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
def refine(topology: Chains | Curves, scheme: str | Scheme, levels: int = 1) -> CurveRefinement: ...
@overload
def refine(
    topology: "Topology | PolygonTopology | MeshLike",
    scheme: str | Scheme,
    levels: int = 1,
    creases: Creases | None = None,
) -> Refinement | PolygonRefinement: ...
@no_type_check
def refine(
    topology: "Topology | PolygonTopology | MeshLike | Chains | Curves",
    scheme: str | Scheme,
    levels: int = 1,
    creases: Creases | None = None,
) -> Refinement | PolygonRefinement | CurveRefinement:
    """Lay down some levels of a scheme on a connectivity.

    Args:
        topology: triangles, polygons, or the chains of curves; or a mesh in any form that `as_mesh` takes, or curves. A
            scheme on polygons also takes triangles.
        scheme: a scheme of that domain, or its spec, such as `interp-loop:alpha=0.5`.
        levels: 0 or more.
        creases: sharp edges and corners of this topology, for loop, interp-loop and midpoint.

    Example:
        >>> import meshfit
        >>> mesh = meshfit.as_mesh("icosahedron")
        >>> refinement = meshfit.refine(mesh, "loop", 2)
        >>> refinement
        Refinement(2 levels, 12 to 162 verts, 320 faces)
        >>> meshfit.Mesh(refinement(mesh.verts), refinement.faces)
        Mesh(162 verts, 320 faces, box 1.436 × 1.436 × 1.436)

    Raises:
        SchemeError: levels is negative, the scheme refines another domain, or it takes no creases.
        MeshError: the mesh is not an oriented manifold, the scheme has no rule for one of its faces, edges or vertices,
            which is named, or the curves branch.
    """
    if isinstance(levels, bool) or not isinstance(levels, int | np.integer):
        raise SchemeError(f"levels: expected a whole number, got {value_text(levels)}")
    if levels < 0:
        raise SchemeError(f"levels={levels} is not allowed: expected 0 or more")
    topology, scheme = as_topology(topology), resolve(scheme)
    if creases is not None:
        require_creases(creases)
        require_takes_creases(scheme)
    if levels:
        _require_alphas(scheme, topology.num_verts)
    if isinstance(topology, Chains):
        if not isinstance(scheme, CurveScheme):
            raise wrong_domain(scheme, "curves")
        return _refine_curves(topology, scheme, levels)
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
        require_memory_for_levels(polygons, scheme, levels)
        return _refine_polygons(polygons, scheme, levels)
    if isinstance(topology, PolygonTopology):
        raise SchemeError(
            "this scheme refines triangles, and the mesh is of polygons: triangulate it, or choose a scheme on "
            "polygons, such as catmull-clark"
        )
    if creases is not None:
        require_matching_creases(creases, topology)
    require_memory_for_levels(topology, scheme, levels)
    return _refine_triangles(topology, scheme, levels, creases)


def _refine_triangles(topology: Topology, scheme: TriangleScheme, levels: int, creases: Creases | None) -> Refinement:
    num_coarse, operators = topology.num_verts, list[csr_array]()
    for step in range(levels):
        division = divide(topology, scheme.split, step)
        operators.append(assemble(topology, scheme, division, creases))
        scheme = carry_alpha(scheme, partial(linear_carry, topology, division))
        topology = Topology(topology.num_verts + division.num_new, division.faces)
        creases = None if creases is None else creases.finer(topology.num_verts, topology.edges)
    return Refinement(num_coarse, tuple(operators), topology.faces, creases)


def _refine_polygons(topology: PolygonTopology, scheme: PolygonScheme, levels: int) -> PolygonRefinement:
    num_coarse, operators = topology.num_verts, list[csr_array]()
    for step in range(levels):
        division = divide_polygons(topology, scheme.split, step)
        operators.append(assemble_polygons(topology, scheme, division))
        if scheme.alpha is not None:
            scheme = carry_alpha(scheme, partial(assemble_polygons, topology, LINEAR_SCHEMES[scheme.split], division))
        topology = division.finer
    return PolygonRefinement(num_coarse, tuple(operators), topology)


def _refine_curves(chains: Chains, scheme: CurveScheme, levels: int) -> CurveRefinement:
    if levels:
        require_chains(chains, "subdivision")
    num_coarse, operators = chains.num_verts, list[csr_array]()
    for _ in range(levels):
        operators.append(assemble_curves(chains, scheme))
        scheme = carry_alpha(scheme, partial(linear_carry_on_curves, chains, scheme))
        chains = chains.split(len(scheme.mask.inserted))
    return CurveRefinement(num_coarse, tuple(operators), chains)


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
@overload
def subdivide(
    mesh: "MeshLike",
    scheme: str | Scheme,
    levels: int = 1,
    *,
    creases: Creases | None = None,
    **parameters: ParameterValue,
) -> Mesh | PolygonMesh: ...
@no_type_check
def subdivide(
    mesh: "MeshLike | Curves",
    scheme: str | Scheme,
    levels: int = 1,
    *,
    creases: Creases | None = None,
    **parameters: ParameterValue,
) -> Mesh | PolygonMesh | Curves:
    """Refine a mesh, or curves, by some levels of a subdivision scheme.

    The attributes of a mesh are refined with it: data of vertices by the scheme, faces as parts of theirs, and texture
    coordinates within the charts that their seams separate.

    Args:
        mesh: an oriented manifold, closed or with boundary, in any form that `as_mesh` takes: of triangles, or of
            polygons for a scheme on polygons; a file or a name gives the kind that the scheme refines. Or curves, for a
            scheme on curves.
        scheme: a spec such as `loop` or `interp-loop:alpha=0.5`, or a declared scheme.
        levels: 0 or more. Each level splits a face in 4, or a segment in 2 (ternary schemes: in 3). √3 schemes split a
            face in 3 and √2 schemes in 2; both refine the boundary at every second level, so that on a mesh with
            boundary two levels at once differ from one level twice. The ends of open curves stay where they are.
        creases: sharp edges and corners, for loop, interp-loop and midpoint; see `creases_by_angle`.
        **parameters: of the scheme; they take precedence over those in the spec. `alpha` may be a (V,) array, one value
            for each vertex.

    Example:
        >>> import meshfit
        >>> meshfit.subdivide("icosahedron", "interp-loop", 2, alpha=0.5)
        Mesh(162 verts, 320 faces, box 1.681 × 1.681 × 1.681)
        >>> meshfit.subdivide("cube", "catmull-clark", 2)
        PolygonMesh(98 verts, 96 quads, box 1.014 × 1.014 × 1.014)
        >>> meshfit.subdivide(meshfit.Curves.through([[0, 0, 0], [1, 0, 0], [1, 1, 0]]), "four-point", 3)
        Curves(17 verts, 1 chain, 16 segments)

    Returns:
        Triangles from a scheme on triangles, polygons from a scheme on polygons, curves from curves.

    Raises:
        SchemeError: no such scheme or parameter, a value that is not allowed, or a scheme that refines another domain
            or takes no creases.
        MeshError: the mesh or the curves cannot be refined; an edge or vertex at fault is named.
    """
    declared = _declared(scheme, parameters)
    if isinstance(mesh, str | os.PathLike) and isinstance(declared, CurveScheme):
        from meshfit.mesh.io.files import load_curves

        mesh = load_curves(os.fspath(mesh))
    if isinstance(mesh, Curves):
        curves = refine(Chains.of(mesh), declared, levels)
        return Curves(curves(mesh.verts), curves.chains.corners, curves.chains.sizes, curves.chains.closed)
    if creases is not None and isinstance(scheme, str):
        require_takes_creases(declared, scheme)
    if not isinstance(mesh, Mesh | PolygonMesh):
        by_name = isinstance(mesh, str | os.PathLike)
        mesh = as_mesh(mesh, triangles=by_name and not isinstance(declared, PolygonScheme))
    topology = Topology.of(mesh) if isinstance(mesh, Mesh) else PolygonTopology.of(mesh)
    refinement = refine(topology, declared, levels, creases)
    return refined_mesh(mesh, declared, refinement, creases)


def refined_mesh(
    mesh: Mesh | PolygonMesh,
    scheme: Scheme,
    refinement: Refinement | PolygonRefinement,
    creases: Creases | None = None,
    verts: Verts | None = None,
) -> Mesh | PolygonMesh:
    """Return a mesh refined, with its attributes.

    Args:
        mesh: the coarse mesh.
        scheme: the scheme.
        refinement: of the mesh by the scheme.
        creases: of the mesh, if it has any.
        verts: the fine positions, if they are others than the scheme's.
    """
    assert not isinstance(scheme, CurveScheme)  # noqa: S101  `refine` has refused it
    fine = refinement(mesh.verts) if verts is None else verts
    attributes = refined_attributes(mesh, scheme, refinement.operators, creases)
    if isinstance(refinement, Refinement):
        return Mesh(fine, refinement.faces, attributes)
    polygons = refinement.mesh(fine)
    return polygons.with_attributes(attributes) if attributes else polygons


@no_type_check
def _declared(scheme: str | Scheme, parameters: Mapping[str, ParameterValue]) -> Scheme:
    arrays = {key: value for key, value in parameters.items() if np.ndim(value)}
    declared = resolve(scheme, **{key: _scalar(value) for key, value in parameters.items() if key not in arrays})
    for key, values in arrays.items():
        if key != "alpha":
            raise SchemeError(f"parameter '{key}' takes one value, not an array")
        declared = declared.with_alpha(np.asarray(values, dtype=np.float64))
    return declared


def _scalar(value: ParameterValue) -> Value:
    return value.item() if isinstance(value, np.ndarray | np.generic) else value


def require_takes_creases(scheme: Scheme, name: str = "this scheme") -> None:
    """Refuse a scheme whose boundary rule does not serve along creases.

    Args:
        scheme: any scheme.
        name: its name in the message.

    Raises:
        SchemeError: it takes no creases.
    """
    if not (isinstance(scheme, TriangleScheme) and scheme.takes_creases):
        raise SchemeError(f"{name} takes no creases; loop, interp-loop and midpoint do")


def _require_alphas(scheme: Scheme, num_verts: int) -> None:
    shape = np.shape(scheme.alpha) if scheme.alpha is not None else ()
    if shape not in ((), (num_verts,)):
        raise MeshError(f"alpha has shape {shape}; expected one value for each of {num_verts} vertices")


def linear_scheme(scheme: Scheme) -> Scheme | None:
    """Return linear interpolation on the same split; None where the split drops old vertices, and for √3."""
    if isinstance(scheme, PolygonScheme):
        return LINEAR_SCHEMES.get(scheme.split)
    return MIDPOINT if scheme.split is Split.QUADRISECT else None
