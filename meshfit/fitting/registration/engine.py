"""The Gauss–Newton engine for templates: it registers the source, then fits each level with smooth displacements."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
import torch

from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import refine_state
from meshfit.fitting.gauss_newton.schedule import Stage
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.problem import Checkpoint, Problem
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.plan import planned_steps
from meshfit.fitting.registration.registration import Registration, RegistrationTask
from meshfit.fitting.registration.target_points import target_points
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud

# The scale is to be found if the spreads of source and target have a ratio beyond this.
_SAME_SIZE = 1.5


class RegistrationEngine(GaussNewton):
    """Fits of sources whose vertices have a meaning, with `register` set."""

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: GaussNewtonSettings,
        device: torch.device,
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        super().__init__(problems, settings, device, dtype, pool)
        assert settings.register != "off"  # noqa: S101  another engine has those
        self._planned = planned_steps(settings.register)
        points: dict[Mesh | PointCloud, OrientedPoints] = {}
        for problem in problems:
            if problem.target not in points:
                points[problem.target] = target_points(problem.target)
        self._registrations = [Registration(self._task(problem, points[problem.target])) for problem in problems]

    def shortfalls(self, member: int) -> list[str]:
        """Return what the fit did not reach, in words."""
        return [*super().shortfalls(member), *self._registrations[member].shortfalls]

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""
        return super().checkpoint(member) | {"registration": self._registrations[member].saved()}

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""
        super().restore(checkpoints)
        for registration, checkpoint in zip(self._registrations, checkpoints, strict=True):
            registration.restore(checkpoint["registration"])

    def _is_near(self, _problem: Problem, _target: TargetCloud) -> tuple[bool, float]:
        return True, float("inf")  # there is no search for a rough shape

    def _step(self, member: int, stage: Stage, number: int) -> float:
        if stage.change != "register":
            return super()._step(member, stage, number)
        registration = self._registrations[member]
        registration.step(self._planned[self.done])
        self._made[member] += 1
        state = self._states[member]
        verts = torch.tensor(registration.verts).to(state.verts)
        self._states[member] = replace(state, verts=verts, reference=verts)
        self._trace(member, registration.distance, registration.matched, *stage.weights[number], 0)
        return registration.distance

    def _changed(self, state: FitState, problem: Problem, stage: Stage, _target: TargetCloud) -> FitState:
        # What crosses in the source may cross in the result; smoothing it would move vertices from where they belong.
        if stage.change == "refine":
            state = refine_state(state, problem.scheme, untangle=False)
        return replace(state, reference=state.verts)

    def _ended(self, _member: int, state: FitState) -> FitState:
        return state

    def _task(self, problem: Problem, target: OrientedPoints) -> RegistrationTask:
        assert self.settings.register != "off"  # noqa: S101  another engine has those
        spreads = [float(np.linalg.norm(points.std(axis=0))) for points in (problem.source.verts, target.points)]
        similarity = not 1 / _SAME_SIZE < spreads[0] / spreads[1] < _SAME_SIZE
        prior, direction = self.settings.register, self.settings.direction
        return RegistrationTask(problem.source, target, prior, direction, similarity, problem.landmarks, problem.seed)
