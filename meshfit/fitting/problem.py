"""A fitting problem, its trace, its checkpoint, and its divergence."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from numbers import Integral
from typing import Any

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, TrialError
from meshfit.fitting.callbacks import Step
from meshfit.fitting.registration.guidance import Guidance
from meshfit.images.target import ImageTarget
from meshfit.images.views import Views
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.any_target import as_mesh_or_points
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.optional import import_optional, import_pandas
from meshfit.specs import suggest
from meshfit.subdivision.registry import Scheme
from meshfit.units import count_text, html_table

COLUMNS = ("step", "loss", "chamfer", "normal", "edge", "laplacian", "consistency", "lr")

_REMEDY = "lower fit.optimizer.lr or the term's weight"

_ROWS_SHOWN = 4
_SECONDS = "seconds"

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
        seconds: seconds of fitting until each row was recorded; they do not count when traces are compared.

    Example:
        >>> import meshfit
        >>> trace = meshfit.fit("icosahedron", "cube", steps=21, samples=100, device="cpu").trace
        >>> trace
        Trace(3 rows: step, loss, chamfer, normal, edge, laplacian, consistency, lr; step 0 to 20)
        >>> trace.column("step")
        [0, 10, 20]
    """

    columns: tuple[str, ...] = COLUMNS
    rows: list[Row] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list, compare=False)

    def __repr__(self) -> str:
        """Return the number of rows, the columns and the range of steps."""
        steps = f"; step {self.rows[0][0]} to {self.rows[-1][0]}" if self.rows else ""
        return f"Trace({count_text(len(self.rows), 'row')}: {', '.join(self.columns)}{steps})"

    def _repr_html_(self) -> str:
        """Return the first and the last rows as a table, for notebooks."""
        rows = [[f"{row[0]:.0f}", *(f"{value:.4g}" for value in row[1:])] for row in self.rows]
        if len(rows) > 2 * _ROWS_SHOWN:
            rows = [*rows[:_ROWS_SHOWN], ["…"] * len(self.columns), *rows[-_ROWS_SHOWN:]]
        return html_table(self.columns, rows, count_text(len(self.rows), "row"))

    @property
    def summary(self) -> str:
        """The last step, and the last value of the second column, which the fit reduces."""
        step, value = self.rows[-1][:2]
        return f"{self.columns[1]} {value:.3g} at step {step:.0f}"

    def append(self, step: int, loss: float, terms: dict[str, float], lr: float) -> None:
        """Add the row of one step."""
        self.rows.append((step, loss, *(terms[name] for name in self.columns[2:-1]), lr))

    def column(self, name: str) -> list[int | float]:
        """Return the numbers of one column; `seconds` is one where times were recorded.

        Raises:
            ConfigError: no such column.
        """
        if name == _SECONDS and self.has_times:
            return [*self.seconds]
        if name not in self.columns:
            raise ConfigError(f"'{name}' is not a column of the trace: {suggest(name, self.columns)}")
        return [row[self.columns.index(name)] for row in self.rows]

    def to_csv(self) -> str:
        """Return the trace as CSV, with numbers that read back as the same doubles."""
        lines = (",".join([str(int(row[0])), *(repr(float(value)) for value in row[1:])]) for row in self.rows)
        return "\n".join([",".join(self.columns), *lines]) + "\n"

    @property
    def has_times(self) -> bool:
        """Whether there is a time for each row."""
        return bool(self.rows) and len(self.seconds) == len(self.rows)

    def times_to_csv(self) -> str:
        """Return the times as CSV: a step and its seconds per row, to the microsecond."""
        rows = zip(self.rows, self.seconds, strict=True) if self.has_times else ()
        return "\n".join([f"step,{_SECONDS}", *(f"{row[0]},{seconds:.6f}" for row, seconds in rows)]) + "\n"

    def to_pandas(self) -> Any:  # noqa: ANN401  pandas is optional
        """Return the trace as a pandas DataFrame, indexed by the step, with `seconds` where times were recorded.

        Raises:
            ConfigError: pandas is not installed.
        """
        pandas = import_pandas()
        frame = pandas.DataFrame(self.rows, columns=list(self.columns)).astype({"step": int}).set_index("step")
        return frame.assign(seconds=self.seconds) if self.has_times else frame

    def plot(
        self,
        *columns: str,
        over: str = "step",
        ax: Any = None,  # noqa: ANN401  matplotlib is optional
        log: bool = True,
    ) -> Any:  # noqa: ANN401
        """Draw columns over the steps, or over the seconds.

        Args:
            *columns: their names; by default the objective and its terms, or the distance.
            over: the column of the horizontal axis: `step` or `seconds`.
            ax: matplotlib axes to draw into; new ones without it.
            log: draw the values on a logarithmic axis.

        Returns:
            The axes.

        Raises:
            ConfigError: no such column, or matplotlib is not installed.
        """
        names = columns or self.columns[1 : -1 if self.columns[-1] == COLUMNS[-1] else 2]
        curves, places = {name: self.column(name) for name in names}, self.column(over)
        if ax is None:
            _, ax = import_optional("matplotlib.pyplot").subplots(figsize=(6.0, 3.5), layout="constrained")
        for name, values in curves.items():
            ax.plot(places, [value if value > 0 or not log else float("nan") for value in values], label=name)
        ax.set_xlabel("seconds of the fit" if over == _SECONDS else over)
        if log:
            ax.set_yscale("log")
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(alpha=0.25)
        if len(curves) == 1:
            ax.set_ylabel(names[0])
        else:
            ax.legend(frameon=False, ncols=2)
        return ax


