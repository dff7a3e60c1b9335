"""The first-order engine: minimise the weighted loss terms over per-vertex offsets, with fresh samples every step."""

import copy
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from meshfit.errors import TrialError
from meshfit.fitting.matching import match
from meshfit.fitting.optimizer import learning_rate, make_optimizer
from meshfit.fitting.progress import Interrupted, Step
from meshfit.fitting.sampling import sample
from meshfit.fitting.settings import FitSettings
from meshfit.fitting.trace import Trace
from meshfit.loss.surface import FaceGeometry, Surface
from meshfit.loss.terms import LAPLACIANS, TERMS, State, Term
from meshfit.mesh.mesh import Mesh


class Diverged(TrialError):  # noqa: N818  an outcome of a fit, named as the field names it
    """A step of the fit was not finite.

    Attributes:
        step: which one, counted from 0.
        term: the loss term at fault, or `gradient of TERM`.
        last_good: the mesh before it.
        trace: the rows until then.
    """

    def __init__(self, step: int, term: str, last_good: Mesh, trace: Trace) -> None:
        super().__init__(
            f"the fit diverged at step {step}: {term} is not finite; lower fit.optimizer.lr or the term's weight"
        )
        self.step, self.term, self.last_good, self.trace = step, term, last_good, trace


@dataclass(frozen=True, eq=False)
class Problem:
    """One fit: a source that moves, a target that does not, how, and from which seed."""

    source: Mesh
    target: Mesh
    settings: FitSettings
    seed: int
    device: torch.device
    dtype: torch.dtype


Checkpoint = dict[str, Any]
SECONDS_BETWEEN_CHECKPOINTS = 2.0


