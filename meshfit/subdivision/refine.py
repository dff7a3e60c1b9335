"""Refinement: some levels of a scheme on a connectivity, as sparse operators on anything given at its vertices."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from meshfit.errors import MeshError, SchemeError
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Faces, Mesh
from meshfit.mesh.topology import Topology
from meshfit.specs import Value
from meshfit.subdivision.assemble import assemble, vertex_attribute_carry
from meshfit.subdivision.choose import scheme_of
from meshfit.subdivision.creases import Creases, require_creases
from meshfit.subdivision.scheme import Scheme
from meshfit.subdivision.splits import divide
from meshfit.subdivision.triangle_scheme import TriangleScheme

if TYPE_CHECKING:
    import torch

Values = TypeVar("Values", np.ndarray, "torch.Tensor")
ParameterValue = Value | NDArray[Any]


@dataclass(frozen=True, eq=False)
class Refinement:
    """What some levels of a scheme make of a connectivity.

    Attributes:
        faces: (F', 3) the finest faces.
        num_coarse: V, the number of vertices refined.
        operators: one sparse operator for each level, coarsest first.
        creases: what is left of the creases on the finest level, if there were any.
    """

    faces: Faces
    num_coarse: int
    operators: tuple[csr_array, ...]
    creases: Creases | None = None

    @cached_property
    def matrix(self) -> csr_array:
        """All levels in one: sparse (V', V), verts_fine = matrix @ verts_coarse."""
        product = csr_array(eye_array(self.num_coarse, format="csr"))
        for operator in self.operators:
            product = csr_array(operator @ product)
        return product

    def __call__(self, values: Values) -> Values:
        """Refine values given at the coarse vertices, positions or any other attribute.

        Args:
            values: (V, …) numpy array or torch tensor. The map is linear, so gradients flow through it.

        Returns:
            (V', …) of the same kind, dtype and device; integers come back as float64.

        Raises:
            MeshError: the number of rows is not the number of coarse vertices.
        """
        if len(values) != self.num_coarse:
            raise MeshError(f"found {len(values)} values; one for each of {self.num_coarse} coarse verts is needed")
        if isinstance(values, np.ndarray):
            flat = values.reshape(self.num_coarse, -1)
            for operator in self.operators:
                flat = operator @ flat
            fine = flat.reshape(-1, *values.shape[1:])
            return fine.astype(values.dtype) if np.issubdtype(values.dtype, np.floating) else fine
        from meshfit.subdivision.tensors import apply_to_tensor

        return apply_to_tensor(self.operators, values)


def refine(topology: Topology, scheme: Scheme, levels: int = 1, creases: Creases | None = None) -> Refinement:
    """Lay down `levels` levels of a scheme.

    Args:
        topology: of the mesh.
        scheme: every parameter fixed.
        levels: how many.
        creases: sharp edges and corners of this topology, for loop, interp-loop and midpoint.

    Raises:
        SchemeError: levels is negative, or the scheme takes no creases.
        MeshError: the mesh is not an oriented manifold; a face, edge or vertex at fault is named.
    """
    if levels < 0:
        raise SchemeError(f"levels={levels} is not allowed: 0 or more is")
    if levels:
        require_manifold(topology, "subdivision")
        _require_alphas(scheme, topology.num_verts)
    if creases is not None:
        require_takes_creases(scheme)
        require_creases(creases, topology)
    num_coarse, operators = topology.num_verts, []
    for step in range(levels):
        division = divide(topology, scheme.split, step)
        operators.append(assemble(topology, scheme, division, creases))
        if scheme.push_back is not None and np.ndim(scheme.push_back.alpha):
            finer = vertex_attribute_carry(topology, division) @ np.asarray(scheme.push_back.alpha)
            scheme = replace(scheme, push_back=replace(scheme.push_back, alpha=finer))
        topology = Topology(topology.num_verts + division.num_new, division.faces)
        creases = None if creases is None else creases.finer(topology.num_verts, topology.edges)
    return Refinement(topology.faces, num_coarse, tuple(operators), creases)


def subdivide(
    mesh: Mesh,
    scheme: str | Scheme,
    levels: int = 1,
    *,
    creases: Creases | None = None,
    **parameters: ParameterValue,
) -> Mesh:
    """Refine a mesh by some levels of a subdivision scheme.

    Args:
        mesh: an oriented manifold, closed or with boundary.
        scheme: a spec such as `loop` or `interp-loop:alpha=0.5`, or a declared scheme.
        levels: how many times; each makes 4 faces of one (√3 schemes: 3, and they refine the boundary at every second
            level, so that two levels at once differ from one and one more where there is a boundary).
        creases: sharp edges and corners, for loop, interp-loop and midpoint; as `creases_by_angle` finds them.
        **parameters: of the scheme, in place of those in the spec. `alpha` may be a (V,) array of one value a vertex.

    Example:
        >>> from meshfit.mesh.solids import icosahedron
        >>> subdivide(icosahedron(), "interp-loop", 2, alpha=0.5).num_faces
        320

    Raises:
        SchemeError: no such scheme or parameter, a value that is not allowed, or a scheme that takes no creases.
        MeshError: the mesh cannot be refined; an edge or vertex at fault is named.
    """
    topology, declared = Topology.of(mesh), _declared(scheme, parameters)
    if creases is not None and isinstance(scheme, str):
        require_takes_creases(declared, scheme)
    refinement = refine(topology, declared, levels, creases)
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
