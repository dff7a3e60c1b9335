"""The Gauss–Newton engine for templates: it registers the source, then fits each level with smooth displacements."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
import torch

from meshfit.fitting.gauss_newton.engine import GaussNewton, Restarts, restarts_for
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import refine_state
from meshfit.fitting.gauss_newton.schedule import Stage
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.problem import Checkpoint, Problem
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.plan import Register, Registered, planned_steps
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
        assert settings.prior is not None  # noqa: S101  another engine has those
        self._planned = planned_steps(settings.prior)
        points: dict[Mesh | PointCloud, OrientedPoints] = {}
        for problem in problems:
            if problem.target not in points:
                points[problem.target] = target_points(problem.target)
        self._registrations = [Registration(self._task(problem, points[problem.target])) for problem in problems]

    def shortfalls(self, member: int) -> list[str]:
        """Return what the fit did not reach, in words."""
        return [*super().shortfalls(member), *self._registrations[member].shortfalls]

    def registered(self, member: int) -> Registered:
        """Return how the source was registered."""
        return self._registrations[member].registered

    def pose_scale(self, member: int) -> float:
        """Return the change of size by the pose that has been found."""
        return self._registrations[member].pose.scale

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""
        return super().checkpoint(member) | {"registration": self._registrations[member].saved()}

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""
        super().restore(checkpoints)
        for registration, checkpoint in zip(self._registrations, checkpoints, strict=True):
            registration.restore(checkpoint["registration"])
        for member, problem in enumerate(self.problems):
            if self._is_off(member) and problem.own:
                self._near[member] = super()._is_near(problem, self._targets[member])

    def _is_off(self, member: int) -> bool:
        """Return whether `auto` has found that there is nothing to register."""
        return self._registrations[member].registered.register == "off"

    def _is_near(self, problem: Problem, target: TargetCloud) -> tuple[bool, float]:
        if self._is_unregistered(problem):
            return super()._is_near(problem, target)
        return True, float("inf")  # there is no search for a rough shape

    def _is_unregistered(self, problem: Problem) -> bool:
        return self.settings.register == "auto" and not problem.own

    def _applies(self, member: int, stage: Stage) -> bool:
        if self._is_off(member):
            return not stage.registered
        is_bent = stage.change == "register" and stage.name != self._planned[0].stage
        return stage.registered and not (is_bent and self._registrations[member].registered.register == "rigid")

    def _step(self, member: int, stage: Stage, number: int) -> float:
        registration = self._registrations[member]
        if not self._applies(member, stage):
            return registration.distance
        if stage.change != "register":
            return super()._step(member, stage, number)
        registration.step(self._planned[self.done])
        self._made[member] += 1
        if self._is_off(member):
            return self._start_unregistered(member)
        state = self._states[member]
        verts = torch.tensor(registration.verts).to(state.verts)
        self._states[member] = replace(state, verts=verts, reference=verts)
        self._trace(member, registration.distance, registration.matched, *stage.weights[number], 0)
        return registration.distance

    def _start_unregistered(self, member: int) -> float:
        """Go on as a fit without a registration, from the source as it is."""
        problem, target = self.problems[member], self._targets[member]
        near, distance = self._near[member] = super()._is_near(problem, target)
        self._states[member] = state = self._start(problem, near=near)
        self._restarts[member] = Restarts.unneeded(distance) if near else restarts_for(state, self.settings, distance)
        return distance

    def _changed(self, state: FitState, problem: Problem, stage: Stage, target: TargetCloud) -> FitState:
        if not stage.registered:
            return super()._changed(state, problem, stage, target)
        # What crosses in the source may cross in the result; smoothing it would move vertices from where they belong.
        if stage.change == "refine":
            state = refine_state(state, problem.scheme, untangle=False)
        return replace(state, reference=state.verts)

    def _ended(self, member: int, state: FitState) -> FitState:
        return super()._ended(member, state) if self._is_off(member) else state

    def _task(self, problem: Problem, target: OrientedPoints) -> RegistrationTask:
        assert self.settings.prior is not None  # noqa: S101  another engine has those
        spreads = [float(np.linalg.norm(points.std(axis=0))) for points in (problem.source.verts, target.points)]
        similarity = not 1 / _SAME_SIZE < spreads[0] / spreads[1] < _SAME_SIZE
        landmarks = None if problem.landmarks is None else problem.landmarks.subset(problem.landmarks.used)
        landmarks = landmarks if landmarks is None or len(landmarks) else None
        prior, direction = self.settings.prior, self.settings.direction
        choice: Register = self.settings.register
        if self._is_unregistered(problem):
            choice = "off"
        return RegistrationTask(problem.source, target, prior, direction, similarity, landmarks, problem.seed, choice)
