"""The first-order engine: minimise the weighted loss terms over per-vertex offsets, with fresh samples every step."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from typing import Any

import torch
from torch import Tensor

from meshfit.fitting.device import as_cuda_graph
from meshfit.fitting.nearest_neighbours import match_nearest
from meshfit.fitting.optimizer import OPTIMIZERS, learning_rate
from meshfit.fitting.problem import Checkpoint, Diverged, Problem, Trace
from meshfit.fitting.sampling import AreaTable, sample
from meshfit.fitting.settings import FirstOrderSettings
from meshfit.loss.operators import FaceGeometry, Faces, MeshOperators
from meshfit.loss.terms import LAPLACIANS, TERMS, LossInputs, Term
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import renumber_verts_by_faces, sort_faces_spatially
from meshfit.mesh.polygons import PolygonMesh


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The objective of K problems at one step.

    Attributes:
        state: what it was computed from.
        terms: (K,) each acting term.
        values: (T, K) the same, without what they came from.
        gradient: (V, 3) of their weighted sum.
    """

    state: LossInputs
    terms: dict[str, Tensor]
    values: Tensor
    gradient: Tensor


class FirstOrder:
    """Fits in progress, K problems of the same settings side by side: `step` advances all of them by one.

    They are one mesh of K pieces that have nothing in common. What becomes of one does not depend on the others: on
    the CPU, to the byte.

    Attributes:
        problems: the K problems.
        settings: of all of them.
        device: what they run on.
        done: how many steps have been made.
        traces: of each problem.
        failed: those that have diverged, by their place among the problems; they are not to be stepped further.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: FirstOrderSettings,
        device: torch.device,
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        place: Mapping[str, Any] = {"dtype": dtype, "device": device}
        self.problems, self.settings, self.device, self.done = tuple(problems), settings, device, 0
        self._pool = pool
        self.traces, self.failed = [Trace() for _ in problems], dict[int, Diverged]()
        sources = _each_once(sort_faces_spatially, [problem.source for problem in problems])
        targets = _each_once(_in_order_throughout, [problem.target for problem in problems])
        self._surface = MeshOperators.of(sources, **place)
        self._start = torch.cat([torch.tensor(mesh.verts, **place) for mesh in sources])
        target_verts = torch.cat([torch.tensor(mesh.verts, **place) for mesh in targets])
        self._target = FaceGeometry.of(Faces.of(targets, **place), target_verts)
        self._target_table = AreaTable.of(self._target)
        self._offsets = torch.zeros_like(self._start)
        self._optimizer = OPTIMIZERS[settings.optimizer.name](self._offsets, settings.optimizer)
        self._generators = [torch.Generator(device).manual_seed(problem.seed) for problem in problems]
        self._last_good = self._start
        weights = settings.losses.model_dump()
        self._terms: dict[str, Term] = TERMS | {"laplacian": LAPLACIANS[settings.laplacian]}
        acting = [name for name in self._terms if weights[name] > 0]
        self._weights = {name: float(torch.tensor(weights[name], dtype=dtype)) for name in acting}
        each = torch.ones(len(problems), **place)
        self._output_gradients = {name: weight * each for name, weight in self._weights.items()}
        self._evaluate = as_cuda_graph(self._evaluate_eagerly, self._generators, device)
        self._find_lost_positions()

    @property
    def steps(self) -> int:
        """How many steps there are to make."""
        return self.settings.steps

    @property
    def stage(self) -> str:
        """What the next step is a part of; there is one stage alone."""
        return ""

    def mesh(self, member: int) -> Mesh:
        """A source as it lies now, in float64."""
        return self._as_mesh(member, self._start + self._offsets)

    def polygons(self, member: int) -> PolygonMesh | None:
        """The source's polygons, with their verts where the surface has them."""
        polygons = self.problems[member].polygons
        return None if polygons is None else polygons.with_verts(self.mesh(member).verts)

    def control(self, _member: int) -> None:
        """There is no control mesh: the verts themselves are solved for."""
        return

    def step(self) -> list[float]:
        """Make one step; the loss of each problem before it is returned. `failed` is brought up to date."""
        now = self._evaluate()
        values: dict[str, list[float]] = dict(zip(now.terms, now.values.tolist(), strict=True))
        losses = [sum(self._weighted(values, k).values(), 0.0) for k in range(len(self.problems))]
        self._find_lost_losses(values, losses)
        lr = learning_rate(self.settings.optimizer, self.done, self.settings.steps)
        if self.done % self.settings.trace_every == 0 or self.done == self.settings.steps - 1:
            self._record(now.state, values, losses, lr)
        self._last_good = now.state.verts.detach().clone()  # a captured step has the next positions in the same place
        if not isfinite(float(now.gradient.sum())):
            self._find_lost_gradients(now)
        self._optimizer.step(now.gradient, lr)
        self.done += 1
        self._find_lost_positions()
        return losses

    def checkpoint(self, member: int) -> Checkpoint:
        """Everything that the next step of one problem depends on, as a copy: steps made later do not change it."""
        rows = self._rows(member)
        return {
            "done": self.done,
            "offsets": self._offsets[rows].clone(),
            "last_good": self._last_good[rows].clone(),
            "optimizer": self._optimizer.state_of(rows),
            "generator": self._generators[member].get_state(),
            "trace": list(self.traces[member].rows),
        }

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Go back, or on, to where checkpoints of the same problems were taken, all after as many steps."""
        with torch.no_grad():
            self._offsets.copy_(torch.cat([checkpoint["offsets"] for checkpoint in checkpoints]))
        self._last_good = torch.cat([checkpoint["last_good"] for checkpoint in checkpoints]).to(self._start)
        self._optimizer.put([checkpoint["optimizer"] for checkpoint in checkpoints])
        for generator, checkpoint in zip(self._generators, checkpoints, strict=True):
            generator.set_state(checkpoint["generator"].cpu())
        self.traces = [Trace(rows=[tuple(row) for row in checkpoint["trace"]]) for checkpoint in checkpoints]
        self.done = checkpoints[0]["done"]
        self._find_lost_positions()

    def without_failed(self) -> "FirstOrder":
        """The same fits without those that have failed."""
        left = [member for member in range(len(self.problems)) if member not in self.failed]
        problems = [self.problems[member] for member in left]
        others = FirstOrder(problems, self.settings, self.device, self._start.dtype, self._pool)
        others.restore([self.checkpoint(member) for member in left])
        return others

    def _evaluate_eagerly(self) -> Evaluation:
        verts, count = (self._start + self._offsets).requires_grad_(), self.settings.samples
        geometry = FaceGeometry.of(self._surface.faces, verts)
        source = sample(geometry, count, self._generators)
        target = sample(self._target, count, self._generators, self._target_table)
        matches = match_nearest(source.points, target.points, len(self.problems), self._pool)
        state = LossInputs(verts, self._surface, geometry, source, target, matches)
        terms = {name: self._terms[name](state) for name in self._weights}
        values = torch.stack([value.detach() for value in terms.values()]) if terms else verts.new_empty(0, 0)
        return Evaluation(state, terms, values, self._gradient(verts, terms))

    def _gradient(self, verts: Tensor, terms: Mapping[str, Tensor]) -> Tensor:
        """Of the weighted sum of some terms."""
        acting = [name for name, value in terms.items() if value.requires_grad]
        if not acting:
            return torch.zeros_like(verts)
        outputs, weights = [terms[name] for name in acting], [self._output_gradients[name] for name in acting]
        return torch.autograd.grad(outputs, verts, weights, retain_graph=True)[0]

    def _weighted(self, values: Mapping[str, list[float]], member: int) -> dict[str, float]:
        return {name: self._weights[name] * value[member] for name, value in values.items()}

    def _record(self, state: LossInputs, values: dict[str, list[float]], losses: list[float], lr: float) -> None:
        with torch.no_grad():
            # Without what they have worked out before: a captured step does not renew that.
            fresh = replace(state, source=replace(state.source), target=replace(state.target))
            silent = {name: term(fresh).tolist() for name, term in self._terms.items() if name not in values}
        for member, loss in enumerate(losses):
            if member not in self.failed:
                row = {name: value[member] for name, value in (silent | values).items()}
                self.traces[member].append(self.done, loss, row, lr)

    def _find_lost_losses(self, values: Mapping[str, list[float]], losses: list[float]) -> None:
        """Find losses that are not finite, or would not be in the precision of the fit."""
        largest = torch.finfo(self._start.dtype).max
        for member in (k for k, loss in enumerate(losses) if not abs(loss) <= largest):
            weighted = self._weighted(values, member)
            self._fail(member, next((name for name, value in weighted.items() if not abs(value) <= largest), "loss"))

    def _find_lost_gradients(self, now: Evaluation) -> None:
        terms = {name: self._gradient(now.state.verts, {name: value}) for name, value in now.terms.items()}
        for member in range(len(self.problems)):
            rows = self._rows(member)
            if not bool(now.gradient[rows].isfinite().all()):
                lost = (name for name, gradient in terms.items() if not gradient[rows].isfinite().all())
                self._fail(member, f"gradient of {next(lost, 'loss')}")

    def _find_lost_positions(self) -> None:
        """Find verts that are not finite, and those too far off for areas and squared distances to be."""
        distance, limit = (self._start + self._offsets).abs(), _farthest(self._start.dtype)
        if not float(distance.max()) < limit:
            for member in range(len(self.problems)):
                if not float(distance[self._rows(member)].max()) < limit:
                    self._fail(member, "vertex position")

    def _fail(self, member: int, term: str) -> None:
        last_good = self._as_mesh(member, self._last_good)
        self.failed.setdefault(member, Diverged(self.done, term, last_good, self.traces[member]))

    def _rows(self, member: int) -> slice:
        before = sum(problem.source.num_verts for problem in self.problems[:member])
        return slice(before, before + self.problems[member].source.num_verts)

    def _as_mesh(self, member: int, verts: Tensor) -> Mesh:
        return Mesh(verts[self._rows(member)].cpu().double().numpy(), self.problems[member].source.faces)


def _each_once(prepare: Callable[[Mesh], Mesh], meshes: Sequence[Mesh]) -> list[Mesh]:
    """Every mesh prepared; one that several problems share, once."""
    prepared = {mesh: prepare(mesh) for mesh in dict.fromkeys(meshes)}
    return [prepared[mesh] for mesh in meshes]


def _in_order_throughout(mesh: Mesh) -> Mesh:
    return renumber_verts_by_faces(sort_faces_spatially(mesh))


def _farthest(dtype: torch.dtype) -> float:
    """Coordinates up to which the fourth powers that squared areas are made of do not overflow."""
    return sqrt(sqrt(torch.finfo(dtype).max)) / 8
