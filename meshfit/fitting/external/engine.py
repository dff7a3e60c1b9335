"""The external engine: write source and target, run a tool once, and read what it wrote."""

import json
import os
import re
import signal
import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np
import torch

from meshfit.errors import ConfigError, MeshError, MeshfitWarning
from meshfit.fitting.callbacks import Step
from meshfit.fitting.external.process import Ended, Limits, environment_of, run_process
from meshfit.fitting.external.tools import INSTALL, TOOLS, ToolError, ToolRun, missing_module
from meshfit.fitting.loop import Engine
from meshfit.fitting.problem import Checkpoint, Problem
from meshfit.fitting.settings import PLACEHOLDERS, ExternalSettings, command_name
from meshfit.mesh.attributes import NO_ATTRIBUTES
from meshfit.mesh.io.files import load_polygons, save_mesh
from meshfit.mesh.io.point_clouds import encode_point_cloud
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud, oriented_cloud
from meshfit.mesh.polygons import PolygonMesh

_VERSION_SECONDS = 20.0
_LONGEST_VERSION = 100
_LONGEST_LINE = 200
_RUN = ("name", "version", "seconds", "peak_memory_mb", "output")
_KILLED_CODES = (-9, 137)  # the second as a shell passes it on


class External(Engine):
    """Fits by another tool. Each has one step, which runs the tool."""

    columns: ClassVar[tuple[str, ...]] = ("step", "loss")
    settings: ExternalSettings

    def __init__(
        self,
        problems: Sequence[Problem],
        settings: ExternalSettings,
        device: torch.device,  # noqa: ARG002  tools run on the CPU, or choose a device themselves
        dtype: torch.dtype,
        pool: Executor | None = None,
    ) -> None:
        super().__init__(problems, settings, torch.device("cpu"), dtype, pool)
        self._results: dict[int, PolygonMesh] = {}
        self._runs: dict[int, ToolRun] = {}

    def mesh(self, member: int) -> Mesh:
        """Return what the tool wrote, triangulated; before that, the source."""
        result = self._results.get(member)
        return self.problems[member].source if result is None else result.triangulated()

    def polygons(self, member: int) -> PolygonMesh | None:
        """Return what the tool wrote, if not all of its faces are triangles."""
        result = self._results.get(member)
        return result if result is not None and (result.sizes != 3).any() else None

    def with_attributes(self, member: int, surface: Mesh | PolygonMesh) -> Mesh | PolygonMesh:
        """Return the surface with the attributes of the source where its faces are the source's."""
        result, problem = self._results[member], self.problems[member]
        source = PolygonMesh.of(problem.polygons or problem.source)
        same = result.num_verts == source.num_verts and np.array_equal(result.corners, source.corners)
        same = same and np.array_equal(result.sizes, source.sizes)
        return super().with_attributes(member, surface) if same else surface

    def tool(self, member: int) -> ToolRun:
        """Return the run of the tool."""
        return self._runs[member]

    def step(self) -> list[float]:
        """Run the tool for each problem.

        Raises:
            ToolError: it failed.
        """
        for member, problem in enumerate(self.problems):
            self._results[member], self._runs[member] = run_external(problem, self.settings)
        self.done += 1
        return [float("nan")] * len(self.problems)

    def checkpoint(self, member: int) -> Checkpoint:
        """Return what the tool wrote, so that it is not run again where only the measuring was interrupted."""
        result, run = self._results[member], self._runs[member]
        arrays = {"verts": result.verts, "corners": result.corners, "sizes": result.sizes}
        tensors = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}
        facts = {name: getattr(run, name) for name in _RUN} | {"warnings": list(run.warnings)}
        return {"done": self.done, "trace": [], "mesh": tensors, "tool": facts}

    def restore(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Take over what the tool wrote before."""
        for member, checkpoint in enumerate(checkpoints):
            arrays = {name: tensor.numpy() for name, tensor in checkpoint["mesh"].items()}
            self._results[member] = PolygonMesh(arrays["verts"], arrays["corners"], arrays["sizes"])
            facts = checkpoint["tool"]
            self._runs[member] = ToolRun(**facts | {"warnings": tuple(facts["warnings"])})
        self.done = checkpoints[0]["done"]


def run_external(problem: Problem, settings: ExternalSettings) -> tuple[PolygonMesh, ToolRun]:
    """Run the tool on one problem.

    Raises:
        ConfigError: the target is a cloud of points, which the tool cannot take.
        ToolError: it cannot be started, fails, exceeds a limit, or writes nothing that can be used.
    """
    if isinstance(problem.target, PointCloud) and not settings.takes_points:
        raise ConfigError(f"target: a point cloud has no faces, which {settings.name} needs; use method: gauss-newton")
    suffix = f".{settings.format}"
    with TemporaryDirectory(prefix="meshfit-tool-") as outer:
        inputs, folder = Path(outer, "inputs"), Path(outer, "work")
        inputs.mkdir()
        folder.mkdir()
        source, target, result = inputs / f"source{suffix}", inputs / f"target{suffix}", folder / f"result{suffix}"
        start = problem.source if problem.polygons is None or suffix == ".stl" else problem.polygons
        save_mesh(start.with_attributes(NO_ATTRIBUTES), source)
        if isinstance(problem.target, PointCloud):
            target.write_bytes(encode_point_cloud(_cloud_for(settings, problem.target), suffix))
        else:
            save_mesh(problem.target.with_attributes(NO_ATTRIBUTES), target)
        paths = {"source": str(source), "target": str(target), "result": str(result), "folder": str(folder)}
        values = paths | {"seed": str(problem.seed), "threads": os.environ.get("OMP_NUM_THREADS", "1")}
        command, environment = _command(settings, values, folder), environment_of(settings.environment, folder)
        if settings.tool is not None:
            environment["PYTHONPATH"] = _python_path()
        version = _version(settings, values, Path(outer, "version"), environment)

        def on_wait() -> None:
            if problem.on_step is not None:
                problem.on_step(Step(0, 1, float("nan"), settings.name))

        limits = Limits(settings.time_limit, settings.memory_limit)
        ended = run_process(command, folder, environment, limits, on_wait)
        _require_success(settings, command[0], ended)
        mesh, texts = _read(result, settings, ended)
        seconds = _seconds_of_call(folder) if settings.tool is not None else ended.seconds
    return mesh, ToolRun(settings.name, version, seconds, ended.peak_memory_mb, ended.output, texts)


def _cloud_for(settings: ExternalSettings, cloud: PointCloud) -> PointCloud:
    """Return the points that a tool gets: with normals where it needs them, with the file's own for a command."""
    return oriented_cloud(cloud) if settings.tool == "poisson" else cloud


def _command(settings: ExternalSettings, values: dict[str, str], folder: Path) -> list[str]:
    if settings.tool is None:
        return [_filled(part, values) for part in settings.command or ()]
    module = missing_module(settings.tool)
    if module is not None:
        raise ToolError(f"{settings.tool} needs {module}, which is not installed here: {INSTALL}")
    task = folder / "options.json"
    options = settings.tool_options.model_dump(mode="json")
    task.write_text(json.dumps(values | {"tool": settings.tool, "options": options}), encoding="utf-8")
    return [sys.executable, "-m", "meshfit.fitting.external.ready", str(task)]


def _filled(part: str, values: dict[str, str]) -> str:
    return re.sub(rf"\{{({'|'.join(PLACEHOLDERS)})\}}", lambda match: values[match[1]], part)


def _python_path() -> str:
    """The folder of this package, before those of the environment, for a child that runs code of it."""
    root = str(Path(__file__).resolve().parents[3])
    return os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))


