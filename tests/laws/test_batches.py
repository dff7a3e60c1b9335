"""On the CPU, each result is byte-identical regardless of the rest of the batch."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from meshfit.errors import MeshError
from meshfit.fitting import batch as fitting
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from meshfit.settings import build
from tests.fits import fit
from tests.ragged import PROBLEMS, alone, bytes_of

pytestmark = pytest.mark.usefixtures("without_shape_checks")

WEIGHTS = {"chamfer": 1.0, "normal": 0.02, "edge": 0.5, "laplacian": 0.1, "consistency": 0.05}
OPTIMIZERS = {"sgd": {"name": "sgd", "lr": 0.4}, "adam": {"name": "adam", "lr": 0.02}}
KINDS = list(product(OPTIMIZERS, ["float32", "float64"], ["uniform", "cotangent"]))
EACH_KIND = pytest.mark.parametrize("kind", KINDS, ids="-".join)


def options(kind):
    optimizer, dtype, laplacian = kind
    settings = {"steps": 5, "samples": 45, "trace_every": 2, "losses": WEIGHTS}
    settings |= {"laplacian": laplacian, "optimizer": OPTIMIZERS[optimizer]}
    return {"settings": build(FirstOrderSettings, settings), "dtype": dtype, "device": "cpu"}


@cache
def expected(place, kind):
    return bytes_of(alone(PROBLEMS[place], **options(kind)))


def together(places, kind, **changes):
    return [bytes_of(outcome) for outcome in fit_batch([PROBLEMS[i] for i in places], **options(kind), **changes)]


@pytest.fixture
def one_batch(monkeypatch):
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1e18)


@EACH_KIND
@pytest.mark.usefixtures("one_batch")
def test_problems_of_all_sizes_side_by_side_end_as_each_does_alone(kind):
    assert together(range(7), kind) == [expected(i, kind) for i in range(7)]


@EACH_KIND
@pytest.mark.usefixtures("one_batch")
def test_neither_order_nor_the_rest_of_the_batch_matters(kind):
    generator = np.random.default_rng(KINDS.index(kind))
    for count in (7, generator.integers(2, 7)):
        places = generator.permutation(7)[:count].tolist()
        assert together(places, kind) == [expected(i, kind) for i in places], places


@pytest.mark.parametrize(("room", "batch_sizes"), [(0.0, [1] * 7), (250e3, [2, 2, 2, 1]), (400e3, [4, 3]), (1e18, [7])])
def test_problems_are_independent_however_many_fit_into_a_batch(room, batch_sizes, monkeypatch):
    sizes = []

    def spy(problems, *arguments):
        sizes.append(len(problems))
        return FirstOrder(problems, *arguments)

    monkeypatch.setattr(fitting, "_CPU_BYTES", room)
    monkeypatch.setitem(fitting.ENGINES, "first-order", spy)
    outcomes = together([6, 0, 5, 3, 1, 4, 2], KINDS[0])
    assert sizes == batch_sizes
    assert outcomes == [expected(i, KINDS[0]) for i in (6, 0, 5, 3, 1, 4, 2)]


@pytest.mark.usefixtures("one_batch")
def test_threads_change_no_byte():
    assert together(range(7), KINDS[0], threads=3) == [expected(i, KINDS[0]) for i in range(7)]


def test_a_batch_of_one_is_a_fit():
    for place, problem in enumerate(PROBLEMS):
        result = fit(problem.source, problem.target, seed=problem.seed, **options(KINDS[0]))
        assert [bytes_of(result)] == together([place], KINDS[0])


@pytest.mark.usefixtures("one_batch")
def test_the_same_problem_twice_has_the_same_result_twice():
    assert together([2, 5, 2], KINDS[0]) == [expected(i, KINDS[0]) for i in (2, 5, 2)]


@pytest.mark.usefixtures("one_batch")
def test_problems_that_differ_in_their_seed_alone_have_different_results():
    problems = [Problem(PROBLEMS[0].source, PROBLEMS[0].target, seed) for seed in range(3)]
    outcomes = [bytes_of(outcome) for outcome in fit_batch(problems, **options(KINDS[0]))]
    assert len(set(outcomes)) == 3
    assert outcomes == [bytes_of(alone(problem, **options(KINDS[0]))) for problem in problems]


def test_no_problems_have_no_results():
    assert fit_batch([]) == []


def test_each_problem_is_told_of_its_own_steps():
    seen = [[] for _ in PROBLEMS]
    problems = [Problem(p.source, p.target, p.seed, seen[i].append) for i, p in enumerate(PROBLEMS)]
    outcomes = fit_batch(problems, steps=5, samples=30, trace_every=1, device="cpu")
    for steps, outcome in zip(seen, outcomes, strict=True):
        assert [(step.done, step.steps) for step in steps] == [(k + 1, 5) for k in range(5)]
        assert [step.loss for step in steps] == [row[1] for row in outcome.trace.rows]


@pytest.mark.parametrize("role", ["source", "target"])
def test_a_mesh_that_is_refused_is_named_with_its_place_before_anything_is_fitted(role):
    meshes = {"source": cube(), "target": cube()}
    fine, spoilt = (
        Problem(**(meshes | change), on_step=pytest.fail) for change in ({}, {role: Mesh(cube().verts, [])})
    )
    with pytest.raises(MeshError) as caught:
        fit_batch([fine, fine, fine, spoilt, fine], device="cpu")
    assert str(caught.value) == f"problem 3: {role}: the mesh has no area"
