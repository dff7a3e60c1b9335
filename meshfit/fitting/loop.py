"""Take an engine through its steps: progress, checkpoints, and members that diverge."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch

from meshfit.fitting.callbacks import Interrupted, Step
from meshfit.fitting.problem import Checkpoint, Diverged, Problem, Trace
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh

SECONDS_BETWEEN_CHECKPOINTS = 2.0


@runtime_checkable
class Engine(Protocol):
    """What makes the steps of some problems side by side."""

    problems: tuple[Problem, ...]
    device: torch.device
    done: int
    traces: list[Trace]
    failed: dict[int, Diverged]

    @property
    def steps(self) -> int:
        """How many steps there are to make."""

    @property
    def stage(self) -> str:
        """What the next step is a part of."""

    def mesh(self, member: int) -> Mesh:
        """The surface of a problem as it lies now."""

    def polygons(self, member: int) -> PolygonMesh | None:
        """The polygons whose fans the faces of this surface are, if they are any."""

    def control(self, member: int) -> Mesh | None:
        """The control mesh that this surface is the refinement of, if that was solved for."""

    def step(self) -> list[float]:
        """Make one step; the loss of each problem before it is returned."""

    def checkpoint(self, member: int) -> Checkpoint:
        """All that the next step of one problem depends on."""

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Go back, or on, to where checkpoints were taken."""

    def without_failed(self) -> "Engine":
        """The same fits without those that have failed."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit leaves.

    Attributes:
        mesh: the deformed source, with the source's own faces, or those that the fit has refined or remeshed them to.
        trace: what was minimised, by step.
        device: what it ran on.
        control: the control mesh that the mesh is the refinement of, if that was solved for.
        polygons: whose fans the faces of the mesh are, if the source or the scheme has any and they are still there.
    """

    mesh: Mesh
    trace: Trace
    device: str
    control: Mesh | None = None
    polygons: PolygonMesh | None = None


def run(engine: Engine, *, save_end: bool = False, snapshots: int | None = None) -> dict[Problem, FitResult | Diverged]:
    """Make all the steps that are left; a problem that diverges is stopped, and the others go on.

    Args:
        engine: where to start from.
        snapshots: steps between two snapshots.
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
        if engine.done == engine.steps:
            if save_end:
                _save(engine)
            return outcomes | {
                problem: FitResult(
                    engine.mesh(member),
                    engine.traces[member],
                    str(engine.device),
                    engine.control(member),
                    engine.polygons(member),
                )
                for member, problem in enumerate(engine.problems)
            }
        losses = engine.step()
        if snapshots is not None and engine.done % snapshots == 0:
            _show(engine)
        if time.monotonic() - saved > SECONDS_BETWEEN_CHECKPOINTS:
            _save(engine)
            saved = time.monotonic()
        _tell(engine, losses)


def _tell(engine: Engine, losses: list[float]) -> None:
    try:
        for member, problem in enumerate(engine.problems):
            if problem.on_step is not None and member not in engine.failed:
                problem.on_step(Step(engine.done, engine.steps, losses[member], engine.stage))
    except Interrupted:
        _save(engine)
        raise


def _show(engine: Engine) -> None:
    for member, problem in enumerate(engine.problems):
        if problem.on_snapshot is not None and member not in engine.failed:
            problem.on_snapshot(engine.done, engine.polygons(member) or engine.mesh(member))


def _save(engine: Engine) -> None:
    for member, problem in enumerate(engine.problems):
        if problem.save is not None and member not in engine.failed:
            problem.save(engine.checkpoint(member))
