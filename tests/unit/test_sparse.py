"""Sparse matrices against dense ones: products, gradients, and both representations."""

import numpy as np
import pytest
import torch
from scipy.sparse import coo_array
from torch.autograd import gradcheck

from meshfit.loss.sparse import CooMatrix, Sparse
from tests.elsewhere import make_here

CPU = torch.device("cpu")


def entries(seed=0, shape=(7, 5), count=12):
    """At random places, two of them taken twice; the last row and the first column are empty."""
    generator = np.random.default_rng(seed)
    rows, columns = generator.integers(shape[0] - 1, size=count), generator.integers(1, shape[1], size=count)
    rows[-2:], columns[-2:] = rows[:2], columns[:2]
    return coo_array((generator.normal(size=count), (rows, columns)), shape=shape)


CASES = {
    "tall": entries(),
    "wide": entries(1, (4, 9), 20),
    "with a 0 written out": coo_array(([1.0, -1.0, 2.0], ([0, 0, 1], [1, 1, 0])), shape=(2, 2)),
    "without entries": coo_array((3, 4)),
    "without rows": coo_array((0, 4)),
}
EACH = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
DTYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def vectors(count, dtype=torch.float64):
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(count), dtype=dtype)


@pytest.fixture(params=["compressed rows", "entries"])
def make(request, monkeypatch):
    """A matrix as it is on the CPU, and as on a device without compressed rows, though its tensors are on the CPU."""
    if request.param == "compressed rows":
        return lambda case, dtype=torch.float64: Sparse.of(case, dtype, CPU)
    make_here(monkeypatch)

    def as_entries(case, dtype=torch.float64):
        matrix = Sparse.of(case, dtype, torch.device("mps"))
        assert isinstance(matrix.forward, CooMatrix)
        assert isinstance(matrix.backward, CooMatrix)
        return matrix

    return as_entries


@EACH
@DTYPES
def test_products_are_those_of_the_dense_matrix(case, dtype, make):
    matrix, dense = make(case, dtype), torch.tensor(case.toarray(), dtype=dtype)
    ahead, back = vectors(case.shape[1], dtype), vectors(case.shape[0], dtype)
    torch.testing.assert_close(matrix @ ahead, dense @ ahead)
    torch.testing.assert_close(matrix.T @ back, dense.T @ back)
    assert (matrix @ ahead).dtype == dtype


@EACH
def test_gradients_are_those_of_the_dense_matrix(case, make):
    matrix, dense = make(case), torch.tensor(case.toarray())
    assert gradcheck(lambda x: matrix @ x, vectors(case.shape[1]).requires_grad_())
    ours, theirs = (vectors(case.shape[1]).requires_grad_() for _ in range(2))
    along = vectors(case.shape[0])
    ((matrix @ ours) * along).sum().backward()
    ((dense @ theirs) * along).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


@EACH
def test_a_matrix_transposed_twice_is_itself(case, make):
    matrix = make(case)
    assert matrix.T.T.forward is matrix.forward
    assert torch.equal(matrix.T.T @ vectors(case.shape[1]), matrix @ vectors(case.shape[1]))


@EACH
def test_both_ways_to_hold_a_matrix_have_the_same_entries(case, monkeypatch):
    rows = Sparse.of(case, torch.float64, CPU).forward
    make_here(monkeypatch)
    held = Sparse.of(case, torch.float64, torch.device("mps")).forward
    assert torch.equal(rows.values(), held.values[:, 0])
    assert torch.equal(rows.col_indices().long(), held.columns)
    counts = torch.bincount(held.rows, minlength=case.shape[0])
    assert torch.equal(rows.crow_indices().diff().long(), counts)
    assert held.height == case.shape[0]


def test_entries_at_the_same_place_add_up(make):
    twice = coo_array(([1.5, 2.0, -1.0, 0.25], ([1, 0, 1, 1], [2, 0, 2, 2])), shape=(2, 3))
    product = make(twice) @ torch.eye(3, dtype=torch.float64)
    assert product.tolist() == [[2, 0, 0], [0, 0, 0.75]]


def test_a_row_depends_on_its_own_entries_alone(make):
    matrix = make(CASES["tall"])
    dense = vectors(5)
    dense[2] = torch.nan
    touched = CASES["tall"].toarray()[:, 2] != 0
    assert (matrix @ dense).isnan().any(1).tolist() == touched.tolist()
