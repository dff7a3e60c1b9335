"""Refinement operators on torch tensors."""

from collections.abc import Iterable
from math import prod

import torch
from scipy.sparse import coo_array, csr_array
from torch import Tensor


def as_tensor(operator: csr_array, dtype: torch.dtype, device: torch.device | str) -> Tensor:
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
        flat = torch.sparse.mm(as_tensor(operator, values.dtype, values.device), flat)
    return flat.reshape(-1, *values.shape[1:])
