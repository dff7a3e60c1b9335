"""Registration of a template in steps: poses, deformation graphs from coarse to fine, unfolding, and all vertices."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from meshfit.fitting.gauss_newton.step_limiting import limit_step
from meshfit.fitting.registration.deformation_graph import DeformationGraph
from meshfit.fitting.registration.graph_fit import GraphFit
from meshfit.fitting.registration.guidance import NO_GUIDANCE, Guidance, HeldParts
from meshfit.fitting.registration.landmarks import pose_of_landmarks
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.pairs import Matching, Pairs, find_pairs
from meshfit.fitting.registration.plan import AS_SET, LEVELS, Level, PlannedStep, Prior, Register, Registered, levels_of
from meshfit.fitting.registration.poses import Pose, candidate_poses, nearest_pose, polished
from meshfit.fitting.registration.template import Template
from meshfit.fitting.registration.unfolding import Unfolding
from meshfit.fitting.registration.vertex_fit import VertexFit
from meshfit.fitting.settings import Direction
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.units import count_text

_POSES = 6
# Worths of a difference of 1 in remoteness at the start of the coarsest graph, relative to the diagonal: with it, limbs
# find each other however they are held; without it, a target of which large parts are missing.
_REMOTENESS = (0.5, 0.0)
# Of the attempts without remoteness, so many go on after so many steps.
_GO_ON, _FIRST_STEPS = 1, 12
# The start as given is taken, without a look at others, if it is judged better than the first of these values and the
# best rigid pose is turned by less than this angle; or better than the second.
_GOOD, _ALIKE, _VERY_GOOD = 0.025, 0.6, 0.015
# Where the template would end turned by more than this angle, it has to be judged better than as given by this factor.
_TURNED, _CLOSE = 0.6, 1.1
# Of `auto`: the gap at which a pose is enough, the share of points within it, and the value at which nothing serves.
_POSE_IS_ENOUGH, _NEARLY_ALL, _NOTHING_SERVES = 0.002, 0.95, 0.06
# Value from which the best attempt is reported. Of pairs that ended right, the worst had 0.046, with a quarter of the
# target missing; of those that ended wrong, most had 0.056 or more.
_DOUBTFUL = 0.05
# Nodes of the graphs that a fold may need, times of going back from them, and a retreat that is reported.
_STIFFER_NODES, _RETURNS, _NOTEWORTHY = (500, 150, 60, 20), 3, 0.005
_SYMMETRIC_ATTEMPTS = 4
# Points of each side by which a start is judged, the largest distance that counts, normals, and the weight of stretch.
_SAMPLES, _CAP, _NORMALS, _STRETCH = 1500, 0.1, 0.1, 2.0


@dataclass(frozen=True, eq=False)
class RegistrationTask:
    """A template, a target, and the settings of their registration.

    Attributes:
        source: the template.
        target: points of the target.
        prior: `rigid`: only its pose changes; `near-rigid`: it bends; `soft`: its parts also grow and shrink.
        direction: of the pairs.
        similarity: whether its size is to be found, too.
        guidance: landmarks, weights, and parts that stay or are rigid.
        seed: of the samples.
        choice: `auto` to find out whether a pose is enough, or nothing serves; `off` for what is not to be registered;
            None for neither.
    """

    source: Mesh
    target: OrientedPoints
    prior: Prior = "near-rigid"
    direction: Direction = "both"
    similarity: bool = False
    guidance: Guidance = NO_GUIDANCE
    seed: int = 0
    choice: Register | None = None

    @property
    def soft(self) -> bool:
        """Whether parts may grow and shrink."""
        return self.prior == "soft"

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of the target."""
        return float(np.linalg.norm(np.ptp(self.target.points, axis=0)))


