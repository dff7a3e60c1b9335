"""The Gauss–Newton engine: fits that follow a schedule of stages, with restarts of the rough shape."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import torch
from torch import Generator, Tensor

from meshfit.errors import ConfigError
from meshfit.fitting.gauss_newton.attributes import carried_attributes, initial_rest
from meshfit.fitting.gauss_newton.closeness import Closeness, hidden_share, is_near
from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.image_rows import ImageRows
from meshfit.fitting.gauss_newton.refinement import control_mesh, linearly_refined, refine_state, with_control_mesh
from meshfit.fitting.gauss_newton.restarts import Restarts, restarts_for
from meshfit.fitting.gauss_newton.schedule import Stage, rough_verts, schedule
from meshfit.fitting.gauss_newton.second_fit import bridge_of, is_better, second_problem
from meshfit.fitting.gauss_newton.skin import Skin, needs_skin, skin_of
from meshfit.fitting.gauss_newton.sphere_map import initial_sphere_map
from meshfit.fitting.gauss_newton.step_limiting import faults_of, num_crossing
from meshfit.fitting.gauss_newton.support import with_support
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.fitting.gauss_newton.target import TargetBoundary, TargetCloud
from meshfit.fitting.loop import Engine
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.attributes import NO_ATTRIBUTES
from meshfit.mesh.control_mesh import open_sheet
from meshfit.mesh.manifold import TopologyCounts, require_manifold
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import crossing_faces, piece_of_face
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.growth import growth
from meshfit.subdivision.limit import has_loop_limit
from meshfit.subdivision.registry import resolve
from meshfit.units import count_text

COLUMNS = ("step", "distance", "verts", "matched", "fairness", "point_weight", "held_back")
_REMEDY = "raise fit.fairness, or place the source nearer to the target"
# A fit that ends at less than this share of its first distance from the target has not lost by it.
_MUCH_NEARER = 0.5
# Share of outliers from which on they are reported.
_MANY_OUTLIERS = 0.01
# From this share of matched points on, a surface is on the hull of masks, and goes on to their contours.
_ON_HULL = 0.9


class GaussNewton(Engine):
    """Fits that are stepped one after the other.

    The distance in progress and traces is the root mean square of all residuals.
    """

    settings: GaussNewtonSettings
    columns = COLUMNS
    is_second = False

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: GaussNewtonSettings,
        device: torch.device,
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        super().__init__(problems, settings, device, dtype, pool)
        targets = dict.fromkeys(problem.target for problem in problems)
        noise = None if settings.noise == "auto" else settings.noise
        robust = settings.robust == "auto"
        clouds = {target: TargetCloud.of(target, dtype, device, noise, robust=robust) for target in targets}
        # The rim of an open surface shrinks unless something holds it.
        for problem in problems:
            target, is_open = problem.target, not Topology.of(problem.source).is_watertight
            if isinstance(target, PointCloud) and is_open and not problem.own and clouds[target].boundary is None:
                boundary = TargetBoundary.of(open_sheet(target), dtype, device)
                clouds[target] = replace(clouds[target], boundary=boundary)
        if settings.offset:
            clouds = {target: cloud.lifted(settings.offset) for target, cloud in clouds.items()}
        self._targets = [clouds[problem.target] for problem in problems]
        views = dict.fromkeys(problem.images for problem in problems)
        images = {of_one: None if of_one is None else ImageRows.of(of_one) for of_one in views}
        self._images = [images[problem.images] for problem in problems]
        self._generators = [Generator().manual_seed(problem.seed) for problem in problems]
        for problem in problems:
            self._check(problem)
        pairs = zip(problems, self._targets, strict=True)
        self._near = [self._is_near(problem, target) for problem, target in pairs]
        self._plans = {near: _steps_of(schedule(settings, near=near)) for near in (False, True)}
        self._sphere_maps = dict[Mesh, Tensor | None]()
        self._crossing = dict[Mesh, bool]()
        self._states = [
            self._start(problem, near=near) for problem, (near, _) in zip(problems, self._near, strict=True)
        ]
        self._restarts = [
            # From the hull of masks, it takes coarse steps to reach what lies inside it.
            Restarts.unneeded(distance)
            if near and not self._only_hull(member)
            else restarts_for(state, settings, distance)
            for member, ((near, distance), state) in enumerate(zip(self._near, self._states, strict=True))
        ]
        self._skins = self._skins_of_targets()
        self._shortfalls = [outliers_left_out(target) for target in self._targets]
        self._notes = [[] if skin is None else [skin.note] for skin in self._skins]
        self._made = [0] * len(problems)

    def progress(self, member: int) -> tuple[int, int]:
        """Return the steps that a fit has made, and all that it will make as far as is known.

        A search for the rough shape counts from its first step on; a source that is near to the target needs none.
        """
        plan, restarts, made = self._plans[False], self._restarts[member], self._made[member]
        left = [stage for stage, _ in plan[self.done :] if self._applies(member, stage)]
        ended = plan[self.done - 1][0] if self.done and restarts.still else None

        def is_coming(stage: Stage) -> bool:
            if stage.attempt is None:
                return stage is not ended
            return stage.attempt == left[0].attempt and not restarts.settled and not restarts.still

        return made, made + sum(map(is_coming, left))

    def _applies(self, _member: int, _stage: Stage) -> bool:
        """Return whether a stage is one of those of a fit, as far as is known."""
        return True

    @property
    def stage(self) -> str:
        """Name of the next step's stage."""
        plan = self._plans[False]
        return plan[min(self.done, self.steps - 1)][0].name if plan else ""

    def mesh(self, member: int) -> Mesh:
        """Return the current surface, in float64."""
        return _mesh_at(self._states[member])

    def polygons(self, member: int) -> PolygonMesh | None:
        """Return the polygons that the current surface was triangulated from, if it has not been remeshed since."""
        return _polygons_at(self._states[member])

    def control(self, member: int) -> Mesh | PolygonMesh | None:
        """Return the current control mesh, if one is solved for; its levels by the scheme are the current surface."""
        state = self._states[member]
        return None if state.controlled is None else control_mesh(state, self.problems[member].scheme)

    def with_attributes(self, member: int, surface: Mesh | PolygonMesh) -> Mesh | PolygonMesh:
        """Return the surface at the end with the attributes of the source: refined, or projected if it was remeshed.

        Vertices and faces that the target shows are marked, if it has a rim.
        """
        problem, attributes = self.problems[member], NO_ATTRIBUTES
        if problem.source.attributes:
            state, levels = self._states[member], self.settings.levels
            attributes = carried_attributes(surface, problem, self.settings, state, levels=levels)
        return surface.with_attributes(with_support(attributes, surface, self._targets[member]))

    def control_with_attributes(self, member: int) -> Mesh | PolygonMesh | None:
        """Return the control mesh at the end, if one is solved for, with the attributes of the source."""
        control, problem, state = self.control(member), self.problems[member], self._states[member]
        if control is None or not problem.source.attributes:
            return control
        return control.with_attributes(carried_attributes(control, problem, self.settings, state, levels=0))

    @torch.no_grad()
    def step(self) -> list[float]:
        """Make one step, update `failed`, and return the distance of each problem before the step."""
        distances = [self._step(member, *self._plans[near][self.done]) for member, (near, _) in enumerate(self._near)]
        plan = self._plans[False]
        stage, _ = plan[self.done]
        self.done += 1
        if stage.attempt is not None and (self.done == self.steps or plan[self.done][0].attempt != stage.attempt):
            self._states = [self._end_search(member, state) for member, state in enumerate(self._states)]
        if self.done == self.steps:
            self._states = [self._ended(member, state) for member, state in enumerate(self._states)]
        return distances

    def _skins_of_targets(self) -> list[Skin | None]:
        """Return the skin that each source is fitted to; None where it is fitted to the target itself."""
        found, skins = dict[Mesh, Skin | None](), list[Skin | None]()
        for problem, cloud, (near, _) in zip(self.problems, self._targets, self._near, strict=True):
            target = problem.target
            if near or isinstance(target, PointCloud) or not needs_skin(problem, target, self.settings):
                skins.append(None)
                continue
            if target not in found:
                found[target] = skin_of(target, cloud)
            skins.append(found[target])
        return skins

    def _end_search(self, member: int, state: FitState) -> FitState:
        problem, restarts, images = self.problems[member], self._restarts[member], self._images[member]
        near, _ = self._near[member]
        if images is not None and near and self._only_hull(member) and not restarts.settled:
            start = self._start(problem, near=True)
            if images.loses_parts(_mesh_at(state), _mesh_at(start)):
                restarts.best, restarts.settled = start, True
        return restarts.end_search(state, lambda: hidden_share(problem.target))

    def shortfalls(self, member: int) -> list[str]:
        """Return what the fit did not reach, in words."""
        return self._shortfalls[member]

    def notes(self, member: int) -> list[str]:
        """Return what the fit did beyond its schedule, in words."""
        return self._notes[member]

    def _faults(self, state: FitState) -> list[str]:
        """Return what is not as wanted of the surface itself, in words."""
        count, wanted = len(state.verts), self.settings.verts
        if not bool(state.verts.isfinite().all()):
            return []
        texts = faults_of(state.shape)
        if self.settings.connectivity == "remeshed" and count > wanted:
            topology = Topology.of(_mesh_at(state))
            pieces, _, handles = TopologyCounts.of(topology)
            many = [(pieces, "piece")] if pieces > 1 else []
            many += [(handles, "handle")] if handles and state.least_verts > wanted else []
            parts = " and ".join(count_text(number, noun) for number, noun in many)
            why = f"its {parts} cannot do with so few" if parts else "no more edges may collapse"
            texts.append(f"too many vertices: {count:,}, more than the {wanted:,} wanted, as {why}")
        return texts

    def _ended(self, member: int, state: FitState) -> FitState:
        """Return the state to end with."""
        # Steps make no sound face unsound; those left were so when they were put in place.
        state = self._not_worse(member, state.untangled())
        if self._may_change_faces(state):
            state = state.without_thin_faces()
        second = self._second(member, state)
        if second is not None:
            return second
        self._shortfalls[member] += self._faults(state)
        if self._restarts[member].hopeless:
            text = "cut short: the source crosses itself, and has too many pieces or handles to be remeshed"
            self._shortfalls[member].append(f"{text}; raise fit.verts, or start from a sphere")
        return state

    def _may_change_faces(self, state: FitState) -> bool:
        """Return whether the faces at the end need not be those of the source or of the scheme."""
        free = self.settings.connectivity == "remeshed" and state.controlled is None and state.polygons is None
        return free and bool(state.verts.isfinite().all())

    def _second(self, member: int, state: FitState) -> FitState | None:
        """Fit again where the result bridges parts of the target; return the second result if it is much nearer."""
        settings, problem = self.settings, self.problems[member]
        near, _ = self._near[member]
        if (
            near
            or self.is_second
            or self._only_hull(member)
            or settings.tries == 1
            or self._restarts[member].hopeless
            or not bool(state.verts.isfinite().all())
        ):
            return None
        first = _mesh_at(state)
        bridge = bridge_of(first, problem, self._restarts[member].matched)
        if bridge is None:
            return None
        again, changed, start = second_problem(problem, settings)
        engine = GaussNewton([again], changed, self.device, self.dtype)
        engine.is_second = True
        while engine.done < engine.steps and not engine.failed:
            engine.step()
        text = f"the first fit ended {100 * bridge.share:.1f} % of the target's diagonal off it at one place; "
        if engine.failed or not is_better(engine.mesh(0), first, problem.target):
            self._notes[member].append(f"{text}a second one, from {start}, was no better")
            return None
        # A result that knows the target is not to be taken for one that does not.
        told = self._notes if again.source is problem.source else self._shortfalls
        told[member].append(f"{text}this is a second one, from {start}")
        self._add_trace(member, engine)
        self._shortfalls[member] += engine.shortfalls(0)
        return engine._states[0]

    def _add_trace(self, member: int, second: "GaussNewton") -> None:
        trace, other = self.traces[member], second.traces[0]
        trace.rows += [(self.done + int(step), *values) for step, *values in other.rows]
        trace.seconds += [self.seconds(member)] * len(other.rows)

    def _not_worse(self, member: int, state: FitState) -> FitState:
        """Return the state at the end, or the source's own surface where a fit has lost by it."""
        problem = self.problems[member]
        near, began = self._near[member]
        better = not near and (
            self.settings.register != "off" or self._restarts[member].distance < _MUCH_NEARER * began
        )
        # With fewer vertices than the source, a result may well be farther.
        fewer = self.settings.connectivity == "remeshed" and problem.source.num_verts > self.settings.verts
        # A surface that masks allow may well be farther from their hull.
        if better or fewer or self._only_hull(member) or self.settings.offset or not bool(state.verts.isfinite().all()):
            return state
        if isinstance(problem.target, PointCloud) or self._targets[member].noise:
            return state  # a smooth surface is farther from noise than one that follows it
        if self._targets[member].rim is not None and Topology.of(problem.source).is_watertight:
            return state  # what fills holes smoothly is farther from their rims than what spans them
        before = Closeness.of(problem.source, problem.target)
        after = Closeness.of(_mesh_at(state), problem.target)
        if not after.is_worse_than(before):
            if after.has_grown(before):
                self._shortfalls[member].append(f"{after.growth_text(before)}, although the mean distance fell")
            return state
        kept = self._source_surface(problem)
        words = "the fit ended farther from the target than its source was"
        crossing = 0 if kept is None else num_crossing(kept.shape)
        less_sound = not after.has_lost(before) and crossing > num_crossing(state.shape)
        if less_sound:
            faces = count_text(crossing, "face")
            words = f"{words}, {faces} of which cross others; surface: outer leaves out what lies inside"
        if kept is None or less_sound or Closeness.of(_mesh_at(kept), problem.target).is_worse_than(before):
            self._shortfalls[member].append(words)
            return state
        self._shortfalls[member].append(f"{words}, so the result is the surface of the source")
        return kept

    def _source_surface(self, problem: Problem) -> FitState | None:
        """Return the source with the faces of a result; None if a fit with these settings cannot have it."""
        if self.settings.variables == "control":
            return None
        start = self._start(problem, near=True)
        if self.settings.connectivity == "remeshed":
            return start
        for _ in range(self.settings.levels):
            start = linearly_refined(start, problem.scheme) or refine_state(start, problem.scheme)
        return start

    def _is_near(self, problem: Problem, target: TargetCloud) -> tuple[bool, float]:
        """Return whether a source is so near to its target that the search for the rough shape is skipped."""
        return is_near(self._shape(problem), target, problem.target)

    def _shape(self, problem: Problem) -> Shape:
        verts = torch.tensor(problem.source.verts, dtype=self.dtype, device=self.device)
        return Shape(Connectivity(self._faces(problem), len(verts), self.dtype), verts)

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""
        saved = {"surface": self._states[member].saved(), "rough": self._restarts[member].saved()}
        return super().checkpoint(member) | saved | {"made": self._made[member]}

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""
        super().restore(checkpoints)
        self._states = [self._restored(*pair) for pair in zip(checkpoints, self.problems, strict=True)]
        self._restarts = [Restarts.restored(saved["rough"], self.dtype, self.device) for saved in checkpoints]
        self._made = [int(saved.get("made") or saved["done"]) for saved in checkpoints]

    def _check(self, problem: Problem) -> None:
        require_manifold(Topology.of(problem.source), "a Gauss–Newton fit")
        has_limit = has_loop_limit(resolve(problem.scheme))
        if self.settings.limit and (self.settings.variables != "control" or not has_limit):
            raise ConfigError("limit: limit surfaces are fitted with variables: control and the scheme loop")

    def _start(self, problem: Problem, *, near: bool = False) -> FitState:
        verts = torch.tensor(problem.source.verts, dtype=self.dtype, device=self.device)
        on_sphere = self._sphere_map(problem) if self.settings.connectivity == "fixed" and not near else None
        crossing = near and self._pieces_cross(problem.source)
        state = FitState.of(verts, self._faces(problem), on_sphere, _polygons_of(problem), crossing=crossing)
        return replace(state, rest=initial_rest(problem, self.settings))

    def _pieces_cross(self, source: Mesh) -> bool:
        """Return whether some pieces of a near source cross each other, as they do in its target then."""
        if source not in self._crossing:
            crosses = piece_of_face(source)[0] > 1
            if crosses:
                crossing, within = crossing_faces(source)
                crosses = bool((crossing & ~within).any())
            self._crossing[source] = crosses
        return self._crossing[source]

    def _faces(self, problem: Problem) -> Tensor:
        return torch.tensor(problem.source.faces, device=self.device)

    def _sphere_map(self, problem: Problem) -> Tensor | None:
        """Return the positions of a source on the sphere; computed once, as it may take seconds."""
        if problem.source not in self._sphere_maps:
            self._sphere_maps[problem.source] = initial_sphere_map(problem.source)
        on_sphere = self._sphere_maps[problem.source]
        return None if on_sphere is None else on_sphere.to(self.device)

    def _restored(self, checkpoint: Checkpoint, problem: Problem) -> FitState:
        state = FitState.restored(checkpoint["surface"], self.dtype, self.device)
        before = self._plans[False][checkpoint["done"] - 1][0] if checkpoint["done"] else None
        if before is None or before.change != "control":
            return state
        return self._with_control_mesh(state, problem, checkpoint["surface"].get("triangles"))

    def _with_control_mesh(self, state: FitState, problem: Problem, triangles: Tensor | None = None) -> FitState:
        levels, limit = self.settings.levels, self.settings.limit
        return with_control_mesh(state, problem.scheme, levels, limit=limit, triangles=triangles)

    def _step(self, member: int, stage: Stage, number: int) -> float:
        problem, skin, restarts = self.problems[member], self._skins[member], self._restarts[member]
        target = self._targets[member] if skin is None else skin.at(stage)
        before = self._states[member]
        if number == 0 and stage.attempt is None:
            restarts.still = False
        if restarts.still or (stage.attempt is not None and restarts.settled):
            return restarts.distance
        self._made[member] += 1
        if number == 0:
            sizing = self._shown_by_itself(before) if self._only_hull(member) and stage.sized else target
            before = self._changed(before, problem, stage, sizing)
        fairness, point_weight = stage.weights[number]
        images = self._images_at(member, stage)
        least = target.least_fairness(len(before.verts))
        fairness = max(fairness, least if images is None else images.least_fairness(len(before.verts)))
        robust = stage.robust if self.settings.robust == "auto" else None
        report = before.step(
            target,
            fairness,
            point_weight,
            self._generators[member],
            self.settings.direction,
            robust,
            self._adapted(member) if images is None else self._with_images(images, self._adapted(member)),
        )
        distance, matched, after = report.pairs.distance, report.pairs.matched, report.state
        if not bool(after.verts.isfinite().all()):
            last_good = _polygons_at(before) or _mesh_at(before)
            self.failed[member] = Diverged(self.done, "the step", last_good, self.traces[member], _REMEDY)
            return distance
        self._states[member] = after
        if images is not None and stage.change == "remesh":
            stage = replace(stage, settles=False)  # parts that no contour shows go on after these have settled
        restarts.record(stage, number, report.pairs)
        self._trace(member, distance, matched, fairness, point_weight, report.held)
        return distance

    def _adapted(self, _member: int) -> Callable[[Correspondences, Shape], Correspondences] | None:
        """Return how correspondences are adapted to what is known of the source; None if nothing is."""
        return None

    def _with_images(
        self, images: ImageRows, adapted: Callable[[Correspondences, Shape], Correspondences] | None
    ) -> Callable[[Correspondences, Shape], Correspondences]:
        """Return how correspondences become rows of images, after they are adapted as they are without these."""

        def with_rows(pairs: Correspondences, shape: Shape) -> Correspondences:
            return images.adapted(pairs if adapted is None else adapted(pairs, shape), shape, self.done)

        return with_rows

    def _images_at(self, member: int, stage: Stage) -> ImageRows | None:
        """Return the images that a step of a stage follows.

        A search for the rough shape follows depth; or the hull, until most of the surface is on it.
        """
        near, _ = self._near[member]
        reached = self._only_hull(member) and (near or self._restarts[member].matched > _ON_HULL)
        return self._images[member] if stage.attempt is None or reached else None

    def _only_hull(self, member: int) -> bool:
        """Return whether the target is no more than the visual hull of images, inside which the surface may lie."""
        images = self._images[member]
        return images is not None and not images.shows_depth

    def _shown_by_itself(self, state: FitState) -> TargetCloud:
        """Return the surface itself as the source of curvature."""
        return TargetCloud.of(_mesh_at(state), self.dtype, self.device, 0.0, robust=False)

    def _trace(
        self, member: int, distance: float, matched: float, fairness: float, point_weight: float, held: int
    ) -> None:
        """Add the row of a step, if it is one that is traced."""
        left = self._plans[False][self.done + 1 :]
        is_last = not any(self._applies(member, stage) for stage, _ in left)
        if self.done % self.settings.trace_every == 0 or is_last:
            verts = self._states[member].shape.connectivity.num_verts
            self.traces[member].rows.append((self.done, distance, verts, matched, fairness, point_weight, held))
            self.traces[member].seconds.append(self.seconds(member))

    def _changed(self, state: FitState, problem: Problem, stage: Stage, target: TargetCloud) -> FitState:
        """Return the state after the change that a stage begins with."""
        if stage.change == "start" and stage.attempt:
            state = self._start(problem)
        if stage.change == "refine":
            most = self.settings.verts if self.settings.connectivity == "remeshed" else math.inf
            fine = refine_state(state, problem.scheme) if len(state.verts) < most else state
            return state if len(fine.verts) > most else fine
        if stage.change == "control":
            return self._with_control_mesh(state, problem)
        if stage.change == "place" and state.on_sphere is not None:
            on_sphere, polygons = self._sphere_map(problem), _polygons_of(problem)
            if on_sphere is not None:
                state = state.with_connectivity(self._faces(problem), on_sphere, target, polygons)
            return state
        if stage.change == "decimate":
            return state.decimated(self.settings.verts)
        movable = self.settings.connectivity == "remeshed" or state.on_sphere is not None
        count = self._rough_verts(problem) * stage.share * growth(resolve(problem.scheme), stage.refined)
        if movable and (stage.change == "remesh" or (stage.change == "start" and len(state.verts) > count)):
            return state.remeshed(count, target if stage.sized else None)
        return state

    def _rough_verts(self, problem: Problem) -> float:
        """Return the number of vertices at the end of the rough shape."""
        factor = growth(resolve(problem.scheme), self.settings.levels)
        return rough_verts(self.settings, problem.source.num_verts, factor)


def outliers_left_out(target: TargetCloud) -> list[str]:
    """Return in words how many points were left out as outliers, if they are more than a few."""
    left_out, count = target.num_outliers, target.num_independent + target.num_outliers
    if left_out < _MANY_OUTLIERS * count:
        return []
    share = f"{100 * left_out / count:.2g} % of the target's points were left out as outliers"
    return [f"{share}; fit.robust: off follows them"]


def _mesh_at(state: FitState) -> Mesh:
    return state.shape.connectivity.mesh(state.shape.verts)


def _polygons_at(state: FitState) -> PolygonMesh | None:
    polygons = state.polygons if state.controlled is None else state.controlled.polygons
    return None if polygons is None else PolygonMesh(_mesh_at(state).verts, polygons.corners, polygons.sizes)


def _steps_of(stages: Sequence[Stage]) -> list[tuple[Stage, int]]:
    return [(stage, number) for stage in stages for number in range(len(stage.weights))]


def _polygons_of(problem: Problem) -> PolygonTopology | None:
    return None if problem.polygons is None else PolygonTopology.of(problem.polygons)
