"""The trace of a fit: what it minimises and what that is made of, row by row."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from meshfit.errors import TrialError
from meshfit.fitting.callbacks import Step
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.registry import Scheme

COLUMNS = ("step", "loss", "chamfer", "normal", "edge", "laplacian", "consistency", "lr")

Row = tuple[int | float, ...]


@dataclass
class Trace:
    """Rows of numbers, a step each.

    Attributes:
        columns: what each row holds, the step first. By default, that is followed by the weighted sum, every term
            before its weight, and the learning rate.
        rows: the numbers, in this order.
    """

    columns: tuple[str, ...] = COLUMNS
    rows: list[Row] = field(default_factory=list)

    def append(self, step: int, loss: float, terms: dict[str, float], lr: float) -> None:
        """Add the row of one step."""
        self.rows.append((step, loss, *(terms[name] for name in COLUMNS[2:-1]), lr))

    def to_csv(self) -> str:
        """The trace as CSV; numbers are written so that reading them gives the same doubles."""
        lines = (",".join([str(int(row[0])), *(repr(float(value)) for value in row[1:])]) for row in self.rows)
        return "\n".join([",".join(self.columns), *lines]) + "\n"


Checkpoint = dict[str, Any]
"""All that the next step of a fit depends on, in types that `torch.load(weights_only=True)` reads."""

_REMEDY = "lower fit.optimizer.lr or the term's weight"


@dataclass(frozen=True, eq=False)
class Problem:
    """A source to be fitted to a target.

    Attributes:
        source: where to start; its faces are kept.
        target: what to reach.
        seed: of the samples.
        scheme: the subdivision scheme that carries the fit from level to level, where the method has levels.
        on_snapshot: called with the number of steps made and the surface, as often as the settings want snapshots;
            before a checkpoint of the same step is saved.
        polygons: whose fans the source's faces are, if they are any: schemes on polygons go on from these.
        on_step: called after every step; it may raise `Interrupted`.
        resume: a checkpoint of the same problem to go on from.
        save: called with a checkpoint every few seconds, and if an `on_step` raises `Interrupted`.
    """

    source: Mesh
    target: Mesh
    seed: int = 0
    on_step: Callable[[Step], None] | None = None
    resume: Checkpoint | None = None
    save: Callable[[Checkpoint], None] | None = None
    scheme: str | Scheme = "loop"
    on_snapshot: Callable[[int, Mesh | PolygonMesh], None] | None = None
    polygons: PolygonMesh | None = None


class Diverged(TrialError):  # noqa: N818  an outcome of a fit, named as the field names it
    """A step of the fit was not finite.

    Attributes:
        step: which one, counted from 0.
        term: what was not finite: a loss term, `gradient of TERM`, `vertex position` or `the step`.
        last_good: the mesh before it.
        trace: the rows until then.
    """

    def __init__(self, step: int, term: str, last_good: Mesh, trace: Trace, remedy: str = _REMEDY) -> None:
        super().__init__(f"the fit diverged at step {step}: {term} is not finite; {remedy}")
        self.step, self.term, self.last_good, self.trace = step, term, last_good, trace
