"""The Gauss–Newton engine for templates: it registers the source, then fits each level with smooth displacements."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
import torch

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import refine_state
from meshfit.fitting.gauss_newton.restarts import Restarts, restarts_for
from meshfit.fitting.gauss_newton.schedule import Stage
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.problem import Checkpoint, Problem
from meshfit.fitting.registration.guidance import Guidance, HeldParts
from meshfit.fitting.registration.guided_levels import RefinedGuide, adapted_pairs
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.plan import Register, Registered, planned_steps
from meshfit.fitting.registration.registration import Registration, RegistrationTask
from meshfit.fitting.registration.target_points import target_points
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.geometry import is_size_kept
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.pieces import crossing_faces
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.units import count_text


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
                points[problem.target] = target_points(problem.target).lifted(settings.offset)
        self._guides = [RefinedGuide(problem, settings) for problem in problems]
        self._registrations = [
            Registration(self._task(problem, points[problem.target], guide.at(0)))
            for problem, guide in zip(problems, self._guides, strict=True)
        ]

    def shortfalls(self, member: int) -> list[str]:
        """Return what the fit did not reach, in words."""
        return [*super().shortfalls(member), *self._registrations[member].shortfalls]

    def notes(self, member: int) -> list[str]:
        """Return what the fit did beyond its schedule, and what makes a registration doubtful, in words."""
        doubt = self._registrations[member].doubt
        return [*super().notes(member), *([doubt] if doubt else [])]

    def registered(self, member: int) -> Registered:
        """Return how the source was registered."""
        return self._registrations[member].registered

    def pose_scale(self, member: int) -> float:
        """Return the change of size by the pose that has been found."""
        return self._registrations[member].pose.scale

    def mesh(self, member: int) -> Mesh:
        """Return the current surface, with what is held in its place in double precision."""
        mesh, held = super().mesh(member), self._held(member)
        return mesh.with_verts(self._in_place(member, mesh.verts, held)) if held else mesh

    def polygons(self, member: int) -> PolygonMesh | None:
        """Return the polygons that the current surface was triangulated from, if any."""
        mesh, held = super().polygons(member), self._held(member)
        return mesh.with_verts(self._in_place(member, mesh.verts, held)) if mesh is not None and held else mesh

    def landmarks(self, member: int, mesh: Mesh) -> PlacedLandmarks | None:
        """Return the landmarks of the source on the surface at the end."""
        guide = self._guides[member]
        return guide.at(self._level).landmarks if guide.has_landmarks else super().landmarks(member, mesh)

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
            return self._refined_step(member, stage, number)
        registration.step(self._planned[self.done])
        self._made[member] += 1
        if self._is_off(member):
            return self._start_unregistered(member)
        state = self._states[member]
        verts = torch.tensor(registration.verts).to(state.verts)
        self._states[member] = replace(state, verts=verts, reference=verts)
        self._trace(member, registration.distance, registration.matched, *stage.weights[number], 0)
        return registration.distance

    def _refined_step(self, member: int, stage: Stage, number: int) -> float:
        """Make a step of a refined level, and put what is held where it belongs."""
        distance, held = super()._step(member, stage, number), self._held(member)
        if held:
            state = self._states[member]
            verts = held.applied(state.verts.cpu().double().numpy())
            self._states[member] = replace(state, verts=torch.tensor(verts).to(state.verts))
        return distance

    @property
    def _level(self) -> int:
        """Number of levels that the surface is refined by."""
        begun = {id(stage): stage for stage, _ in self._plans[False][: self.done + 1]}
        return sum(stage.change == "refine" and stage.registered for stage in begun.values())

    def _held(self, member: int) -> HeldParts | None:
        """Return what is held of the present surface; None for nothing."""
        if self._is_off(member) or not self._guides[member].holds:
            return None
        guide, pose = self._guides[member], self._registrations[member].pose
        held = HeldParts.of(pose.applied(guide.rest_at(self._level)), guide.at(self._level))
        return held or None

    def _in_place(self, member: int, verts: Verts, held: HeldParts) -> Verts:
        # Those of a registration are in double precision.
        return held.applied(verts if self._level else self._registrations[member].verts)

    def _adapted(self, member: int) -> Callable[[Correspondences, Shape], Correspondences] | None:
        guidance = self._guides[member].at(self._level)
        if self._is_off(member) or not guidance.steers:
            return None
        diagonal = self._registrations[member].task.diagonal
        return lambda pairs, shape: adapted_pairs(pairs, shape, guidance, diagonal)

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
        if self._is_off(member):
            return super()._ended(member, state)
        if self.settings.levels:
            self._shortfalls[member] += self._crossing_by_levels(member, state)
        return state

    def _crossing_by_levels(self, member: int, state: FitState) -> list[str]:
        """Return in words how many faces cross others that do not in the source, refined as well."""
        rest = self._start(self.problems[member], near=True)
        for _ in range(self.settings.levels):
            rest = refine_state(rest, self.problems[member].scheme, untangle=False)
        before, after = (
            crossing_faces(each.shape.connectivity.mesh(each.shape.verts.double()))[0] for each in (rest, state)
        )
        count = int((after & ~before).sum())
        return [f"crossing others, but not in the refined source: {count_text(count, 'face')}"] if count else []

    def _task(self, problem: Problem, target: OrientedPoints, guidance: Guidance) -> RegistrationTask:
        assert self.settings.prior is not None  # noqa: S101  another engine has those
        spreads = [float(np.linalg.norm(points.std(axis=0))) for points in (problem.source.verts, target.points)]
        prior, direction = self.settings.prior, self.settings.direction
        similarity = prior == "soft" or not is_size_kept(spreads[0] / spreads[1])
        choice: Register = self.settings.register
        if self._is_unregistered(problem):
            choice = "off"
        return RegistrationTask(problem.source, target, prior, direction, similarity, guidance, problem.seed, choice)
