"""The first-order engine: minimises weighted loss terms over per-vertex offsets, with fresh samples every step."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from typing import Any

import torch
from torch import Tensor

from meshfit.errors import ConfigError
from meshfit.fitting.device import as_cuda_graph
from meshfit.fitting.loop import Engine
from meshfit.fitting.nearest_neighbours import match_nearest
from meshfit.fitting.optimizer import Optimizer, learning_rate
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.fitting.sampling import AreaTable, sample
from meshfit.fitting.settings import VIEW_TERMS, FirstOrderSettings, ViewSettings
from meshfit.images.views import Views
from meshfit.images.visual_hull import hull_of
from meshfit.loss.operators import FaceGeometry, Faces, MeshOperators
from meshfit.loss.terms import LAPLACIANS, TERMS, LossInputs, Term
from meshfit.loss.view_terms import ViewTarget, view_terms
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import renumber_verts_by_faces, sort_faces_spatially
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The objective of K problems at one step.

    Attributes:
        inputs: inputs of the loss terms.
        terms: the (K,) values of every term with a weight above 0.
        values: (T, K) the same, detached.
        gradient: (V, 3) gradient of their weighted sum.
    """

    inputs: LossInputs
    terms: dict[str, Tensor]
    values: Tensor
    gradient: Tensor


