"""The best of several tries at the rough shape: parts that stay off the target in one seldom do in all."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from meshfit.errors import ConfigError
from meshfit.fitting.gauss_newton.fit_state import FitState, StepReport
from meshfit.fitting.gauss_newton.refinement import refined, with_control_mesh
from meshfit.fitting.gauss_newton.schedule import Stage, schedule
from meshfit.fitting.gauss_newton.sphere_map import initial_sphere_map
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.problem import Checkpoint, Diverged, Problem, Trace
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.manifold import require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.limit import has_loop_limit
from meshfit.subdivision.refine import growth
from meshfit.subdivision.registry import resolve

# From this share of points on that have found others facing alike, there is nothing to gain from another try: webs
# and strangled parts are among those that find none.
_ENOUGH = 0.992


@dataclass
class Restarts:
    """What is known of the tries that have been made.

    Attributes:
        best: the surface of the best try.
        share: of its points that found others facing alike; -1 where no try has ended.
        matched: that share in the last step.
        distance: that the last step began with.
    """

    best: FitState | None = None
    share: float = -1.0
    matched: float = 0.0
    distance: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether no further try is needed."""
        return self.share >= _ENOUGH

    def best_of(self, surface: FitState) -> FitState:
        """The best surface so far, this one included, with which a try ends."""
        if self.best is None or (not self.settled and self.matched > self.share):
            self.best, self.share = surface, self.matched
        return self.best

    def state(self) -> dict[str, Any]:
        """What `restored` makes it from."""
        best = None if self.best is None else self.best.state()
        return {"best": best, "share": self.share, "matched": self.matched, "distance": self.distance}

    @classmethod
    def restored(cls, state: dict[str, Any], dtype: torch.dtype, device: torch.device) -> "Restarts":
        """What `state` was taken of."""
        best = None if state["best"] is None else FitState.restored(state["best"], dtype, device)
        return cls(best, state["share"], state["matched"], state["distance"])


COLUMNS = ("step", "distance", "verts", "matched", "fairness", "point_weight", "held_back")
_REMEDY = "raise fit.fairness, or place the source nearer to the target"


