"""Sums over the segments of a batch and their gradients, against loops, for segments of any size."""

import pytest
import torch
from torch.autograd import gradcheck

from meshfit.loss.batch_segments import BatchSegments
from tests.elsewhere import pretend_elsewhere

SIZES = pytest.mark.parametrize("sizes", [[5], [3, 1, 4], [0, 3], [3, 0], [2, 0, 0, 1], [1, 1, 1]], ids=str)
CPU = torch.device("cpu")


def made(sizes):
    members = BatchSegments.of(sizes, CPU)
    values = torch.randn(sum(sizes), generator=torch.Generator().manual_seed(len(sizes)), dtype=torch.float64)
    return members, values, [values[sum(sizes[:k]) :][:size].tolist() for k, size in enumerate(sizes)]


@pytest.fixture(params=["on the CPU", "elsewhere"])
def places(request, monkeypatch):
    if request.param == "elsewhere":
        pretend_elsewhere(monkeypatch)


@SIZES
def test_rows_are_those_of_one_member_after_the_other(sizes):
    members, _, _ = made(sizes)
    assert members.sizes == tuple(sizes)
    assert members.counts.tolist() == [max(size, 1) for size in sizes]
    assert members.first.tolist() == [sum(sizes[:k]) for k in range(len(sizes))]
    assert members.index.tolist() == [k for k, size in enumerate(sizes) for _ in range(size)]


@SIZES
@pytest.mark.usefixtures("places")
def test_sums_and_means_are_those_of_each_members_rows(sizes):
    members, values, parts = made(sizes)
    assert members.sums(values).tolist() == pytest.approx([sum(part) for part in parts])
    assert members.means(values).tolist() == pytest.approx([sum(part) / max(len(part), 1) for part in parts])


@SIZES
@pytest.mark.usefixtures("places")
def test_sums_have_gradients(sizes):
    members, values, _ = made(sizes)
    assert gradcheck(members.sums, values.requires_grad_())


@SIZES
def test_spread_is_the_gradient_of_the_means(sizes):
    members, values, _ = made(sizes)
    weights = torch.arange(1.0, len(sizes) + 1, dtype=torch.float64)
    (gradient,) = torch.autograd.grad((members.means(values.requires_grad_()) * weights).sum(), values)
    spread = members.spread(weights)
    assert len(spread) == (1 if len(sizes) == 1 else sum(sizes))
    torch.testing.assert_close(spread.expand(sum(sizes), 1)[:, 0], gradient)


@SIZES
def test_padded_rows_end_in_zeros(sizes):
    members, values, parts = made(sizes)
    assert members.padded(values).tolist() == [part + [0.0] * (max(sizes) - len(part)) for part in parts]


def test_a_members_sum_has_the_same_bytes_in_any_company():
    parts = [torch.randn(n, generator=torch.Generator().manual_seed(n)) for n in (1, 7, 1000, 33, 4097)]
    sums = BatchSegments.of([len(part) for part in parts], CPU).sums(torch.cat(parts))
    assert sums.tolist() == [float(BatchSegments.of([len(part)], CPU).sums(part)) for part in parts]