def _version(
    settings: ExternalSettings, values: dict[str, str], folder: Path, environment: dict[str, str]
) -> str | None:
    if settings.tool is not None:
        return TOOLS[settings.tool].version
    if settings.version_command is None:
        return None
    folder.mkdir()
    command = [_filled(part, values) for part in settings.version_command]
    ended = run_process(command, folder, environment, Limits(_VERSION_SECONDS, settings.memory_limit))
    if ended.error is not None:
        raise ToolError(f"{command_name(command)}: cannot be started: {ended.error}; see fit.version_command")
    return next((line.strip()[:_LONGEST_VERSION] for line in ended.output.splitlines() if line.strip()), None)


def _require_success(settings: ExternalSettings, program: str, ended: Ended) -> None:
    name = settings.name
    if ended.error is not None:
        message = f"{name}: cannot be started: {ended.error}; is {program} installed on this machine?"
        raise ToolError(message, output=ended.output)
    if ended.timed_out:
        message = f"{name} was stopped after {settings.time_limit:g} s; raise fit.time_limit"
        raise ToolError(message, "time-limit", ended.output)
    if ended.too_large:
        message = f"{name} was stopped at {settings.memory_limit:g} MB of memory; raise fit.memory_limit"
        raise ToolError(message, "memory-limit", ended.output)
    if ended.code == 0:
        return
    last = next((line.strip() for line in reversed(ended.output.splitlines()) if line.strip()), "")
    said = f": {last[:_LONGEST_LINE]}" if last else ", without a message"
    if ended.code in _KILLED_CODES:
        raise ToolError(f"{name} was killed; perhaps there was not enough memory", "killed", ended.output)
    code = ended.code or 0
    how = f"was ended by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
    raise ToolError(f"{name} {how}{said}", output=ended.output)


def _signal_name(number: int) -> str:
    try:
        return f"{signal.Signals(number).name} ({signal.strsignal(number)})"
    except ValueError:
        return f"signal {number}"


def _read(path: Path, settings: ExternalSettings, ended: Ended) -> tuple[PolygonMesh, tuple[str, ...]]:
    """Read and clean the result, as any mesh file, and return it with the warnings about it."""
    name = settings.name
    if not path.is_file() or path.is_symlink():
        found = sorted(other.name for other in path.parent.iterdir() if other.name != "options.json")[:5]
        instead = f"; it wrote {', '.join(found)}" if found else ""
        raise ToolError(f"{name} wrote no {path.name}, which {{result}} stands for{instead}", output=ended.output)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshfitWarning)
        try:
            mesh = load_polygons(path)
        except MeshError as error:
            reason = str(error).replace(str(path), path.name)
            raise ToolError(f"{name} wrote a result that cannot be used: {reason}", output=ended.output) from None
    texts = (str(warning.message) for warning in caught if issubclass(warning.category, MeshfitWarning))
    return mesh, tuple(f"{name}: {text.replace(str(path), path.name)}" for text in texts)


def _seconds_of_call(folder: Path) -> float:
    return float(json.loads((folder / "seconds.json").read_text(encoding="utf-8")))
