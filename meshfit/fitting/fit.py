"""Fit sources to targets: one problem, or many in batches that fit in memory."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args

import numpy as np
import torch

from meshfit.errors import ConfigError, DeviceError, MeshError
from meshfit.fitting.callbacks import Step
from meshfit.fitting.device import resolve_device, single_thread
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.loop import Engine, FitResult, run
from meshfit.fitting.nearest_neighbours import search_threads
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.fitting.settings import METHODS, Dtype, FirstOrderSettings, FitSettings, GaussNewtonSettings
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.settings import build, override
from meshfit.specs import suggest
from meshfit.subdivision.registry import Scheme

# Memory per face, vertex and sample: twice that of the CPU, as other allocators leave gaps.
_BYTES_PER_ROW = 600
# Enough for the overhead of a step's calls to be small compared with its arithmetic.
_CPU_BYTES = 200e6
_MPS_BYTES = 2e9
_SHARE_OF_DEVICE = 0.5

ENGINES: dict[str, Callable[..., Engine]] = {"first-order": FirstOrder, "gauss-newton": GaussNewton}


def fit(  # noqa: PLR0913  all but two are optional, by name
    source: Mesh | PolygonMesh,
    target: Mesh,
    settings: FitSettings | None = None,
    *,
    seed: int = 0,
    scheme: str | Scheme = "loop",
    device: str = "auto",
    dtype: str = "float32",
    threads: int = 1,
    on_step: Callable[[Step], None] | None = None,
    resume: Checkpoint | None = None,
    save: Callable[[Checkpoint], None] | None = None,
    on_snapshot: Callable[[int, Mesh | PolygonMesh], None] | None = None,
    **overrides: Any,  # noqa: ANN401  any key of the settings
) -> FitResult:
    """Deform a source mesh until it lies on a target.

    Lengths in the settings are in the unit of the vertices; normalise the target first, or use `meshfit run`.

    Args:
        source: mesh to start from; its faces are kept, refined or replaced, depending on the method. Polygons are
            triangulated; see `PolygonMesh.triangulated`.
        target: mesh to fit to.
        settings: settings of either engine; the defaults are those of PyTorch3D's tutorial.
        seed: seed of the samples. The same seed, settings and machine give the same bytes on the CPU.
        scheme: subdivision scheme that carries a Gauss–Newton fit from level to level.
        device: `auto`, `cpu`, `cuda`, `cuda:N` or `mps`.
        dtype: precision of the computation, `float32` or `float64`; meshes are float64 in any case.
        threads: number of threads of the nearest-neighbour search on the CPU, of which each problem uses two; the rest
            runs on one. The result does not depend on it.
        on_step: called after every step; may raise `Interrupted`.
        resume: checkpoint of the same fit to continue from.
        save: called with a checkpoint every few seconds, and when `on_step` raises `Interrupted`.
        on_snapshot: called with the number of steps made and the surface every `snapshots` steps.
        **overrides: keys of the settings to replace, such as `steps=500, losses={"edge": 0.5}`, or
            `method="gauss-newton", connectivity="fixed"`.

    Example:
        >>> result = fit(source, target, steps=500, seed=1)  # doctest: +SKIP

    Raises:
        ConfigError: a setting is not allowed.
        DeviceError: the device is not available.
        MeshError: a mesh has no area, or coordinates that are not finite.
        Diverged: a step was not finite.
    """
    triangles, polygons = (source, None) if isinstance(source, Mesh) else (source.triangulated(), source)
    problem = Problem(triangles, target, seed, on_step, resume, save, scheme, on_snapshot, polygons)
    (outcome,) = fit_batch([problem], settings, device=device, dtype=dtype, threads=threads, **overrides)
    if isinstance(outcome, Diverged):
        raise outcome
    return outcome


def fit_batch(
    problems: Sequence[Problem],
    settings: FitSettings | None = None,
    *,
    device: str = "auto",
    dtype: str = "float32",
    threads: int = 1,
    **overrides: Any,  # noqa: ANN401  any key of the settings
) -> list[FitResult | Diverged]:
    """Fit many problems of any sizes with the same settings, as many side by side as the device has memory for.

    On the CPU, each result is byte-identical regardless of the rest of the batch; elsewhere it agrees up to rounding.

    Args:
        problems: pairs of source and target.
        settings: settings of all fits.
        device: as in `fit`.
        dtype: as in `fit`.
        threads: as in `fit`.
        **overrides: as in `fit`.

    Returns:
        The result of each problem, or why it diverged.

    Example:
        >>> outcomes = fit_batch([Problem(source, target) for target in targets], steps=500)  # doctest: +SKIP

    Raises:
        ConfigError, DeviceError, MeshError: as `fit`, before the first step.
    """
    settings = _settings(settings, overrides)
    if dtype not in get_args(Dtype):
        raise ConfigError(f'dtype: got "{dtype}"; {suggest(str(dtype), get_args(Dtype))}')
    if threads < 1:
        raise ConfigError(f"threads: expected at least 1, got {threads}")
    for number, problem in enumerate(problems):
        prefix = f"problem {number}: " if len(problems) > 1 else ""
        _require_surface(problem.source, f"{prefix}source")
        _require_surface(problem.target, f"{prefix}target")
    torch_device = resolve_device(device, dtype)
    if settings.method == "gauss-newton" and torch_device.type == "mps":
        raise DeviceError("device: 'mps' has no float64, which method: gauss-newton needs; use device: cpu")
    outcomes: dict[Problem, FitResult | Diverged] = {}
    # Gradients are computed here, even if the caller is in inference mode.
    with single_thread(), torch.inference_mode(mode=False), search_threads(threads) as pool:
        groups = batches(problems, settings, torch_device)
        for group in groups:
            batch = [problems[i] for i in group]
            engine = ENGINES[settings.method](batch, settings, torch_device, getattr(torch, dtype), pool)
            if steps_done(batch[0]):
                engine.restore([problem.resume for problem in batch if problem.resume is not None])
            outcomes |= run(engine, save_end=group is not groups[-1], snapshots=settings.snapshots)
    return [outcomes[problem] for problem in problems]


def _settings(settings: FitSettings | None, overrides: Mapping[str, Any]) -> FitSettings:
    method = overrides.get("method", "first-order" if settings is None else settings.method)
    if method not in METHODS:
        raise ConfigError(f'method: got "{method}"; {suggest(str(method), METHODS)}')
    if settings is None or settings.method != method:
        return build(METHODS[method], overrides)
    return override(settings, overrides)


def _require_surface(mesh: Mesh, name: str) -> None:
    finite = np.isfinite(mesh.verts).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: vertex {int(np.flatnonzero(~finite)[0])} has a coordinate that is not finite")
    if not mesh.num_faces or not face_areas(mesh).sum() > 0:
        raise MeshError(f"{name}: the mesh has no area")


def batches(problems: Sequence[Problem], settings: FitSettings, device: torch.device) -> list[list[int]]:
    """Split problems into batches that are stepped together, as large as the device has memory for.

    All problems of a batch have made the same number of steps; those that continue from checkpoints may differ.

    Returns:
        Indices into `problems`, batch by batch.
    """
    if isinstance(settings, GaussNewtonSettings):  # steps its problems one after the other in any case
        return [[index] for index in range(len(problems))]
    room, groups = _room(device), list[list[int]]()
    filled, last = room, -1
    for index in sorted(range(len(problems)), key=lambda i: steps_done(problems[i])):
        size, done = _size(problems[index], settings), steps_done(problems[index])
        if filled + size > room or done != last:
            groups.append([])
            filled, last = 0, done
        groups[-1].append(index)
        filled += size
    return groups


def steps_done(problem: Problem) -> int:
    """Return the number of steps in the problem's checkpoint."""
    return 0 if problem.resume is None else int(problem.resume["done"])


def _size(problem: Problem, settings: FirstOrderSettings) -> int:
    """Return the estimated memory of a problem, in bytes."""
    meshes = problem.source.num_verts + problem.source.num_faces + problem.target.num_faces
    return _BYTES_PER_ROW * (meshes + 2 * settings.samples)


def _room(device: torch.device) -> float:
    """Return the memory for a batch, in bytes."""
    if device.type == "cuda":
        return _SHARE_OF_DEVICE * torch.cuda.mem_get_info(device)[0]
    return _MPS_BYTES if device.type == "mps" else _CPU_BYTES
