"""Steps on devices that this machine lacks.

On torch's meta device tensors have shapes and no numbers, so that whatever waits for a result raises; and a step that
never does so can be captured as a CUDA graph. For numbers, the CPU is pretended to be another device.
"""

from functools import partial

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from meshfit.fitting import first_order
from meshfit.fitting import nearest_neighbours as matching
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.loss import sparse
from meshfit.mesh.solids import cube, icosahedron
from meshfit.settings import build
from tests.elsewhere import make_here, pretend_elsewhere
from tests.ragged import PROBLEMS

RAGGED = [PROBLEMS[i] for i in (4, 1, 0)]
WEIGHTS = {"chamfer": 1.0, "normal": 0.02, "edge": 0.5, "laplacian": 0.1, "consistency": 0.05}
PROBLEM_LISTS = pytest.mark.parametrize("problems", [PROBLEMS[:1], RAGGED], ids=["one", "three"])
LAPLACIANS = pytest.mark.parametrize("laplacian", ["uniform", "cotangent"])


def engine_on(device, problems, dtype=torch.float32, **changes):
    settings = build(FirstOrderSettings, {"steps": 6, "samples": 50, "trace_every": 1, "losses": WEIGHTS} | changes)
    return FirstOrder(problems, settings, torch.device(device), dtype)


class Watch(TorchDispatchMode):
    """Notes each operator that is called, and each tensor that goes into one or comes out."""

    def __init__(self):
        super().__init__()
        self.operators, self.tensors = [], []

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        result = operator(*args, **(kwargs or {}))
        self.operators.append(str(operator))
        self.tensors += [leaf for leaf in tree_leaves((args, kwargs, result)) if isinstance(leaf, torch.Tensor)]
        return result


@pytest.fixture
def on_meta(monkeypatch):
    """Make an engine on the meta device; only what looks at its numbers, and its generators, are left out."""

    class Here:
        """torch, with generators of the CPU in place of others."""

        Generator = staticmethod(lambda _: torch.Generator())
        __getattr__ = staticmethod(partial(getattr, torch))

    monkeypatch.setattr(first_order, "torch", Here())
    monkeypatch.setattr(FirstOrder, "_fail_on_positions", lambda _: None)
    return lambda problems, **changes: engine_on("meta", problems, **changes)


@PROBLEM_LISTS
@LAPLACIANS
@pytest.mark.parametrize("normal", [0.0, 0.02])
def test_a_step_stays_on_its_device_and_never_waits_for_it(problems, laplacian, normal, on_meta):
    engine = on_meta(problems, laplacian=laplacian, losses=WEIGHTS | {"normal": normal})
    with Watch() as watch:
        now = engine._evaluate_eagerly()
    assert {tensor.device.type for tensor in watch.tensors} == {"meta"}
    assert now.values.shape == (len(now.terms), len(problems))
    assert now.gradient.shape == (sum(problem.source.num_verts for problem in problems), 3)
    assert all(value.requires_grad for value in now.terms.values())  # so the backward pass has been run, too


@PROBLEM_LISTS
@LAPLACIANS
def test_a_step_calls_nothing_that_mps_does_not_have(problems, laplacian, on_meta):
    """Neither sparse tensors, of which it has next to none, nor float64."""
    with Watch() as watch:
        engine = on_meta(problems, laplacian=laplacian)
        engine._evaluate_eagerly()
    assert not [operator for operator in watch.operators if "sparse" in operator or "csr" in operator]
    there = [tensor for tensor in watch.tensors if tensor.device.type == "meta"]
    assert {tensor.layout for tensor in there} == {torch.strided}
    assert {tensor.dtype for tensor in there} <= {torch.float32, torch.int64, torch.bool}
    assert "aten.index_add.default" in watch.operators


@pytest.mark.parametrize(
    "wait", [lambda t: t.sum().item(), lambda t: t.tolist(), lambda t: t.cpu(), lambda t: t[t > 0]]
)
def test_the_meta_device_refuses_what_waits(wait):
    with pytest.raises((RuntimeError, NotImplementedError)):
        wait(torch.ones(3, device="meta"))


def test_the_watch_sees_tensors_of_another_device():
    with Watch() as watch:
        torch.zeros(3, device="meta").index_put_((torch.tensor([0]),), torch.tensor(1.0))
    assert {tensor.device.type for tensor in watch.tensors} == {"cpu", "meta"}


@pytest.fixture
def sorted_draws(monkeypatch):
    """Draws whose first row comes sorted, as other devices do not sort it and would have other samples."""
    uniform = torch.Tensor.uniform_

    def drawn(numbers, generator):
        numbers.copy_(uniform(torch.empty_like(numbers), generator=generator))
        numbers[0] = numbers[0].sort().values
        return numbers

    monkeypatch.setattr(torch.Tensor, "uniform_", drawn)


def fitted(engine):
    while engine.done < engine.settings.steps:
        engine.step()
    members = range(len(engine.problems))
    assert not engine.failed
    return [np.array(engine.traces[k].rows) for k in members], [engine.mesh(k).verts for k in members]


@pytest.mark.parametrize("optimizer", [{"name": "sgd", "lr": 0.4}, {"name": "adam", "lr": 0.02}], ids=["sgd", "adam"])
@PROBLEM_LISTS
@LAPLACIANS
@pytest.mark.usefixtures("sorted_draws")
def test_the_numbers_of_other_devices_are_those_of_the_cpu(problems, laplacian, optimizer, monkeypatch):
    changes = {"laplacian": laplacian, "optimizer": optimizer, "dtype": torch.float64}
    rows, verts = fitted(engine_on("cpu", problems, **changes))
    matrix = sparse._matrix
    with monkeypatch.context() as patch:
        patch.setattr(sparse, "_matrix", lambda entries, dtype, _: matrix(entries, dtype, torch.device("meta")))
        make_here(patch)
        pretend_elsewhere(patch)
        patch.setattr(matching, "nearest_point_query", pytest.fail)
        engine = engine_on("cpu", problems, **changes)
        assert isinstance(engine._operators.edges.forward, sparse.CooMatrix)
        assert isinstance(engine._target_table.sums, torch.Tensor)
        other_rows, other_verts = fitted(engine)
    for ours, theirs in zip([*rows, *verts], [*other_rows, *other_verts], strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-9, atol=1e-9)


def test_faces_of_padded_members_are_not_mixed_up_in_float32(monkeypatch):
    """Members of very different numbers and sizes of faces, far more samples than faces."""
    problems = [Problem(icosahedron(), cube(), 1), *RAGGED]
    pretend_elsewhere(monkeypatch)
    engine = engine_on("cpu", problems, samples=3000)
    picked = engine._evaluate_eagerly().inputs.source.picked.view(len(problems), -1)
    ends = np.cumsum([problem.source.num_faces for problem in problems]).tolist()
    for first, end, faces in zip([0, *ends], ends, picked.tolist(), strict=False):
        assert set(faces) == set(range(first, end))
