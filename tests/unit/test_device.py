"""Device choice: available devices are taken; others are refused in one line that lists what is allowed."""

import pytest
import torch

from meshfit.errors import DeviceError
from meshfit.fitting.device import resolve_device, single_thread
from meshfit.mesh.solids import cube, icosahedron
from tests.fits import fit


@pytest.fixture
def machine(monkeypatch):
    """A machine with so many CUDA devices, and with or without an Apple GPU."""

    def have(cuda=0, *, mps=False):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: cuda > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda: cuda)
        monkeypatch.setattr(torch.backends.mps, "is_available", lambda: mps)

    have()
    return have


def refusal(name, dtype="float32"):
    with pytest.raises(DeviceError) as caught:
        resolve_device(name, dtype)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("device: ")
    assert name in text
    return text


def test_auto_takes_cuda_where_there_is_one(machine):
    assert resolve_device("auto") == torch.device("cpu")
    machine(cuda=1)
    assert resolve_device("auto") == torch.device("cuda")


def test_auto_takes_no_apple_gpu(machine):
    machine(mps=True)
    assert resolve_device("auto", "float64") == torch.device("cpu")


@pytest.mark.parametrize("name", ["cpu", "cpu:0"])
def test_the_cpu_is_always_there(machine, name):
    assert resolve_device(name).type == "cpu"


@pytest.mark.parametrize("name", ["gpu", "", "CPU", "cuda:", "cuda:-1", "cuda:x", "cpu,cuda", "meta", "xpu"])
def test_what_is_no_device_is_refused_with_what_is_allowed(machine, name):
    machine(cuda=2, mps=True)
    assert "allowed: auto, cpu, cuda, cuda:N, mps" in refusal(name)


@pytest.mark.parametrize("name", ["cuda", "cuda:0", "cuda:7", "mps"])
def test_a_device_that_is_not_there_is_refused(machine, name):
    text = refusal(name)
    assert "is not available" in text
    assert "use device: cpu, or auto" in text


@pytest.mark.parametrize("name", ["cuda:2", "cuda:7", "cuda:200", "cuda:300"])
def test_a_number_beyond_the_last_device_is_refused_with_how_many_there_are(machine, name):
    machine(cuda=2)
    assert "only 2" in refusal(name)


def test_every_device_that_is_there_is_taken(machine):
    machine(cuda=3, mps=True)
    for name in ("cuda", "cuda:0", "cuda:2", "mps"):
        assert resolve_device(name) == torch.device(name)


def test_an_apple_gpu_is_refused_for_float64_only(machine):
    machine(mps=True)
    assert resolve_device("mps", "float32") == torch.device("mps")
    assert "dtype: float32" in refusal("mps", "float64")


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_single_thread_gives_the_threads_back(threads):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        with single_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == threads
        with pytest.raises(KeyError), single_thread():
            raise KeyError
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)


def test_an_apple_gpu_is_refused_for_the_engine_that_needs_float64(machine):
    machine(mps=True)
    with pytest.raises(DeviceError, match=r"^device: 'mps' has no float64, which method: gauss-newton needs; use "):
        fit(icosahedron(), cube(), method="gauss-newton", device="mps")
