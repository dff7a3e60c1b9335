"""Refinement operators on torch tensors."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
from jaxtyping import Int64
from scipy.sparse import coo_array, csr_array, eye_array
from torch import Tensor

from meshfit.errors import MeshError
from meshfit.mesh.curves import Chains
from meshfit.mesh.mesh import Faces, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology
from meshfit.subdivision.creases import Creases

if TYPE_CHECKING:
    import torch


def sparse_tensor(operator: csr_array, dtype: torch.dtype, device: torch.device | str) -> Tensor:
    """A sparse COO tensor of the operator, which products differentiate through on every device that has them."""
    entries = coo_array(operator)
    indices = torch.stack([torch.as_tensor(entries.row.astype("int64")), torch.as_tensor(entries.col.astype("int64"))])
    values = torch.as_tensor(entries.data, dtype=dtype)
    return torch.sparse_coo_tensor(
        indices, values, tuple(operator.shape), is_coalesced=True, check_invariants=False
    ).to(device)


def apply_to_tensor(operators: Iterable[csr_array], values: Tensor) -> Tensor:
    """Apply each operator in turn to a (V, …) tensor, in its dtype and on its device."""
    values = values if values.is_floating_point() else values.double()
    flat = values.reshape(len(values), prod(values.shape[1:]))
    for operator in operators:
        flat = torch.sparse.mm(sparse_tensor(operator, values.dtype, values.device), flat)
    return flat.reshape(-1, *values.shape[1:])


Values = TypeVar("Values", np.ndarray, "torch.Tensor")


@dataclass(frozen=True, eq=False)
class Operators:
    """The operators of some levels.

    Attributes:
        num_coarse: V, the number of vertices refined.
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
            flat = values.reshape(self.num_coarse, prod(values.shape[1:]))
            for operator in self.operators:
                flat = operator @ flat
            fine = flat.reshape(-1, *values.shape[1:])
            return fine.astype(values.dtype) if np.issubdtype(values.dtype, np.floating) else fine

        return apply_to_tensor(self.operators, values)


@dataclass(frozen=True, eq=False)
class Refinement(Operators):
    """What some levels of a scheme make of triangles.

    Attributes:
        faces: (F', 3) the finest faces.
        creases: what is left of the creases on the finest level, if there were any.
    """

    faces: Faces
    creases: Creases | None = None


@dataclass(frozen=True, eq=False)
class CurveRefinement(Operators):
    """What some levels of a scheme make of curves.

    Attributes:
        chains: the finest chains.
    """

    chains: Chains


@dataclass(frozen=True, eq=False)
class PolygonRefinement(Operators):
    """What some levels of a scheme make of polygons.

    Attributes:
        finest: the finest connectivity.
    """

    finest: PolygonTopology

    def mesh(self, verts: Verts) -> PolygonMesh:
        """The finest faces with their verts at these places."""
        return PolygonMesh(verts, self.finest.corners, self.finest.sizes)


def finest_triangles(
    refinement: Refinement | PolygonRefinement, verts: Verts
) -> tuple[Int64[np.ndarray, "G 3"], PolygonTopology | None]:
    """The finest faces as triangles, and the polygons whose fans they are, if they are any.

    Polygons are cut by their shortest diagonals, with their verts at these places.
    """
    if isinstance(refinement, Refinement):
        return refinement.faces, None
    mesh = refinement.mesh(verts).with_short_diagonals()
    return mesh.triangulated().faces, PolygonTopology.of(mesh)