@dataclass(frozen=True, eq=False, init=False)
class Problem:
    """A source to be fitted to a target, both in a normalised frame, and in any form that `as_mesh` takes.

    Attributes:
        source: triangles to start from.
        target: triangles, or points of a scan, to fit to.
        seed: seed of the samples.
        on_step: called after every step; may raise `Interrupted`.
        resume: checkpoint of the same problem to continue from.
        save: called with a checkpoint every few seconds, and when an `on_step` raises `Interrupted`.
        scheme: subdivision scheme that carries a Gauss–Newton fit from level to level.
        on_snapshot: called with the number of steps made and the surface, as often as the settings say; before a
            checkpoint of the same step is saved.
        polygons: the polygons that the source was triangulated from, if any; schemes on polygons start from them.
        guidance: landmarks, weights, and parts of the source that stay or are rigid, for `register`.
        own: whether the source is a mesh of the user's own, whose vertices may have a meaning, not one that was made to
            start from; `register: auto` registers no others.
        images: views of the target, in the same frame, if it is given by images; `target` is then what they tell of it:
            the points of their depth maps, or the visual hull of their masks.

    Example:
        >>> import meshfit
        >>> meshfit.Problem(meshfit.subdivide("cube", "catmull-clark"), "octahedron", seed=3).source
        Mesh(26 verts, 48 faces, box 1.155 × 1.155 × 1.155)

    Raises:
        MeshError: source or target is not a mesh.
    """

    source: Mesh
    target: Mesh | PointCloud
    seed: int = 0
    on_step: Callable[[Step], None] | None = None
    resume: Checkpoint | None = None
    save: Callable[[Checkpoint], None] | None = None
    scheme: str | Scheme = "loop"
    on_snapshot: Callable[[int, Mesh | PolygonMesh], None] | None = None
    polygons: PolygonMesh | None = None
    guidance: Guidance | None = None
    own: bool = True
    images: Views | None = None

    @no_type_check
    def __init__(  # noqa: PLR0913, PLR0917  one argument for each attribute
        self,
        source: "MeshLike",
        target: "MeshLike | PointCloud | ImageTarget",
        seed: int = 0,
        on_step: Callable[[Step], None] | None = None,
        resume: Checkpoint | None = None,
        save: Callable[[Checkpoint], None] | None = None,
        scheme: str | Scheme = "loop",
        on_snapshot: Callable[[int, Mesh | PolygonMesh], None] | None = None,
        polygons: PolygonMesh | None = None,
        guidance: Guidance | None = None,
        own: bool = True,  # noqa: FBT001, FBT002  by name
        images: Views | None = None,
    ) -> None:
        if not isinstance(seed, Integral) or isinstance(seed, bool) or int(seed) < 0:
            raise ConfigError(f"seed: expected a whole number of at least 0, got {seed!r}")
        start = as_mesh(source, "source")
        polygons = start if isinstance(start, PolygonMesh) else polygons
        triangles = start.triangulated() if isinstance(start, PolygonMesh) else start
        if isinstance(target, ImageTarget):
            images = images or target.views
            target = target.shape
        goal = as_mesh_or_points(target)
        values = (triangles, goal, seed, on_step, resume, save, scheme, on_snapshot, polygons, guidance, own, images)
        for attribute, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, attribute.name, value)


class Diverged(TrialError):  # noqa: N818  an outcome of a fit, under its usual name
    """A step of the fit was not finite.

    Attributes:
        step: number of the step, from 0.
        term: the quantity that was not finite: a loss term, `gradient of TERM`, `vertex position` or `the step`.
        last_good: the mesh before the step, with the polygons of its source if it has any; its shape alone, without
            attributes.
        trace: the rows before the step.

    Example:
        >>> import meshfit
        >>> try:
        ...     meshfit.fit("icosahedron", "cube", steps=9, samples=100, optimizer={"lr": 1e30}, device="cpu")
        ... except meshfit.Diverged as diverged:
        ...     diverged.last_good
        Mesh(12 verts, 20 faces, box 1.701 × 1.701 × 1.701)
    """

    def __init__(
        self, step: int, term: str, last_good: Mesh | PolygonMesh, trace: Trace, remedy: str = _REMEDY
    ) -> None:
        super().__init__(f"the fit diverged at step {step}: {term} is not finite; {remedy}")
        self.step, self.term, self.last_good, self.trace = step, term, last_good, trace
