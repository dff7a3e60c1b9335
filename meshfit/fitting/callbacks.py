"""The argument of `on_step` callbacks, and the exception by which they stop a fit; free of torch."""

from dataclasses import dataclass


class Interrupted(Exception):  # noqa: N818  a request, not an error
    """Raised by an `on_step` callback to stop the fit; a checkpoint is saved before it propagates."""


@dataclass(frozen=True)
class Step:
    """Progress of a fit after a step.

    Attributes:
        done: number of steps made.
        steps: total number of steps.
        loss: before the last step: the objective of the first-order engine, the distance of the Gauss–Newton engine.
        stage: name of the next step's stage, such as `level 1`; empty for the first-order engine.
    """

    done: int
    steps: int
    loss: float
    stage: str = ""
