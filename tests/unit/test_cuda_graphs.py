"""CUDA-graph capture: number of calls, and replays as the engine uses them."""

from contextlib import contextmanager

import pytest
import torch

from meshfit.errors import MeshfitWarning
from meshfit.fitting import first_order
from meshfit.fitting.device import as_cuda_graph
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.settings import build
from tests.ragged import LATE, PROBLEMS, SHAKY

CUDA, GENERATORS = torch.device("cuda"), [torch.Generator(), torch.Generator()]


class Graph:
    """Stands in for a CUDA graph and notes what is done with it."""

    made: list["Graph"]

    def __init__(self):
        self.generators, self.done = [], []
        self.made.append(self)

    def register_generator_state(self, generator):
        self.generators.append(generator)

    def replay(self):
        self.done.append("replay")


@pytest.fixture
def graphs(monkeypatch):
    @contextmanager
    def capturing(graph):
        graph.done.append("capture")
        yield

    monkeypatch.setattr(Graph, "made", [], raising=False)
    monkeypatch.setattr(torch.cuda, "CUDAGraph", Graph)
    monkeypatch.setattr(torch.cuda, "graph", capturing)
    return Graph.made


class Function:
    """Gives a new list each time, and fails at the calls it is told to."""

    def __init__(self, *failing):
        self.calls, self.failing = 0, failing

    def __call__(self):
        self.calls += 1
        if self.calls in self.failing:
            raise RuntimeError("operation not permitted when stream is capturing\nand much more")
        return [self.calls]


@pytest.mark.parametrize("device", ["cpu", "mps"])
def test_a_function_is_left_as_it_is_on_other_devices(device):
    function = Function()
    assert as_cuda_graph(function, GENERATORS, torch.device(device)) is function


def test_a_function_is_called_a_few_times_then_captured_once_and_replayed_from_then_on(graphs):
    function = Function()
    step = as_cuda_graph(function, GENERATORS, CUDA)
    results = [step() for _ in range(8)]
    assert results == [[1], [2], [3], [4], [4], [4], [4], [4]]
    assert all(result is results[3] for result in results[3:])
    assert function.calls == 4
    (graph,) = graphs
    assert graph.done == ["capture"] + 5 * ["replay"]
    assert graph.generators == GENERATORS


def test_a_function_that_cannot_be_captured_is_warned_of_once_and_called_from_then_on(graphs):
    function = Function(4)
    step = as_cuda_graph(function, GENERATORS, CUDA)
    for _ in range(3):
        step()
    with pytest.warns(MeshfitWarning) as caught:
        assert step() == [5]
    assert [str(warning.message) for warning in caught] == [
        "steps run without a CUDA graph, and slower: operation not permitted when stream is capturing"
    ]
    assert [step() for _ in range(4)] == [[6], [7], [8], [9]]
    assert [graph.done for graph in graphs] == [["capture"]]


def test_an_error_outside_of_the_capture_is_let_through(graphs):
    step = as_cuda_graph(Function(3), GENERATORS, CUDA)
    step()
    step()
    with pytest.raises(RuntimeError):
        step()
    assert not graphs


class Replayed:
    """Does what replays do, on the CPU: each result is written over the tensors of the first."""

    def __init__(self, function, generators, device):
        self.function, self.first = function, None

    def __call__(self):
        result = self.function()
        if self.first is None:
            self.first = result
        overwrite(self.first, result)
        return self.first


def overwrite(old, new):
    if old is new:
        return
    if isinstance(old, torch.Tensor):
        old.data.copy_(new.data)
        return
    parts = new if isinstance(new, dict) else getattr(new, "__dict__", {})
    held = old if isinstance(old, dict) else getattr(old, "__dict__", {})
    for name in parts.keys() & held.keys():  # what was worked out later, from the first result, stays as it is
        overwrite(held[name], parts[name])


def stepped(problems, changes):
    """What an engine holds when it has made its steps, or when one of its problems has diverged."""
    settings = build(FirstOrderSettings, {"samples": 40, "trace_every": 1} | changes)
    engine = FirstOrder(problems, settings, torch.device("cpu"), torch.float32)
    while not engine.failed and engine.done < engine.settings.steps:
        engine.step()
    failed = {k: (d.step, d.term, d.last_good.verts.tolist()) for k, d in engine.failed.items()}
    held = [
        (engine.traces[k].to_csv(), engine.mesh(k).verts.tobytes(), engine.checkpoint(k)["last_good"].tolist())
        for k in range(len(problems))
    ]
    return failed, held


RUNS = {
    "a term of weight 0": {"steps": 6, "losses": {"normal": 0.0}},
    "all terms": {"steps": 6, "losses": {"normal": 0.01}, "laplacian": "cotangent"},
    "only terms of points": {"steps": 6, "losses": {"edge": 0.0, "laplacian": 0.0, "consistency": 0.0}},
    "adam": {"steps": 6, "optimizer": {"name": "adam", "lr": 0.01}},
    "out of range": SHAKY,
}


@pytest.mark.parametrize("changes", RUNS.values(), ids=RUNS)
@pytest.mark.parametrize("problems", [[LATE[0]], [PROBLEMS[4], LATE[0], PROBLEMS[0]]], ids=["one", "three"])
def test_an_engine_takes_from_replays_what_it_takes_from_calls(changes, problems, monkeypatch):
    expected = stepped(problems, changes)
    monkeypatch.setattr(first_order, "as_cuda_graph", Replayed)
    assert stepped(problems, changes) == expected


def test_the_last_good_mesh_is_not_replayed_over(monkeypatch):
    calls, term = [], first_order.TERMS["edge"]

    def failing(state):
        if torch.is_grad_enabled():  # and not while a row is traced
            calls.append(state)
        return term(state) * (torch.nan if len(calls) == 4 else 1.0)

    monkeypatch.setitem(first_order.TERMS, "edge", failing)
    expected = stepped(PROBLEMS[:1], {})
    assert expected[0][0][:2] == (3, "edge")
    calls.clear()
    monkeypatch.setattr(first_order, "as_cuda_graph", Replayed)
    assert stepped(PROBLEMS[:1], {}) == expected