@dataclass(eq=False)
class FirstOrder:
    """A fit in progress: `step` advances it by one, `checkpoint` holds all that the next step depends on."""

    problem: Problem
    done: int = 0
    trace: Trace = field(default_factory=Trace)

    def __post_init__(self) -> None:
        problem = self.problem
        place: Mapping[str, Any] = {"dtype": problem.dtype, "device": problem.device}
        self._surface = Surface.of(problem.source, **place)
        self._start = torch.tensor(problem.source.verts, **place)
        target_verts = torch.tensor(problem.target.verts, **place)
        self._target = FaceGeometry.of(Surface.of(problem.target, **place), target_verts)
        self._offsets = torch.zeros_like(self._start, requires_grad=True)
        self._optimizer = make_optimizer(self._offsets, problem.settings.optimizer)
        self._generator = torch.Generator(problem.device).manual_seed(problem.seed)
        self._last_good = self._start
        weights = problem.settings.losses.model_dump()
        terms: dict[str, Term] = TERMS | {"laplacian": LAPLACIANS[problem.settings.laplacian]}
        self._acting = {name: (weights[name], term) for name, term in terms.items() if weights[name] > 0}
        self._silent = {name: term for name, term in terms.items() if name not in self._acting}

    @property
    def mesh(self) -> Mesh:
        """The source as it lies now, in float64."""
        return self._as_mesh(self._start + self._offsets.detach())

    def step(self) -> float:
        """Make one step; the loss before it is returned.

        Raises:
            Diverged: the loss or its gradient is not finite.
        """
        settings = self.problem.settings
        state = self._observe()
        terms = {name: term(state) for name, (_, term) in self._acting.items()}
        weighted = {name: self._acting[name][0] * value for name, value in terms.items()}
        total = sum(weighted.values(), state.verts.new_zeros(()))
        loss = total.item()
        if not math.isfinite(loss):
            raise self._diverged(next((name for name, value in weighted.items() if not value.isfinite()), "loss"))
        lr = learning_rate(settings.optimizer, self.done, settings.steps)
        if self.done % settings.trace_every == 0 or self.done == settings.steps - 1:
            self._record(state, loss, terms, lr)
        self._last_good = state.verts.detach()
        self._descend(total, weighted, lr)
        self.done += 1
        return loss

    def require_finite(self) -> None:
        """Check the positions that the last step led to.

        Raises:
            Diverged: one of them is not finite.
        """
        if not bool(self._offsets.isfinite().all()):
            raise self._diverged("vertex position")

    def checkpoint(self) -> Checkpoint:
        """Everything that the next step depends on, in types that `torch.load(weights_only=True)` reads.

        It is a copy: steps made later do not change it.
        """
        return {
            "done": self.done,
            "offsets": self._offsets.detach().clone(),
            "last_good": self._last_good.clone(),
            "optimizer": copy.deepcopy(self._optimizer.state_dict()),
            "generator": self._generator.get_state(),
            "trace": list(self.trace.rows),
        }

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back, or on, to where a checkpoint of the same problem was taken."""
        with torch.no_grad():
            self._offsets.copy_(checkpoint["offsets"])
        self._last_good = checkpoint["last_good"].to(self._start)
        # Copied, as torch keeps the tensors it is given where dtype and device are right.
        self._optimizer.load_state_dict(copy.deepcopy(checkpoint["optimizer"]))
        self._generator.set_state(checkpoint["generator"].cpu())
        self.done, self.trace = checkpoint["done"], Trace([tuple(row) for row in checkpoint["trace"]])

    def _observe(self) -> State:
        verts = self._start + self._offsets
        faces = FaceGeometry.of(self._surface, verts)
        # Not only where a vertex is not finite: also where it is too far off for areas, and so for samples.
        if not bool(faces.double_area.sum().isfinite()):
            raise self._diverged("vertex position")
        source = sample(faces, self.problem.settings.samples, self._generator)
        target = sample(self._target, self.problem.settings.samples, self._generator)
        return State(verts, self._surface, faces, source, target, match(source.points, target.points))

    def _record(self, state: State, loss: float, terms: dict[str, Tensor], lr: float) -> None:
        with torch.no_grad():
            values = terms | {name: term(state) for name, term in self._silent.items()}
        self.trace.append(self.done, loss, {name: value.item() for name, value in values.items()}, lr)

    def _descend(self, total: Tensor, weighted: dict[str, Tensor], lr: float) -> None:
        self._optimizer.zero_grad()
        if total.requires_grad:
            (self._offsets.grad,) = torch.autograd.grad(total, [self._offsets], retain_graph=True)
            if not bool(self._offsets.grad.isfinite().all()):
                raise self._diverged(f"gradient of {self._term_without_gradient(weighted)}")
        for group in self._optimizer.param_groups:
            group["lr"] = lr
        self._optimizer.step()

    def _term_without_gradient(self, weighted: dict[str, Tensor]) -> str:
        for name, value in weighted.items():
            (gradient,) = torch.autograd.grad(value, [self._offsets], retain_graph=True)
            if not bool(gradient.isfinite().all()):
                return name
        return "loss"

    def _diverged(self, term: str) -> Diverged:
        return Diverged(self.done, term, self._as_mesh(self._last_good), self.trace)

    def _as_mesh(self, verts: Tensor) -> Mesh:
        return Mesh(verts.detach().cpu().double().numpy(), self.problem.source.faces)


def run(
    fit: FirstOrder, on_step: Callable[[Step], None] | None = None, save: Callable[[Checkpoint], None] | None = None
) -> None:
    """Make all the steps that are left.

    Args:
        fit: where to start from.
        on_step: called after every step; it may raise `Interrupted`.
        save: called with a checkpoint every few seconds, and when the fit is interrupted.

    Raises:
        Diverged: a step was not finite.
        Interrupted: `on_step` asked for it.
    """
    steps, saved = fit.problem.settings.steps, time.monotonic()
    while fit.done < steps:
        loss = fit.step()
        if save is not None and time.monotonic() - saved > SECONDS_BETWEEN_CHECKPOINTS:
            save(fit.checkpoint())
            saved = time.monotonic()
        try:
            if on_step is not None:
                on_step(Step(fit.done, steps, loss))
        except Interrupted:
            if save is not None:
                save(fit.checkpoint())
            raise
    fit.require_finite()
