"""Which device a fit runs on, and with how many threads."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from meshfit.errors import DeviceError

DEVICES = "auto, cpu, cuda, cuda:N, mps"


def resolve_device(name: str, dtype: str = "float32") -> torch.device:
    """The torch device of a setting; `auto` takes a CUDA device where there is one, and the CPU otherwise.

    Raises:
        DeviceError: not a device name, a device that is not there, or one that has no such dtype.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise DeviceError(f"device: '{name}' is not a device; allowed: {DEVICES}") from None
    if device.type not in ("cpu", "cuda", "mps"):
        raise DeviceError(f"device: '{name}' is not supported; allowed: {DEVICES}")
    count = {"cpu": 1, "cuda": torch.cuda.device_count(), "mps": int(torch.backends.mps.is_available())}[device.type]
    if not 0 <= (device.index or 0) < count:  # torch lets large indices overflow to negative ones
        found = f"only {count} of its kind here" if count else "none of its kind here, or torch was built without it"
        raise DeviceError(f"device: '{name}' is not available ({found}); use device: cpu, or auto")
    if device.type == "mps" and dtype == "float64":
        raise DeviceError("device: 'mps' has no float64; use dtype: float32")
    return device


@contextmanager
def single_thread() -> Iterator[None]:
    """Run torch on one CPU thread: at the sizes of a fit more cost more than they bring, and one keeps sums ordered."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