class Registration:
    """A registration that is stepped.

    Attributes:
        task: what is registered.
        verts: (V, 3) where the vertices of the template are.
        pose: the pose that it has started from.
        distance: root mean square distance of the pairs of the last step.
        matched: share of the pairs of the last step that counted.
        crossing: number of pairs of faces that cross and did not at rest; after `unfold`.
        changed: number of pairs of faces that cross, and at rest cross others, but not each other; after `unfold`.
        folded: number of faces that are flipped or without area and were not at rest; after `unfold`.
        doubt: in words, another pose that serves about as well, or that none serves well; empty for neither.
        retreat: distance, relative to the diagonal, by which vertices stayed back so that there are none.
        registered: the prior, and why; of `auto`, once the pose has been found.
    """

    def __init__(self, task: RegistrationTask) -> None:
        self.task, self.verts, self.pose = task, task.source.verts, Pose.identity()
        self.distance, self.matched, self.retreat = float("inf"), 0.0, 0.0
        self.crossing, self.changed, self.folded = 0, 0, 0
        self.registered = Registered(task.prior, AS_SET)
        if task.choice == "off":
            self.registered = Registered("off", "as the source was made to start from")
        self.doubt = ""
        self._start = self.verts
        self._level = -1
        self._graph: DeformationGraph | None = None
        self._fit: GraphFit | VertexFit | None = None
        self._at_pose: Template | None = None
        self._unfolding: Unfolding | None = None
        self._at_rest = Template(task.source)
        self._held: HeldParts | None = None

    @property
    def template(self) -> Template:
        """The template in its pose."""
        if self._at_pose is None:
            self._at_pose = self._at_rest.posed(self.pose.applied(self.task.source.verts))
        return self._at_pose

    @property
    def held(self) -> HeldParts:
        """Vertices that stay, and rigid parts, of the template in its pose."""
        if self._held is None:
            self._held = HeldParts.of(self.template.mesh.verts, self.task.guidance)
        return self._held

    def step(self, planned: PlannedStep) -> None:
        """Make a step."""
        if planned.kind == "pose":
            self._find_pose()
        elif planned.kind == "graph":
            self._step_graph(planned)
        elif planned.kind == "unfold":
            self._unfold()
        else:
            self._step_vertices(planned)

    @property
    def shortfalls(self) -> list[str]:
        """Shortfalls of the result, in words."""
        texts = list[str]()
        if self.crossing:
            texts.append(f"{count_text(self.crossing, 'pair')} of faces cross that did not cross in the source")
        if self.changed:
            pairs = count_text(self.changed, "pair")
            texts.append(f"where the source crosses itself, {pairs} of faces cross that did not cross each other in it")
        if self.folded:
            texts.append(f"flipped or without area, but not in the source: {count_text(self.folded, 'face')}")
        if self.retreat > _NOTEWORTHY:
            texts.append(
                f"faces would have crossed, so vertices stayed back by up to {100 * self.retreat:.2g} % of the diagonal"
            )
        return texts

    def saved(self) -> dict[str, Any]:
        """Return everything that the next step depends on as numbers and tensors, for `restore`."""
        graph = self._graph
        arrays = {"verts": self.verts, "start": self._start, "turn": self.pose.rotation, "move": self.pose.translation}
        if graph is not None:
            arrays |= {"rotations": graph.rotations, "translations": graph.translations}
        numbers = {"scale": self.pose.scale, "level": self._level, "crossing": self.crossing, "folded": self.folded}
        numbers |= {"changed": self.changed}
        numbers |= {"distance": self.distance, "matched": self.matched, "retreat": self.retreat}
        words = {"register": self.registered.register, "reason": self.registered.reason}
        words["doubt"] = self.doubt
        return {key: torch.tensor(array) for key, array in arrays.items()} | numbers | words

    def restore(self, saved: dict[str, Any]) -> None:
        """Continue from what `saved` returned for the same task."""
        self.pose = Pose(saved["turn"].numpy(), saved["move"].numpy(), saved["scale"])
        self.verts, self._start, self._level = saved["verts"].numpy(), saved["start"].numpy(), saved["level"]
        self.distance, self.matched = saved["distance"], saved["matched"]
        self.crossing, self.folded, self.retreat = saved["crossing"], saved["folded"], saved["retreat"]
        self.changed = saved["changed"]
        self.registered, self.doubt = Registered(saved["register"], saved["reason"]), saved["doubt"]
        if self._level >= 0:
            graph = DeformationGraph.of(self.template, LEVELS[self._level].nodes)
            self._graph = graph.placed(saved["rotations"].numpy(), saved["translations"].numpy())

    def _find_pose(self) -> None:
        task = self.task
        poses = self._poses()
        if (task.guidance.used_landmarks is not None or task.guidance.fixed is not None) and task.prior == "rigid":
            self._place(poses[0])
            return
        if len(poses) > 1 and (task.prior == "rigid" or task.choice == "auto"):
            gap, pose = self._best_rigid(poses)
            if gap < _POSE_IS_ENOUGH:
                self._place(pose)
                if task.choice == "auto":
                    text = f"as its pose brings it within {100 * gap:.2g} % of the diagonal"
                    self.registered = Registered("rigid", text)
                return
        best = self._bend(poses)
        if task.prior == "rigid":
            # A body that has bent has no pose in which it fits; the best is that of the body after it has bent.
            areas = self._at_rest.points_at(task.source.verts).areas
            self._place(nearest_pose(task.source.verts, self.verts, areas, similarity=task.similarity))
            return
        if task.choice == "auto":
            text = f"as it bends to within {100 * best:.2g} % of the diagonal"
            self.registered = Registered("near-rigid", text)
            if best > _NOTHING_SERVES and not task.guidance.steers:
                text = f"as bent from no pose it is nearer than {100 * best:.2g} % of the diagonal: another shape"
                self.registered, self.doubt = Registered("off", text), ""

    def _best_rigid(self, poses: Sequence[Pose]) -> tuple[float, Pose]:
        """Return the least gap that poses leave, after ICP with many points, and the pose."""
        task, at_rest = self.task, self._at_rest.points_at(self.task.source.verts)
        found = [polished(pose, at_rest, task.target, similarity=task.similarity, seed=task.seed) for pose in poses[1:]]
        return min(((self._gap(pose), pose) for pose in found), key=lambda pair: pair[0])

    def _place(self, pose: Pose) -> None:
        """Register by a pose alone."""
        task, self.pose, self._at_pose = self.task, pose, None
        self._graph, self._level = None, -1
        self.verts = self.template.mesh.verts
        everything = np.arange(len(self.verts)), np.arange(len(task.target))
        matching = Matching(_CAP * task.diagonal, _NORMALS * task.diagonal, task.direction)
        pairs = find_pairs(self.template.points_at(self.verts), task.target, *everything, matching)
        self.distance, self.matched = pairs.distance, pairs.matched

    def _gap(self, pose: Pose) -> float:
        """Return a distance that nearly all points of both sides are within, across the surface, as a share."""
        task = self.task
        moved = self._at_rest.posed(pose.applied(task.source.verts))
        own = moved.points_at(moved.mesh.verts)
        lengths = list[np.ndarray]()
        for one, other, direction in ((own, task.target, "to-source"), (task.target, own, "to-target")):
            if task.direction == direction:
                continue
            some = one.thinned(_SAMPLES)
            _, hit = other.nearest(some, _NORMALS * task.diagonal)
            away = np.abs(((some.points - other.points[hit]) * other.normals[hit]).sum(axis=1))
            lengths.append(np.where(other.rim[hit], 0.0, away))
        return float(max(np.quantile(length, _NEARLY_ALL) for length in lengths)) / task.diagonal

    def _bend(self, poses: Sequence[Pose]) -> float:
        """Fit the coarsest graph from some poses, keep the best, and return how it was judged.

        The pose as given is tried first, then the others, with remoteness, until one serves very well; in the end
        without, where the best after some of the steps go on. Where another is hardly better, and turned, that as given
        is kept.
        """
        coarsest = DeformationGraph.of(self._at_rest, LEVELS[0].nodes)
        with_remoteness, without = _REMOTENESS
        given = self._attempt(coarsest, poses[0], with_remoteness).finished()
        tried, best = [given], given
        # Bodies that look alike from behind serve about as well turned, so no other pose may look better.
        plausible = len(poses) < 4 or poses[3].angle_to(poses[0]) < _ALIKE
        if best.value >= (_GOOD if plausible else _VERY_GOOD):
            for pose in poses[1:]:
                if best.value >= _VERY_GOOD:
                    other = self._attempt(coarsest, pose, with_remoteness).finished()
                    tried.append(other)
                    best = min(best, other, key=lambda attempt: attempt.value)
            if best.value >= _VERY_GOOD:  # parts may be missing
                others = [self._attempt(coarsest, pose, without).begun() for pose in poses]
                others = sorted(others, key=lambda attempt: attempt.value)[:_GO_ON]
                tried += [other.finished() for other in others]
        best = min(tried, key=lambda attempt: attempt.value)
        if given.value < _CLOSE * best.value and given.turn_to(best) > _TURNED:
            best = given
        self.doubt = _doubt_about(best) or _rival_of(best, tried)
        self.pose, self._at_pose = best.pose, best.fit.template
        self._graph, self.verts, self._level = best.graph, best.graph.positions(), 0
        self.distance, self.matched = best.distance, best.matched
        return best.value

    def _attempt(self, coarsest: DeformationGraph, pose: Pose, remoteness: float) -> "_Attempt":
        template = self._at_rest.posed(pose.applied(self.task.source.verts))
        return _Attempt(self.task, pose, self._graph_fit(template, remoteness), coarsest.posed(template.mesh.verts))

    def _poses(self) -> list[Pose]:
        task = self.task
        at_rest = self._at_rest.points_at(task.source.verts)
        if task.guidance.fixed is not None:
            return [Pose.identity()]
        landmarks = task.guidance.used_landmarks
        if landmarks is not None:
            return [pose_of_landmarks(landmarks, task.source, similarity=task.similarity)]
        return candidate_poses(at_rest, task.target, similarity=task.similarity, most=_POSES, seed=task.seed)

    def _step_graph(self, planned: PlannedStep) -> None:
        level = levels_of(self.task.prior)[planned.level]
        if self._level != planned.level or self._graph is None:
            self._graph = DeformationGraph.of(self.template, level.nodes).fitted_to(
                self.held.applied(self.verts), similar=self.task.soft
            )
            self._level = planned.level
        if not isinstance(self._fit, GraphFit):
            self._fit = self._graph_fit(self.template)
        self._graph, pairs = self._graph_step(self._fit, self._graph, level, planned.level, planned.number)
        self.verts = self._graph.positions()
        self.distance, self.matched = pairs.distance, pairs.matched

    def _graph_fit(self, template: Template, remoteness: float = 0.0) -> GraphFit:
        task, known = self.task, self.task.guidance
        fixed = None if known.fixed is None else np.flatnonzero(known.fixed)
        return GraphFit(
            template,
            task.target,
            task.direction,
            task.diagonal,
            remoteness,
            known.used_landmarks,
            known.weights,
            fixed,
            task.soft,
        )

    def _graph_step(
        self, fit: GraphFit, graph: DeformationGraph, level: Level, index: int, number: int
    ) -> tuple[DeformationGraph, Pairs]:
        generator = np.random.default_rng([self.task.seed, index, number])
        progress = (index + number / level.steps) / len(LEVELS)
        return fit.step(graph, level, number, generator, progress)

    def _unfold(self) -> None:
        """Take faces apart that cross or are folded; where that fails, go back to a stiffer state that is sound."""
        if self._unfolding is None:
            self._unfolding = Unfolding.of(self.template, self.held.mask if self.held else None)
        wanted = self.held.applied(self.verts)
        self.verts, (self.crossing, self.folded) = self._unfolding.unfolded(wanted)
        if self.crossing:
            self._retreat(self._unfolding, wanted)
        if self.folded:
            self.verts, self.folded = self._unfolding.smoothed(self.verts)
        if self.held.mirror is not None:
            self._make_symmetric(self._unfolding)
        self.changed = self._unfolding.num_changed_pairs(self.verts) if self._unfolding.crossing_at_rest.any() else 0
        self._start = self.verts

    def _make_symmetric(self, unfolding: Unfolding) -> None:
        """Make what has been unfolded symmetric, as it was before, and unfold again what crosses by it."""
        for _ in range(_SYMMETRIC_ATTEMPTS):
            self.verts = self.held.applied(self.verts)
            self.crossing, self.folded = unfolding.faults(self.verts)
            if not self.crossing:
                return
            self.verts, _ = unfolding.unfolded(self.verts)
        self.verts = self.held.applied(self.verts)
        self.crossing, self.folded = unfolding.faults(self.verts)

    def _retreat(self, unfolding: Unfolding, wanted: Verts) -> None:
        """Find a state in which nothing crosses, and go from there as far as this stays so towards what was wanted."""
        best, (fewest, _) = unfolding.unfolded(self.verts, stiffer=True)
        for nodes in _STIFFER_NODES:
            if not fewest:
                break
            stiff = DeformationGraph.of(self.template, nodes).fitted_to(wanted).positions()
            verts, (crossing, _) = unfolding.unfolded(self.held.applied(stiff))
            if crossing < fewest:
                best, fewest = verts, crossing
        if fewest:  # in its pose, nothing crosses that did not at rest
            best = self.template.mesh.verts
        for _ in range(_RETURNS):
            moved, _ = limit_step(self.template.connectivity, torch.tensor(best), torch.tensor(self.verts))
            if len(unfolding.new_pairs(returned := np.asarray(moved.numpy()))):
                break
            best = returned
        best = self.held.applied(best)
        self.verts, (self.crossing, self.folded) = best, unfolding.faults(best)
        away = float(np.linalg.norm(best - wanted, axis=1).max()) / self.task.diagonal
        self.retreat = max(self.retreat, away)

    def _step_vertices(self, planned: PlannedStep) -> None:
        task = self.task
        if not isinstance(self._fit, VertexFit):
            parts = self._start, task.direction, task.diagonal, task.guidance, self.held
            self._fit = VertexFit(self.template, task.target, *parts)
        self.verts, pairs = self._fit.step(self.verts, planned.number)
        self.distance, self.matched = pairs.distance, pairs.matched