class GaussNewton:
    """Fits in progress, of the same settings: `step` advances all of them by one, each by itself.

    Attributes:
        problems: the K problems.
        settings: of all of them.
        device: what they run on.
        steps: how many steps there are to make.
        done: how many have been made.
        traces: of each problem; distances are root mean squares of the residuals of all pairs.
        failed: those that have diverged, by their place among the problems; they are not to be stepped further.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: GaussNewtonSettings,
        device: torch.device,
        dtype: torch.dtype,
        _pool: Executor | None = None,
    ) -> None:
        self.problems, self.settings, self.device, self.done = tuple(problems), settings, device, 0
        self.steps, self._dtype = settings.steps, dtype
        self.traces, self.failed = [Trace(COLUMNS) for _ in problems], dict[int, Diverged]()
        place: Mapping[str, Any] = {"dtype": dtype, "device": device}
        clouds = {target: TargetCloud.of(target, **place) for target in dict.fromkeys(p.target for p in problems)}
        self._targets = [clouds[problem.target] for problem in problems]
        self._generators = [Generator().manual_seed(problem.seed) for problem in problems]
        self._plan = [(stage, k) for stage in schedule(settings) for k in range(len(stage.weights))]
        self._mapped = dict[Mesh, Tensor | None]()
        self._surfaces = [self._start(problem) for problem in problems]
        self._rough = [Restarts() for _ in problems]

    @property
    def stage(self) -> str:
        """What the next step is a part of."""
        return self._plan[min(self.done, self.steps - 1)][0].name if self._plan else ""

    def mesh(self, member: int) -> Mesh:
        """A surface as it lies now, in float64."""
        shape = self._surfaces[member].shape
        return shape.connectivity.mesh(shape.verts)

    def polygons(self, member: int) -> PolygonMesh | None:
        """The polygons whose fans the faces of a surface are, if no remesh came after them."""
        surface = self._surfaces[member]
        polygons = surface.polygons if surface.controlled is None else surface.controlled.polygons
        if polygons is None:
            return None
        return PolygonMesh(self.mesh(member).verts, polygons.corners, polygons.sizes)

    def control(self, member: int) -> Mesh | None:
        """The control mesh that a surface follows, if it follows one."""
        surface = self._surfaces[member]
        return None if surface.controlled is None else surface.pattern.connectivity.mesh(surface.verts)

    @torch.no_grad()
    def step(self) -> list[float]:
        """Make one step; the distance of each problem before it is returned. `failed` is brought up to date."""
        stage, number = self._plan[self.done]
        distances = [self._step(member, stage, number) for member in range(len(self.problems))]
        self.done += 1
        if stage.attempt is not None and (self.done == self.steps or self._plan[self.done][0].attempt != stage.attempt):
            self._surfaces = [rough.best_of(now) for rough, now in zip(self._rough, self._surfaces, strict=True)]
        if self.done == self.steps:
            # What was unsound when it was put in place, and no step made worse.
            self._surfaces = [surface.untangled() for surface in self._surfaces]
        return distances

    def checkpoint(self, member: int) -> Checkpoint:
        """Everything that the next step of one problem depends on."""
        return {
            "done": self.done,
            "surface": self._surfaces[member].state(),
            "rough": self._rough[member].state(),
            "generator": self._generators[member].get_state(),
            "trace": list(self.traces[member].rows),
        }

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Go back, or on, to where checkpoints of the same problems were taken, all after as many steps."""
        self._surfaces = [self._restored(*each) for each in zip(checkpoints, self.problems, strict=True)]
        place: Mapping[str, Any] = {"dtype": self._dtype, "device": self.device}
        self._rough = [Restarts.restored(checkpoint["rough"], **place) for checkpoint in checkpoints]
        for generator, checkpoint in zip(self._generators, checkpoints, strict=True):
            generator.set_state(checkpoint["generator"].cpu())
        self.traces = [Trace(COLUMNS, [tuple(row) for row in checkpoint["trace"]]) for checkpoint in checkpoints]
        self.done = checkpoints[0]["done"]

    def without_failed(self) -> "GaussNewton":
        """The same fits without those that have failed."""
        left = [member for member in range(len(self.problems)) if member not in self.failed]
        others = GaussNewton([self.problems[k] for k in left], self.settings, self.device, self._dtype)
        others.restore([self.checkpoint(member) for member in left])
        return others

    def _start(self, problem: Problem) -> FitState:
        verts, faces = self._source(problem)
        has_limit = has_loop_limit(resolve(problem.scheme))
        if self.settings.limit and (self.settings.variables != "control" or not has_limit):
            raise ConfigError("limit: limit surfaces are fitted with variables: control and the scheme loop")
        on_sphere = self._on_sphere(problem) if self.settings.connectivity == "fixed" else None
        return FitState.of(verts, faces, on_sphere, _polygons_of(problem))

    def _on_sphere(self, problem: Problem) -> Tensor | None:
        """Where the verts of a source are on the sphere; looked for once, since that may take seconds."""
        if problem.source not in self._mapped:
            self._mapped[problem.source] = initial_sphere_map(problem.source)
        found = self._mapped[problem.source]
        return None if found is None else found.to(self.device)

    def _source(self, problem: Problem) -> tuple[Tensor, Tensor]:
        place: Mapping[str, Any] = {"device": self.device}
        require_manifold(Topology.of(problem.source), "a Gauss–Newton fit")
        verts = torch.tensor(problem.source.verts, dtype=self._dtype, **place)
        return verts, torch.tensor(problem.source.faces, **place)

    def _restored(self, checkpoint: Checkpoint, problem: Problem) -> FitState:
        surface = FitState.restored(checkpoint["surface"], self._dtype, self.device)
        before = self._plan[checkpoint["done"] - 1][0] if checkpoint["done"] else None
        if before is None or before.change != "control":
            return surface
        return self._controlling(surface, problem, checkpoint["surface"].get("followed"))

    def _controlling(self, surface: FitState, problem: Problem, corners: Tensor | None = None) -> FitState:
        return with_control_mesh(
            surface, problem.scheme, self.settings.levels, limit=self.settings.limit, corners=corners
        )

    def _step(self, member: int, stage: Stage, number: int) -> float:
        problem, target, rough = self.problems[member], self._targets[member], self._rough[member]
        before = self._surfaces[member]
        if stage.attempt is not None and rough.settled:
            return rough.distance
        if number == 0:
            before = self._changed(before, problem, stage, target)
        fairness, point_weight = stage.weights[number]
        taken = before.step(target, fairness, point_weight, self._generators[member])
        distance, after = taken.pairs.distance, taken.surface
        if not bool(after.verts.isfinite().all()):
            last_good = before.shape.connectivity.mesh(before.shape.verts)
            self.failed[member] = Diverged(self.done, "the step", last_good, self.traces[member], _REMEDY)
            return distance
        self._surfaces[member] = after
        rough.matched, rough.distance = taken.pairs.matched, distance
        if self.done % self.settings.trace_every == 0 or self.done == self.steps - 1:
            self._record(member, taken, fairness, point_weight)
        return distance

    def _record(self, member: int, taken: StepReport, fairness: float, point_weight: float) -> None:
        pairs, verts = taken.pairs, len(taken.surface.shape.verts)
        row = (self.done, pairs.distance, verts, pairs.matched, fairness, point_weight, taken.held)
        self.traces[member].rows.append(row)

    def _changed(self, surface: FitState, problem: Problem, stage: Stage, target: TargetCloud) -> FitState:
        """The surface after what a stage begins with."""
        if stage.change == "start" and stage.attempt:
            surface = self._start(problem)
        if stage.change == "refine":
            fine = refined(surface, problem.scheme)
            too_many = self.settings.connectivity == "remeshed" and len(fine.verts) > self.settings.verts
            return surface if too_many else fine
        if stage.change == "control":
            return self._controlling(surface, problem)
        if stage.change == "place" and surface.on_sphere is not None:
            faces, places = self._source(problem)[1], self._on_sphere(problem)
            return surface if places is None else surface.carrying(faces, places, target, _polygons_of(problem))
        movable = self.settings.connectivity == "remeshed" or surface.on_sphere is not None
        count = self._rough_verts(problem) * stage.share * growth(resolve(problem.scheme), stage.refined)
        if movable and (stage.change == "remesh" or (stage.change == "start" and len(surface.verts) > count)):
            return surface.remeshed(count, target if stage.sized else None)
        return surface

    def _rough_verts(self, problem: Problem) -> float:
        """The number of verts at the end of the rough stage."""
        if self.settings.connectivity == "fixed":
            # A coarse source is no reason to miss thin parts.
            return max(float(problem.source.num_verts), self.settings.verts / 4.0)
        if self.settings.variables == "control":
            return float(self.settings.verts)
        return self.settings.verts / growth(resolve(problem.scheme), self.settings.levels)


def _polygons_of(problem: Problem) -> PolygonTopology | None:
    return None if problem.polygons is None else PolygonTopology.of(problem.polygons)
