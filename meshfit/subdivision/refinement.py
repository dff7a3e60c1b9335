"""Refinements: the operators of some levels, which act on numpy arrays and torch tensors, and the finest mesh."""

from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jaxtyping import Int64
from scipy.sparse import coo_array, csr_array, eye_array

from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains
from meshfit.mesh.mesh import Faces, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.creases import Creases

if TYPE_CHECKING:
    import torch

Values = TypeVar("Values", np.ndarray, "torch.Tensor")


def sparse_tensor(operator: csr_array, dtype: "torch.dtype", device: "torch.device | str") -> "torch.Tensor":
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
            flat = torch.sparse.mm(sparse_tensor(operator, tensor.dtype, tensor.device), flat)
        return flat.reshape(-1, *rest)


@dataclass(frozen=True, eq=False)
class Refinement(Operators):
    """Some levels of a scheme on triangles.

    Attributes:
        faces: (F', 3) the finest faces.
        creases: the creases that remain on the finest level; None if there were none.
    """

    faces: Faces
    creases: Creases | None = None


@dataclass(frozen=True, eq=False)
class CurveRefinement(Operators):
    """Some levels of a scheme on curves.

    Attributes:
        chains: the finest chains.
    """

    chains: Chains


@dataclass(frozen=True, eq=False)
class PolygonRefinement(Operators):
    """Some levels of a scheme on polygons.

    Attributes:
        finest: the finest connectivity.
    """

    finest: PolygonTopology

    def mesh(self, verts: Verts) -> PolygonMesh:
        """Return the finest faces with their vertices at these positions."""
        return PolygonMesh(verts, self.finest.corners, self.finest.sizes)


def finest_triangles(
    refinement: Refinement | PolygonRefinement, verts: Verts
) -> tuple[Int64[np.ndarray, "G 3"], PolygonTopology | None]:
    """Return the finest faces as triangles, with their vertices at these positions, and their polygons, if any."""
    if isinstance(refinement, Refinement):
        return refinement.faces, None
    return refinement.mesh(verts).triangulated().faces, refinement.finest
