"""What a fit tells of its progress, and how it is asked to stop. Free of torch, for those who only look on."""

from dataclasses import dataclass


class Interrupted(Exception):  # noqa: N818  a request, not an error
    """Raised by an `on_step` callback to stop the fit; the engine saves a checkpoint before it lets it through."""


@dataclass(frozen=True)
class Step:
    """What `on_step` is told after each step: how many are done, of how many, and the loss before the last one."""

    done: int
    steps: int
    loss: float
