"""The base of both engines, and the loop that steps them: progress, snapshots, checkpoints and divergence."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch

from meshfit.fitting.callbacks import Interrupted, Step
from meshfit.fitting.external.tools import ToolRun
from meshfit.fitting.problem import COLUMNS, Checkpoint, Diverged, Problem, Trace
from meshfit.fitting.registration.plan import Registered
from meshfit.fitting.settings import FitSettings
from meshfit.mesh.any_mesh import MeshLike
from meshfit.mesh.attributes import NO_ATTRIBUTES, SUPPORTED
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import IDENTITY, Frame
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh

SECONDS_BETWEEN_CHECKPOINTS = 2.0
_WIDTH_SHOWN, _HEIGHT_SHOWN = 560, 520


class Engine(ABC):
    """A batch of fits with the same settings, stepped together; `member` is the index of a problem in the batch.

    Attributes:
        problems: the problems.
        settings: settings of all problems.
        device: device of all tensors.
        dtype: precision of all tensors.
        done: number of steps made.
        traces: trace of each problem.
        failed: problems that have diverged, by index; call `without_failed` before the next step.
    """

    settings: FitSettings
    columns: ClassVar[tuple[str, ...]] = COLUMNS
    _generators: list[torch.Generator]

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: FitSettings,
        device: torch.device,
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        self.problems, self.settings, self.device, self.dtype = tuple(problems), settings, device, dtype
        self.done, self._pool = 0, pool
        self._since, self._before = time.perf_counter(), [0.0] * len(problems)
        self.traces = [Trace(self.columns_of(problem)) for problem in problems]
        self.failed = dict[int, Diverged]()

    def columns_of(self, _problem: Problem) -> tuple[str, ...]:
        """Return the names of the columns of a problem's trace."""
        return self.columns

    @property
    def steps(self) -> int:
        """Total number of steps."""
        return self.settings.steps

    def progress(self, _member: int) -> tuple[int, int]:
        """Return the steps that a fit has made, and all that it will make as far as is known."""
        return self.done, self.steps

    @property
    def stage(self) -> str:
        """Name of the next step's stage; empty if there is one only."""
        return ""

    @abstractmethod
    def mesh(self, member: int) -> Mesh:
        """Return the current surface, in float64."""

    @abstractmethod
    def polygons(self, member: int) -> PolygonMesh | None:
        """Return the polygons that the current surface was triangulated from, if any."""

    def shortfalls(self, _member: int) -> Sequence[str]:
        """Return what the fit did not reach, in words, once it has ended."""
        return ()

    def registered(self, _member: int) -> Registered | None:
        """Return how the source was registered, once it has ended; None where registration is off."""
        return None

    def notes(self, _member: int) -> Sequence[str]:
        """Return what the fit did beyond its schedule, in words, once it has ended."""
        return ()

    def control(self, _member: int) -> Mesh | PolygonMesh | None:
        """Return the current control mesh, if one is solved for."""
        return None

    def tool(self, _member: int) -> ToolRun | None:
        """Return the run of an external tool, if one made the surface."""
        return None

    def landmarks(self, member: int, mesh: Mesh) -> PlacedLandmarks | None:
        """Return the landmarks of the source on the surface at the end, if it has the same faces."""
        source, guidance = self.problems[member].source, self.problems[member].guidance
        same = mesh.num_verts == source.num_verts and np.array_equal(mesh.faces, source.faces)
        return guidance.landmarks if guidance is not None and same else None

    def pose_scale(self, _member: int) -> float | None:
        """Return the change of size by the pose that a registration has found; None without one."""
        return None

    def seconds(self, member: int) -> float:
        """Return the seconds that a fit has taken: its share of those of the batch, in all attempts."""
        return self._before[member] + (time.perf_counter() - self._since) / len(self.problems)

    def with_attributes(self, member: int, surface: Mesh | PolygonMesh) -> Mesh | PolygonMesh:
        """Return the surface at the end with the attributes of the source, whose faces it has."""
        problem = self.problems[member]
        source = problem.polygons if isinstance(surface, PolygonMesh) and problem.polygons else problem.source
        return surface.with_attributes(source.attributes) if source.attributes else surface

    def control_with_attributes(self, member: int) -> Mesh | PolygonMesh | None:
        """Return the control mesh at the end, if one is solved for, with the attributes of the source."""
        return self.control(member)

    @abstractmethod
    def step(self) -> list[float]:
        """Make one step, update `failed`, and return the loss of each problem before the step."""

    def checkpoint(self, member: int) -> Checkpoint:
        """Return a copy of everything that the next step of one problem depends on."""
        trace, generator = self.traces[member], self._generators[member].get_state()
        times = {"times": list(trace.seconds), "elapsed": self.seconds(member)}
        return {"done": self.done, "trace": list(trace.rows), "generator": generator} | times

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Continue from checkpoints of the same problems, all taken after the same number of steps."""
        for generator, checkpoint in zip(self._generators, checkpoints, strict=True):
            generator.set_state(checkpoint["generator"].cpu())
        self.traces = [
            Trace(self.columns_of(problem), [tuple(row) for row in checkpoint["trace"]], list(checkpoint["times"]))
            for problem, checkpoint in zip(self.problems, checkpoints, strict=True)
        ]
        self._since, self._before = time.perf_counter(), [checkpoint["elapsed"] for checkpoint in checkpoints]
        self.done = checkpoints[0]["done"]

    def without_failed(self) -> "Engine":
        """Return the same fits without those that have failed."""
        left = [member for member in range(len(self.problems)) if member not in self.failed]
        problems = [self.problems[member] for member in left]
        engine = type(self)(problems, self.settings, self.device, self.dtype, self._pool)
        engine.restore([self.checkpoint(member) for member in left])
        return engine


@dataclass(frozen=True, eq=False)
class FitResult:
    """The result of a fit.

    Attributes:
        mesh: the deformed source, with its own faces, or those that the fit refined or remeshed them to.
        trace: one row of numbers per traced step.
        device: name of the device.
        control: the control mesh, if one was solved for: of polygons for a scheme on polygons, if the source has any.
            Refined by the scheme as many levels as the settings say, it is the surface.
        polygons: the polygons of which `mesh` is the triangulation, if any.
        frame: the frame of all lengths in the trace; that of no change for a result of `fit_batch`.
        target: the target, in its own coordinates as the meshes above; None for a result of `fit_batch`.
        shortfalls: what the fit did not reach, in words; empty for most.
        notes: what the fit did beyond its schedule, in words; empty for most.
        tool: the run of the external tool that made the mesh, if one did; there is no trace then.
        registered: how the source was registered; None where `register` is off.
        landmarks: the landmarks of the source on `mesh`, with their goals in the same coordinates, held out ones too;
            None without landmarks, or if the faces are not those of the source.
        pose_scale: change of size by the pose that a registration found; None without one.

    Example:
        >>> import meshfit
        >>> result = meshfit.fit("icosahedron", "cube", steps=5, samples=100, device="cpu")
        >>> result.trace.columns[:3], len(result.trace.rows), result.device
        (('step', 'loss', 'chamfer'), 2, 'cpu')
        >>> meshfit.save_mesh(result, "result.ply")
    """

    mesh: Mesh
    trace: Trace
    device: str
    control: Mesh | PolygonMesh | None = None
    polygons: PolygonMesh | None = None
    frame: Frame = IDENTITY
    target: Mesh | PointCloud | None = None
    shortfalls: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tool: ToolRun | None = None
    registered: Registered | None = None
    landmarks: PlacedLandmarks | None = None
    pose_scale: float | None = None

    def __repr__(self) -> str:
        """Return the mesh, the number of steps and the last value of the objective."""
        words = [repr(self.polygons or self.mesh), *([self.trace.summary] if self.trace.rows else []), self.device]
        return f"FitResult({', '.join(words)})"

    @property
    def supported(self) -> float | None:
        """Share of the area that the target shows; None if it has no rim, and so shows all of it.

        `mesh.attributes.vertex["supported"]`, and `face`, tell which vertices and faces these are.
        """
        shown = self.mesh.attributes.face.get(SUPPORTED)
        if shown is None:
            return None
        areas = face_areas(self.mesh)
        return float((areas * (shown != 0)).sum() / areas.sum())

    def show(self, *, edges: bool = True, up: str = "y", image: bool | None = None) -> Any:  # noqa: ANN401
        """Show the result, and the target beside it: in a window, in a notebook, or as an image without a display.

        Args:
            edges: draw the edges of faces.
            up: the axis that points up: `y` or `z`.
            image: return an image even where there is a display.

        Returns:
            A PIL image, the view of a notebook, or pyvista's plotter.

        Raises:
            ConfigError: pyvista is not installed, which the extra `report` brings.
        """
        from meshfit.mesh.show import show_meshes

        meshes: dict[str, MeshLike] = {"result": self.polygons or self.mesh}
        if isinstance(self.target, Mesh):
            meshes["target"] = self.target
        size = (_WIDTH_SHOWN * len(meshes), _HEIGHT_SHOWN)
        return show_meshes(meshes, edges=edges, up=up, size=size, image=image)


def run(engine: Engine, *, save_end: bool = False, snapshots: int | None = None) -> dict[Problem, FitResult | Diverged]:
    """Make all remaining steps; a problem that diverges stops, and the others continue.

    Args:
        engine: the fits.
        save_end: save checkpoints after the last step, too, because more work follows that may be interrupted.
        snapshots: number of steps between two snapshots.

    Raises:
        Interrupted: by an `on_step`; checkpoints have been saved.
    """
    outcomes: dict[Problem, FitResult | Diverged] = {}
    saved = time.monotonic()
    while True:
        outcomes |= {engine.problems[member]: diverged for member, diverged in engine.failed.items()}
        if len(engine.failed) == len(engine.problems):
            return outcomes
        if engine.failed:
            engine = engine.without_failed()
        if engine.done == engine.steps:
            if save_end:
                _save(engine)
            return outcomes | {problem: _result(engine, member) for member, problem in enumerate(engine.problems)}
        before = [engine.progress(member)[0] for member in range(len(engine.problems))]
        losses = engine.step()
        if snapshots is not None and engine.done % snapshots == 0:
            _take_snapshots(engine)
        if time.monotonic() - saved > SECONDS_BETWEEN_CHECKPOINTS:
            _save(engine)
            saved = time.monotonic()
        _report(engine, losses, before)


def _result(engine: Engine, member: int) -> FitResult:
    surface = engine.with_attributes(member, engine.polygons(member) or engine.mesh(member))
    polygons = surface if isinstance(surface, PolygonMesh) else None
    mesh = surface.triangulated() if isinstance(surface, PolygonMesh) else surface
    trace, shortfalls = engine.traces[member], tuple(engine.shortfalls(member))
    control = engine.control_with_attributes(member)
    return FitResult(
        mesh,
        trace,
        str(engine.device),
        control,
        polygons,
        shortfalls=shortfalls,
        tool=engine.tool(member),
        notes=tuple(engine.notes(member)),
        registered=engine.registered(member),
        landmarks=engine.landmarks(member, mesh),
        pose_scale=engine.pose_scale(member),
    )


def _running(engine: Engine) -> Iterator[tuple[int, Problem]]:
    """Yield the problems that have not failed, with their indices."""
    return ((member, problem) for member, problem in enumerate(engine.problems) if member not in engine.failed)


def _report(engine: Engine, losses: list[float], before: list[int]) -> None:
    """Report the fits that have made a step, and all at the end."""
    try:
        for member, problem in _running(engine):
            done, steps = engine.progress(member)
            if problem.on_step is not None and (done > before[member] or engine.done == engine.steps):
                problem.on_step(Step(done, steps, losses[member], engine.stage))
    except Interrupted:
        _save(engine)
        raise


def _take_snapshots(engine: Engine) -> None:
    """Hand out the shapes alone: snapshots are for films and diagnosis, and only results carry attributes."""
    for member, problem in _running(engine):
        if problem.on_snapshot is not None:
            mesh = engine.polygons(member) or engine.mesh(member)
            problem.on_snapshot(engine.done, mesh.with_attributes(NO_ATTRIBUTES))


def _save(engine: Engine) -> None:
    for member, problem in _running(engine):
        if problem.save is not None:
            problem.save(engine.checkpoint(member))
