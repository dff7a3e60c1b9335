"""Determinism: results depend on the seed, not on threads or global generators."""

import numpy as np
import pytest
import torch

from meshfit.fitting.callbacks import Interrupted
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube, icosahedron
from meshfit.subdivision.refine import subdivide
from tests.fits import fit
from tests.shapes import mixed_closed

SOURCE = subdivide(icosahedron(), "loop", 2)
ALL_TERMS = {"normal": 0.01}


def fitted(**changes):
    options = {"steps": 12, "samples": 300, "device": "cpu", "trace_every": 3, "losses": ALL_TERMS} | changes
    result = fit(SOURCE, cube(), **options)
    return result.mesh.verts.tobytes(), result.trace.to_csv()


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("optimizer", ["sgd", "adam"])
def test_the_same_seed_gives_the_same_bytes(dtype, optimizer):
    changes = {"dtype": dtype, "optimizer": {"name": optimizer}, "seed": 5}
    assert fitted(**changes) == fitted(**changes)


def test_another_seed_gives_another_mesh_and_another_trace():
    results = [fitted(seed=seed) for seed in range(4)]
    assert len({verts for verts, _ in results}) == 4
    assert len({trace for _, trace in results}) == 4


def test_seeds_change_samples_and_nothing_else():
    first, second = (fitted(seed=seed)[1].splitlines()[1].split(",") for seed in (0, 1))
    assert first[2:4] != second[2:4]
    assert first[4:] == second[4:]


@pytest.mark.usefixtures("threads")
def test_the_callers_threads_change_no_byte_and_are_given_back():
    results = set()
    for count in (1, 2, 3):
        torch.set_num_threads(count)
        results.add(fitted())
        assert torch.get_num_threads() == count
    assert len(results) == 1


def test_threads_to_search_with_change_no_byte():
    assert len({fitted(threads=count) for count in (1, 2, 3)}) == 1


@pytest.mark.usefixtures("threads")
def test_one_thread_is_in_use_during_a_fit_and_the_callers_after_it_was_stopped():
    def stop(step):
        assert torch.get_num_threads() == 1
        raise Interrupted

    torch.set_num_threads(2)
    with pytest.raises(Interrupted):
        fitted(on_step=stop)
    assert torch.get_num_threads() == 2


def test_global_generators_are_neither_used_nor_changed():
    results = set()
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002  the global generator is what is watched
        torch.manual_seed(seed)
        before = (str(np.random.get_state()), torch.get_rng_state())  # noqa: NPY002  the state of the global generator
        results.add(fitted())
        after = (str(np.random.get_state()), torch.get_rng_state())  # noqa: NPY002  the state of the global generator
        assert before[0] == after[0]
        assert torch.equal(before[1], after[1])
    assert len(results) == 1


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_a_caller_without_gradients_gets_the_same_bytes_and_its_mode_back(mode):
    expected = fitted()
    with mode():
        assert fitted() == expected
        assert not torch.is_grad_enabled()
        assert torch.is_inference_mode_enabled() == (mode is torch.inference_mode)


def test_the_default_dtype_of_the_caller_changes_no_byte():
    expected = fitted()
    torch.set_default_dtype(torch.float64)
    try:
        assert fitted() == expected
    finally:
        torch.set_default_dtype(torch.float32)


def test_single_and_double_precision_agree_early_on():
    """They draw different samples: terms of verts agree closely, terms of samples as two seeds do."""
    rows = {
        dtype: np.array(
            fit(
                SOURCE, cube(), steps=5, samples=4000, trace_every=1, losses=ALL_TERMS, device="cpu", dtype=dtype
            ).trace.rows
        )
        for dtype in ("float32", "float64")
    }
    single, double = rows["float32"], rows["float64"]
    np.testing.assert_allclose(single[0, 4:], double[0, 4:], rtol=1e-5)
    np.testing.assert_allclose(single[:, 2:4], double[:, 2:4], rtol=0.1)
    np.testing.assert_allclose(single[:, 4:], double[:, 4:], rtol=0.02)


def test_points_are_drawn_apart_on_source_and_target():
    """If both were drawn equally, the samples of a mesh fitted to itself would coincide and their distance be 0."""
    mesh = Mesh(mixed_closed().verts, mixed_closed().faces)
    assert fit(mesh, mesh, steps=1, samples=50, device="cpu").trace.rows[0][2] > 1e-3
