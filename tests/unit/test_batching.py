"""Batching: every problem once, as many as fit in memory, and the same number of steps done."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from meshfit.fitting import batch as fitting
from meshfit.fitting.batch import batches, steps_done
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from meshfit.settings import build

SETTINGS = build(FirstOrderSettings, {"samples": 10})
CPU = torch.device("cpu")


def problem(faces, done=None):
    """With a source of so many faces."""
    source = Mesh(cube().verts, np.resize(cube().faces, (faces, 3)))
    return Problem(source, cube(), resume=None if done is None else {"done": done})


def bytes_needed(problem):
    """600 for each vertex and face of the source, face of the target, and sample on both."""
    return 600 * (problem.source.num_verts + problem.source.num_faces + problem.target.num_faces + 20)


PROBLEMS = st.lists(st.builds(problem, st.integers(1, 3000), st.none() | st.integers(0, 3)), max_size=12)


@given(PROBLEMS, st.floats(1, 4e6))
def test_every_problem_is_in_one_batch_and_no_batch_is_too_large_or_mixed(problems, room):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "_CPU_BYTES", room)
        found = batches(problems, SETTINGS, CPU)
    assert sorted(index for batch in found for index in batch) == list(range(len(problems)))
    for batch in found:
        assert batch == sorted(batch)
        assert len({steps_done(problems[index]) for index in batch}) == 1
        assert len(batch) == 1 or sum(bytes_needed(problems[index]) for index in batch) <= room


@given(PROBLEMS, st.floats(1, 4e6))
def test_no_batch_ends_while_the_next_problem_would_fit_in(problems, room):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "_CPU_BYTES", room)
        found = batches(problems, SETTINGS, CPU)
    for batch, following in pairwise(found):
        alike = steps_done(problems[batch[0]]) == steps_done(problems[following[0]])
        filled = sum(bytes_needed(problems[index]) for index in (*batch, following[0]))
        assert not alike or filled > room


def test_a_problem_larger_than_the_memory_has_a_batch_of_its_own(monkeypatch):
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1e6)
    assert batches([problem(n) for n in (10, 10, 3000, 10, 10)], SETTINGS, CPU) == [[0, 1], [2], [3, 4]]
    assert batches([problem(3000)] * 3, SETTINGS, CPU) == [[0], [1], [2]]


def test_resumed_problems_are_batched_by_steps_done():
    problems = [problem(10, done) for done in (5, None, 3, 5, 0, 3)]
    assert batches(problems, SETTINGS, CPU) == [[1, 4], [2, 5], [0, 3]]


def test_no_problems_make_no_batches():
    assert batches([], SETTINGS, CPU) == []


@pytest.mark.parametrize(
    ("device", "places"), [("cuda", [[0, 1], [2]]), ("mps", [[0, 1, 2]]), ("cpu", [[0], [1], [2]])]
)
def test_the_room_is_half_the_memory_of_the_device(device, places, monkeypatch):
    size = bytes_needed(problem(100))
    monkeypatch.setattr(fitting, "_CPU_BYTES", 1.0 * size)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (4 * size, 99 * size))
    monkeypatch.setattr(torch.mps, "recommended_max_memory", lambda: 6 * size)
    assert batches([problem(100)] * 3, SETTINGS, torch.device(device)) == places
