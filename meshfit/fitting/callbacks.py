"""The argument of `on_step` callbacks, and the exception by which they stop a fit; free of torch."""

from dataclasses import dataclass


class Interrupted(Exception):  # noqa: N818  a request, not an error
    """Raised by an `on_step` callback to stop the fit; a checkpoint is saved before it propagates.

    Example:
        >>> import meshfit
        >>> def stop(step: meshfit.Step) -> None:
        ...     if step.done == 3:
        ...         raise meshfit.Interrupted
        >>> try:
        ...     meshfit.fit("icosahedron", "cube", samples=100, on_step=stop, device="cpu")
        ... except meshfit.Interrupted:
        ...     print("stopped")
        stopped
    """


@dataclass(frozen=True)
class Step:
    """Progress of a fit after a step.

    Attributes:
        done: number of steps made.
        steps: total number of steps, as far as is known: steps of the Gauss–Newton engine that turn out unnecessary are
            left out, and those of a further search for the rough shape are added.
        loss: before the last step: the objective of the first-order engine, the distance of the Gauss–Newton engine.
        stage: name of the next step's stage, such as `level 1`; empty for the first-order engine.

    Example:
        >>> import meshfit
        >>> steps: list[meshfit.Step] = []
        >>> result = meshfit.fit("icosahedron", "cube", steps=3, samples=100, on_step=steps.append, device="cpu")
        >>> [f"{step.done} of {step.steps}" for step in steps]
        ['1 of 3', '2 of 3', '3 of 3']
    """

    done: int
    steps: int
    loss: float
    stage: str = ""
