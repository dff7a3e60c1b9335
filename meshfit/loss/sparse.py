"""Constant sparse matrices, differentiable with respect to what they are multiplied with."""

import warnings
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int64
from scipy.sparse import coo_array, csr_array
from torch import Tensor
from torch.autograd.function import Function, once_differentiable

from meshfit.loss.autograd import apply


@dataclass(frozen=True, eq=False)
class CooMatrix:
    """A sparse matrix as a list of entries, for devices without compressed sparse rows; it has `height` rows."""

    rows: Int64[Tensor, " N"]
    columns: Int64[Tensor, " N"]
    values: Float[Tensor, "N 1"]
    height: int

    def __matmul__(self, dense: Float[Tensor, "C 3"]) -> Float[Tensor, "R 3"]:
        products = self.values * dense.index_select(0, self.columns)
        return products.new_zeros(self.height, 3).index_add(0, self.rows, products)


@dataclass(frozen=True, eq=False)
class Sparse:
    """An (R, C) matrix: `matrix @ x` maps (C, 3) to (R, 3), differentiably."""

    forward: Any
    backward: Any

    @classmethod
    def of(cls, entries: coo_array | csr_array, dtype: torch.dtype, device: torch.device) -> "Sparse":
        """Return the matrix of these entries; duplicates are summed."""
        return cls(_matrix(entries.tocsr(), dtype, device), _matrix(entries.T.tocsr(), dtype, device))

    @property
    def T(self) -> "Sparse":  # noqa: N802  as tensors and arrays name it
        """The transpose."""
        return Sparse(self.backward, self.forward)

    def __matmul__(self, dense: Float[Tensor, "C 3"]) -> Float[Tensor, "R 3"]:
        return apply(_Product, dense, self.forward, self.backward)


class _Product(Function):
    @staticmethod
    def forward(ctx: Any, dense: Tensor, matrix: Any, transposed: Any) -> Tensor:  # noqa: ANN401  torch's context
        ctx.transposed = transposed
        product: Tensor = matrix @ dense
        return product

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:  # noqa: ANN401  torch's context
        return ctx.transposed @ gradient, None, None


def _matrix(rows: csr_array, dtype: torch.dtype, device: torch.device) -> Any:  # noqa: ANN401  a tensor or a CooMatrix
    rows.sort_indices()
    if device.type != "cpu":
        entries = rows.tocoo()
        row, column = (torch.tensor(part, dtype=torch.int64, device=device) for part in (entries.row, entries.col))
        return CooMatrix(row, column, torch.tensor(entries.data, dtype=dtype, device=device)[:, None], rows.shape[0])
    start, columns = (torch.tensor(part, dtype=torch.int32) for part in (rows.indptr, rows.indices))
    return compressed_rows(start, columns, torch.tensor(rows.data, dtype=dtype), rows.shape[1])


def compressed_rows(start: Tensor, columns: Tensor, values: Tensor, width: int) -> Tensor:
    """Return a sparse tensor in compressed rows.

    Args:
        start: (R + 1,) int32, start of each row, and end of the last.
        columns: (N,) int32, ascending in each row.
        values: (N,) entries.
        width: number of columns.
    """
    with warnings.catch_warnings():
        for text in ("Sparse CSR tensor support is in beta", "Sparse invariant checks are implicitly disabled"):
            warnings.filterwarnings("ignore", text, UserWarning)
        return torch.sparse_csr_tensor(start, columns, values, (len(start) - 1, width), check_invariants=False)