@dataclass
class _Attempt:
    """A fit of the coarsest graph from one pose.

    Attributes:
        task: what is registered.
        pose: the pose.
        fit: of the graph.
        graph: where it is.
        done: number of steps made.
        value: how badly it serves, the less the better.
        distance: of the pairs of the last step.
        matched: share of its pairs that counted.
    """

    task: RegistrationTask
    pose: Pose
    fit: GraphFit
    graph: DeformationGraph
    done: int = 0
    value: float = np.inf
    distance: float = np.inf
    matched: float = 0.0

    def begun(self) -> "_Attempt":
        """Make some of the steps."""
        return self._stepped(_FIRST_STEPS)

    def finished(self) -> "_Attempt":
        """Make all steps that are left."""
        return self._stepped(LEVELS[0].steps)

    def turn_to(self, other: "_Attempt") -> float:
        """Return the angle of the rotation that brings where this one is nearest to where another is."""
        template = self.fit.template
        areas = template.points_at(template.mesh.verts).areas
        return Pose.identity().angle_to(
            nearest_pose(self.graph.positions(), other.graph.positions(), areas, similarity=False)
        )

    def _stepped(self, end: int) -> "_Attempt":
        for number in range(self.done, end):
            generator = np.random.default_rng([self.task.seed, 0, number])
            progress = number / LEVELS[0].steps / len(LEVELS)
            self.graph, pairs = self.fit.step(self.graph, LEVELS[0], number, generator, progress)
            self.distance, self.matched = pairs.distance, pairs.matched
        self.done = end
        self.value = _judged(self.fit.template, self.task, self.graph.positions())
        return self


