"""The step loop that both engines share: progress, snapshots, checkpoints, and problems that diverge."""

import time
from collections.abc import Iterator, Sequence
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
    """A batch of fits in progress, stepped together; `member` is the index of a problem in the batch."""

    problems: tuple[Problem, ...]
    device: torch.device
    done: int
    traces: list[Trace]
    failed: dict[int, Diverged]

    @property
    def steps(self) -> int:
        """Total number of steps."""

    @property
    def stage(self) -> str:
        """Name of the next step's stage."""

    def mesh(self, member: int) -> Mesh:
        """Return the current surface."""

    def polygons(self, member: int) -> PolygonMesh | None:
        """Return the polygons whose fan triangulation the current surface is, if any."""

    def control(self, member: int) -> Mesh | None:
        """Return the current control mesh, if one is solved for."""

    def step(self) -> list[float]:
        """Make one step and return the loss of each problem before it."""

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""

    def without_failed(self) -> "Engine":
        """Return the same fits without those that have failed."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """The result of a fit.

    Attributes:
        mesh: the deformed source, with its own faces, or those that the fit refined or remeshed them to.
        trace: one row of numbers per traced step.
        device: name of the device.
        control: the control mesh of which `mesh` is the refinement, if one was solved for.
        polygons: the polygons whose fan triangulation `mesh` is, if any.
    """

    mesh: Mesh
    trace: Trace
    device: str
    control: Mesh | None = None
    polygons: PolygonMesh | None = None


def run(engine: Engine, *, save_end: bool = False, snapshots: int | None = None) -> dict[Problem, FitResult | Diverged]:
    """Make all remaining steps; a problem that diverges stops, and the others continue.

    Args:
        engine: the fits.
        save_end: save checkpoints after the last step, too, because more work follows that may be interrupted.
        snapshots: number of steps between two snapshots.

    Raises:
        Interrupted: by an `on_step`; checkpoints have been saved.
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
            return outcomes | {problem: _result(engine, member) for member, problem in enumerate(engine.problems)}
        losses = engine.step()
        if snapshots is not None and engine.done % snapshots == 0:
            _take_snapshots(engine)
        if time.monotonic() - saved > SECONDS_BETWEEN_CHECKPOINTS:
            _save(engine)
            saved = time.monotonic()
        _report(engine, losses)


def _result(engine: Engine, member: int) -> FitResult:
    trace, device = engine.traces[member], str(engine.device)
    return FitResult(engine.mesh(member), trace, device, engine.control(member), engine.polygons(member))


def _running(engine: Engine) -> Iterator[tuple[int, Problem]]:
    """Yield the problems that have not failed, with their indices."""
    return ((member, problem) for member, problem in enumerate(engine.problems) if member not in engine.failed)


def _report(engine: Engine, losses: list[float]) -> None:
    try:
        for member, problem in _running(engine):
            if problem.on_step is not None:
                problem.on_step(Step(engine.done, engine.steps, losses[member], engine.stage))
    except Interrupted:
        _save(engine)
        raise


def _take_snapshots(engine: Engine) -> None:
    for member, problem in _running(engine):
        if problem.on_snapshot is not None:
            problem.on_snapshot(engine.done, engine.polygons(member) or engine.mesh(member))


def _save(engine: Engine) -> None:
    for member, problem in _running(engine):
        if problem.save is not None:
            problem.save(engine.checkpoint(member))