class FirstOrder(Engine):
    """Fits that are stepped side by side, as one mesh of K disconnected parts.

    On the CPU, each result is byte-identical regardless of the rest of the batch.
    """

    settings: FirstOrderSettings

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: FirstOrderSettings,
        device: torch.device,
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        super().__init__(problems, settings, device, dtype, pool)
        options: Mapping[str, Any] = {"dtype": dtype, "device": device}
        sources = _map_unique(sort_faces_spatially, [problem.source for problem in problems])
        targets = _map_unique(sort_faces_spatially, [_target_mesh(problem) for problem in problems])
        targets = _map_unique(renumber_verts_by_faces, targets)
        self._operators = MeshOperators.of(sources, **options)
        self._start = torch.cat([torch.tensor(mesh.verts, **options) for mesh in sources])
        target_verts = torch.cat([torch.tensor(mesh.verts, **options) for mesh in targets])
        self._target = FaceGeometry.of(Faces.of(targets, **options), target_verts)
        self._target_table = AreaTable.of(self._target)
        self._offsets = torch.zeros_like(self._start)
        self._optimizer = Optimizer(self._offsets, settings.optimizer)
        self._views = self._targets_of_views()
        self._generators = [torch.Generator(device).manual_seed(problem.seed) for problem in problems]
        self._last_good = self._start
        weights = settings.losses.model_dump()
        self._terms: dict[str, Term] = TERMS | {"laplacian": LAPLACIANS[settings.laplacian]}
        active = [name for name in self._terms if weights[name] > 0]
        of_views = settings.losses.of_views if any(self._views) else {}
        weights, active = weights | of_views, [*active, *of_views]
        self._weights = {name: float(torch.tensor(weights[name], dtype=dtype)) for name in active}
        ones = torch.ones(len(problems), **options)
        self._output_gradients = {name: weight * ones for name, weight in self._weights.items()}
        # What is seen differs from step to step in size, which no CUDA graph allows.
        is_fixed = not any(self._views)
        self._evaluate = (
            as_cuda_graph(self._evaluate_eagerly, self._generators, device) if is_fixed else self._evaluate_eagerly
        )
        self._fail_on_positions()

    def mesh(self, member: int) -> Mesh:
        """Return the current surface, in float64."""
        return self._as_mesh(member, self._start + self._offsets)

    def polygons(self, member: int) -> PolygonMesh | None:
        """Return the source's polygons at the current positions, if it has any."""
        polygons = self.problems[member].polygons
        return None if polygons is None else polygons.with_verts(self.mesh(member).verts)

    def step(self) -> list[float]:
        """Make one step, update `failed`, and return the loss of each problem before the step."""
        evaluation = self._evaluate()
        values: dict[str, list[float]] = dict(zip(evaluation.terms, evaluation.values.tolist(), strict=True))
        losses = [sum(self._weighted(values, k).values(), 0.0) for k in range(len(self.problems))]
        self._fail_on_losses(values, losses)
        lr = learning_rate(self.settings.optimizer, self.done, self.settings.steps)
        if self.done % self.settings.trace_every == 0 or self.done == self.settings.steps - 1:
            self._record(evaluation.inputs, values, losses, lr)
        self._last_good = evaluation.inputs.verts.detach().clone()  # a CUDA graph reuses the memory
        if not isfinite(float(evaluation.gradient.sum())):
            self._fail_on_gradients(evaluation)
        self._optimizer.step(evaluation.gradient, lr)
        self.done += 1
        self._fail_on_positions()
        return losses

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""
        rows = self._rows(member)
        return super().checkpoint(member) | {
            "offsets": self._offsets[rows].clone(),
            "last_good": self._last_good[rows].clone(),
            "optimizer": self._optimizer.state_of(rows),
        }

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""
        super().restore(checkpoints)
        with torch.no_grad():
            self._offsets.copy_(torch.cat([checkpoint["offsets"] for checkpoint in checkpoints]))
        self._last_good = torch.cat([checkpoint["last_good"] for checkpoint in checkpoints]).to(self._start)
        self._optimizer.restore([checkpoint["optimizer"] for checkpoint in checkpoints])
        self._fail_on_positions()

    def _evaluate_eagerly(self) -> Evaluation:
        verts, count = (self._start + self._offsets).requires_grad_(), self.settings.samples
        geometry = FaceGeometry.of(self._operators.faces, verts)
        source = sample(geometry, count, self._generators)
        target = sample(self._target, count, self._generators, self._target_table)
        matches = match_nearest(source.points, target.points, len(self.problems), self._pool)
        inputs = LossInputs(verts, self._operators, geometry, source, target, matches)
        terms = {name: self._terms[name](inputs) for name in self._weights if name in self._terms}
        terms |= self._terms_of_views(verts)
        values = torch.stack([value.detach() for value in terms.values()]) if terms else verts.new_empty(0, 0)
        return Evaluation(inputs, terms, values, self._gradient(verts, terms))

    def _terms_of_views(self, verts: Tensor) -> dict[str, Tensor]:
        """Return the (K,) values of the terms of images, each fit in some views of its own; 0 for fits without."""
        names = [name for name in self._weights if name in VIEW_TERMS]
        if not names:
            return {}
        options = self.settings.views or ViewSettings()
        values: dict[str, list[Tensor]] = {name: [] for name in names}
        for member, views in enumerate(self._views):
            if not views:
                for terms in values.values():
                    terms.append(verts.new_zeros(()))
                continue
            generator = self._generators[member]
            order = torch.randperm(len(views), generator=generator, device=generator.device)[: options.per_step]
            chosen = [views[place] for place in sorted(order.tolist())]
            mesh, at = self.problems[member].source, verts[self._rows(member)]
            found = view_terms(at, mesh, chosen, names, options.blur, options.silhouette)
            for name in names:
                values[name].append(found[name])
        return {name: torch.stack(terms) for name, terms in values.items()}

    def _targets_of_views(self) -> list[tuple[ViewTarget, ...]]:
        """Return the views of each problem, which those of one target share; () for problems without."""
        every = [problem.images for problem in self.problems]
        blur = (self.settings.views or ViewSettings()).blur
        targets: dict[Views | None, tuple[ViewTarget, ...]] = {}
        for images in dict.fromkeys(every):
            fault = self.settings.fault_with(None if images is None else images.maps)
            if fault:
                raise ConfigError(fault)
            targets[images] = tuple(ViewTarget.of(view, blur, self.dtype, self.device) for view in images or ())
        return [targets[images] for images in every]

    def columns_of(self, problem: Problem) -> tuple[str, ...]:
        """Return the names of the columns: those of all terms, and of images the terms with a weight above 0."""
        if problem.images is None:
            return self.columns
        return (*self.columns[:-1], *self.settings.losses.of_views, self.columns[-1])

    def _gradient(self, verts: Tensor, terms: Mapping[str, Tensor]) -> Tensor:
        """Return the gradient of the weighted sum of some terms."""
        names = [name for name, value in terms.items() if value.requires_grad]
        if not names:
            return torch.zeros_like(verts)
        outputs, weights = [terms[name] for name in names], [self._output_gradients[name] for name in names]
        return torch.autograd.grad(outputs, verts, weights, retain_graph=True)[0]

    def _weighted(self, values: Mapping[str, list[float]], member: int) -> dict[str, float]:
        return {name: self._weights[name] * value[member] for name, value in values.items()}

    def _record(self, inputs: LossInputs, values: dict[str, list[float]], losses: list[float], lr: float) -> None:
        with torch.no_grad():
            # Copies drop cached properties, which a replayed CUDA graph does not update.
            fresh = replace(inputs, source=replace(inputs.source), target=replace(inputs.target))
            inactive = {name: term(fresh).tolist() for name, term in self._terms.items() if name not in values}
        for member, loss in enumerate(losses):
            if member not in self.failed:
                row = {name: value[member] for name, value in (inactive | values).items()}
                self.traces[member].append(self.done, loss, row, lr)
                self.traces[member].seconds.append(self.seconds(member))

    def _fail_on_losses(self, values: Mapping[str, list[float]], losses: list[float]) -> None:
        """Fail the problems whose losses are not finite in the precision of the fit."""
        largest = torch.finfo(self.dtype).max
        for member in (k for k, loss in enumerate(losses) if not abs(loss) <= largest):
            weighted = self._weighted(values, member)
            self._fail(member, next((name for name, value in weighted.items() if not abs(value) <= largest), "loss"))

    def _fail_on_gradients(self, evaluation: Evaluation) -> None:
        verts = evaluation.inputs.verts
        gradients = {name: self._gradient(verts, {name: value}) for name, value in evaluation.terms.items()}
        for member in range(len(self.problems)):
            rows = self._rows(member)
            if not bool(evaluation.gradient[rows].isfinite().all()):
                names = (name for name, gradient in gradients.items() if not gradient[rows].isfinite().all())
                self._fail(member, f"gradient of {next(names, 'loss')}")

    def _fail_on_positions(self) -> None:
        """Fail the problems with positions that are not finite, or so large that squared areas overflow."""
        distance, limit = (self._start + self._offsets).abs(), _farthest(self.dtype)
        if not float(distance.max()) < limit:
            for member in range(len(self.problems)):
                if not float(distance[self._rows(member)].max()) < limit:
                    self._fail(member, "vertex position")

    def _fail(self, member: int, term: str) -> None:
        mesh, polygons = self._as_mesh(member, self._last_good), self.problems[member].polygons
        last_good = mesh if polygons is None else PolygonMesh(mesh.verts, polygons.corners, polygons.sizes)
        self.failed.setdefault(member, Diverged(self.done, term, last_good, self.traces[member]))

    def _rows(self, member: int) -> slice:
        before = sum(problem.source.num_verts for problem in self.problems[:member])
        return slice(before, before + self.problems[member].source.num_verts)

    def _as_mesh(self, member: int, verts: Tensor) -> Mesh:
        return Mesh(verts[self._rows(member)].cpu().double().numpy(), self.problems[member].source.faces)


def _map_unique(prepare: Callable[[Mesh], Mesh], meshes: Sequence[Mesh]) -> list[Mesh]:
    """Apply a function to every mesh; once to a mesh that several problems share."""
    prepared = {mesh: prepare(mesh) for mesh in dict.fromkeys(meshes)}
    return [prepared[mesh] for mesh in meshes]


def _farthest(dtype: torch.dtype) -> float:
    """Return the coordinate up to which squared areas, which are sums of fourth powers, do not overflow."""
    return sqrt(sqrt(torch.finfo(dtype).max)) / 8


def _target_mesh(problem: Problem) -> Mesh:
    if isinstance(problem.target, PointCloud):
        if problem.images is not None:
            return hull_of(problem.images)
        raise ConfigError("target: a point cloud has no faces to sample; use method: gauss-newton")
    return problem.target
