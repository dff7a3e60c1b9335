"""What a fit tells of its progress, and how it is asked to stop. Free of torch, for those who only look on."""

from dataclasses import dataclass


class Interrupted(Exception):  # noqa: N818  a request, not an error
    """Raised by an `on_step` callback to stop the fit; the engine saves a checkpoint before it lets it through."""


@dataclass(frozen=True)
class Step:
    """What `on_step` is told after each step.

    Attributes:
        done: how many steps have been made.
        steps: of how many.
        loss: before the last one: of the first-order engine its objective, of the other the distance.
        stage: what the next one is a part of, such as `level 1`; empty where there are no stages.
    """

    done: int
    steps: int
    loss: float
    stage: str = ""
