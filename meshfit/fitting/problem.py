"""A fitting problem, its trace, its checkpoint, and its divergence."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from meshfit.errors import TrialError
from meshfit.fitting.callbacks import Step
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.subdivision.registry import Scheme

COLUMNS = ("step", "loss", "chamfer", "normal", "edge", "laplacian", "consistency", "lr")

_REMEDY = "lower fit.optimizer.lr or the term's weight"

Row = tuple[int | float, ...]

Checkpoint = dict[str, Any]
"""Everything that the next step of a fit depends on, in types that `torch.load(weights_only=True)` reads."""


@dataclass
class Trace:
    """A table with one row per traced step.

    Attributes:
        columns: names of the columns; by default the step, the weighted sum, every unweighted term, and the learning
            rate.
        rows: the numbers, in the order of the columns.
    """

    columns: tuple[str, ...] = COLUMNS
    rows: list[Row] = field(default_factory=list)

    def append(self, step: int, loss: float, terms: dict[str, float], lr: float) -> None:
        """Add the row of one step."""
        self.rows.append((step, loss, *(terms[name] for name in COLUMNS[2:-1]), lr))

    def to_csv(self) -> str:
        """Return the trace as CSV, with numbers that read back as the same doubles."""
        lines = (",".join([str(int(row[0])), *(repr(float(value)) for value in row[1:])]) for row in self.rows)
        return "\n".join([",".join(self.columns), *lines]) + "\n"


@dataclass(frozen=True, eq=False)
class Problem:
    """A source to be fitted to a target.

    Attributes:
        source: mesh to start from.
        target: mesh to fit to.
        seed: seed of the samples.
        on_step: called after every step; may raise `Interrupted`.
        resume: checkpoint of the same problem to continue from.
        save: called with a checkpoint every few seconds, and when an `on_step` raises `Interrupted`.
        scheme: subdivision scheme that carries a Gauss–Newton fit from level to level.
        on_snapshot: called with the number of steps made and the surface, as often as the settings say; before a
            checkpoint of the same step is saved.
        polygons: the polygons that the source was triangulated from, if any; schemes on polygons start from them.
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


class Diverged(TrialError):  # noqa: N818  an outcome of a fit, under its usual name
    """A step of the fit was not finite.

    Attributes:
        step: number of the step, from 0.
        term: the quantity that was not finite: a loss term, `gradient of TERM`, `vertex position` or `the step`.
        last_good: the mesh before the step.
        trace: the rows before the step.
    """

    def __init__(self, step: int, term: str, last_good: Mesh, trace: Trace, remedy: str = _REMEDY) -> None:
        super().__init__(f"the fit diverged at step {step}: {term} is not finite; {remedy}")
        self.step, self.term, self.last_good, self.trace = step, term, last_good, trace
