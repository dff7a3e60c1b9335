"""Take an engine through its steps: progress, checkpoints, and members that diverge."""

import time
from dataclasses import dataclass

from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.problem import Diverged, Problem
from meshfit.fitting.progress import Interrupted, Step
from meshfit.fitting.trace import Trace
from meshfit.mesh.mesh import Mesh

SECONDS_BETWEEN_CHECKPOINTS = 2.0


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit leaves.

    Attributes:
        mesh: the deformed source, with the source's own faces.
        trace: the objective and its terms by step.
        device: what it ran on.
    """

    mesh: Mesh
    trace: Trace
    device: str


def run(engine: FirstOrder, *, save_end: bool = False) -> dict[Problem, FitResult | Diverged]:
    """Make all the steps that are left; a problem that diverges is stopped, and the others go on.

    Args:
        engine: where to start from.
        save_end: save checkpoints after the last step, too, for when there is more to do that may be interrupted.

    Raises:
        Interrupted: an `on_step` asked for it; checkpoints have been saved.
    """
    outcomes: dict[Problem, FitResult | Diverged] = {}
    saved = time.monotonic()
    while True:
        outcomes |= {engine.problems[member]: diverged for member, diverged in engine.failed.items()}
        if len(engine.failed) == len(engine.problems):
            return outcomes
        if engine.failed:
            engine = engine.without_failed()
        if engine.done == engine.settings.steps:
            if save_end:
                _save(engine)
            return outcomes | {
                problem: FitResult(engine.mesh(member), engine.traces[member], str(engine.device))
                for member, problem in enumerate(engine.problems)
            }
        losses = engine.step()
        if time.monotonic() - saved > SECONDS_BETWEEN_CHECKPOINTS:
            _save(engine)
            saved = time.monotonic()
        _tell(engine, losses)


def _tell(engine: FirstOrder, losses: list[float]) -> None:
    try:
        for member, problem in enumerate(engine.problems):
            if problem.on_step is not None and member not in engine.failed:
                problem.on_step(Step(engine.done, engine.settings.steps, losses[member]))
    except Interrupted:
        _save(engine)
        raise


def _save(engine: FirstOrder) -> None:
    for member, problem in enumerate(engine.problems):
        if problem.save is not None and member not in engine.failed:
            problem.save(engine.checkpoint(member))