def _rival_of(best: _Attempt, tried: Sequence[_Attempt]) -> str:
    """Name the best of the attempts that ended turned against the chosen one and are judged about as well."""
    close = [other for other in tried if other is not best and other.value < _CLOSE * best.value]
    for other in sorted(close, key=lambda attempt: attempt.value):
        if (angle := best.turn_to(other)) > _TURNED:
            return (
                f"the template fits about as well turned by {np.degrees(angle):.0f} degrees (misfit {other.value:.2g}, "
                f"{best.value:.2g} as it is); three landmarks tell which is right"
            )
    return ""


def _doubt_about(best: _Attempt) -> str:
    """Say that even the best attempt fits badly, as where a limb has not found its own."""
    if best.value < _DOUBTFUL:
        return ""
    return (
        f"the template bends no nearer than {100 * best.value:.2g} % of the diagonal: some parts may be on others of "
        "the target, or have none there; look at the result, and give landmarks where it is wrong"
    )


def _judged(template: Template, task: RegistrationTask, verts: Verts) -> float:
    """Return how badly a start serves: capped distances in position and normal, times 1 plus stretch."""
    generator, target = np.random.default_rng(0), task.target
    moved = template.points_at(verts)
    own, other = (side.subset(_some(len(side), generator)) for side in (moved, target))
    length, cap, total = _NORMALS * task.diagonal, _CAP * task.diagonal, 0.0
    if task.direction != "to-source":
        total += float((np.minimum(target.nearest(own, length)[0], cap) ** 2).mean())
    if task.direction != "to-target":
        total += float((np.minimum(moved.nearest(other, length)[0], cap) ** 2).mean())
    ratios = np.log(np.maximum(template.lengths_at(verts), 1e-12) / np.maximum(template.rest_lengths, 1e-12))
    stretch = float(np.sqrt((np.minimum(np.abs(ratios), 1) ** 2).mean()))
    return float(np.sqrt(total)) / task.diagonal * (1 + _STRETCH * stretch)


def _some(count: int, generator: np.random.Generator) -> np.ndarray:
    return generator.choice(count, min(count, _SAMPLES), replace=False)
