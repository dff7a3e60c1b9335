"""Which problems of a batch are computed together."""

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
from meshfit.fitting.settings import METHODS, Dtype, FirstOrderSettings, GaussNewtonSettings
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.settings import build, override
from meshfit.specs import suggest
from meshfit.subdivision.registry import Scheme

# For each face, vertex and sample: twice what is held on the CPU, as other allocators leave gaps.
_BYTES_PER_ROW = 600
# Enough for the calls of a step to cost little beside its numbers.
_CPU_BYTES = 200e6
_MPS_BYTES = 2e9
_SHARE_OF_DEVICE = 0.5


def batches(
    problems: Sequence[Problem], settings: FirstOrderSettings | GaussNewtonSettings, device: torch.device
) -> list[list[int]]:
    """Split problems into groups that are stepped together, of as many as the device has room for.

    Problems of a group have made as many steps before: those that go on from checkpoints may not all have.

    Returns:
        Places in `problems`, group by group.
    """
    if isinstance(settings, GaussNewtonSettings):  # which takes them one after the other, whatever their company
        return [[place] for place in range(len(problems))]
    room, groups = _room(device), list[list[int]]()
    filled, last = room, -1
    for place in sorted(range(len(problems)), key=lambda i: steps_done(problems[i])):
        size, done = _size(problems[place], settings), steps_done(problems[place])
        if filled + size > room or done != last:
            groups.append([])
            filled, last = 0, done
        groups[-1].append(place)
        filled += size
    return groups


def steps_done(problem: Problem) -> int:
    """The steps that were made of a problem before."""
    return 0 if problem.resume is None else int(problem.resume["done"])


def _size(problem: Problem, settings: FirstOrderSettings) -> int:
    meshes = problem.source.num_verts + problem.source.num_faces + problem.target.num_faces
    return _BYTES_PER_ROW * (meshes + 2 * settings.samples)


def _room(device: torch.device) -> float:
    if device.type == "cuda":
        return _SHARE_OF_DEVICE * torch.cuda.mem_get_info(device)[0]
    if device.type == "mps":
        return _MPS_BYTES
    return _CPU_BYTES


Settings = FirstOrderSettings | GaussNewtonSettings

ENGINES: dict[str, Callable[..., Engine]] = {"first-order": FirstOrder, "gauss-newton": GaussNewton}


def fit(  # noqa: PLR0913  all but two are optional, by name
    source: Mesh | PolygonMesh,
    target: Mesh,
    settings: Settings | None = None,
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

    Lengths in the settings are those of the verts as given; normalise the target first, or use `meshfit run`.

    Args:
        source: where to start; its faces are kept, refined or replaced, as the method says. Polygons are cut into the
            fans from their first corners; see `PolygonMesh.with_short_diagonals`.
        target: what to reach.
        settings: of the fit, by its method; defaults are those of PyTorch3D's tutorial.
        scheme: the subdivision scheme that carries a Gauss–Newton fit from level to level.
        seed: of the samples. The same seed, settings and machine give the same bytes on the CPU.
        device: `auto`, `cpu`, `cuda`, `cuda:N` or `mps`.
        dtype: of the computation, `float32` or `float64`; meshes are float64 on both sides of it.
        threads: to search nearest points with on the CPU, of which each problem keeps two busy; all else is done on
            one. The result does not depend on it.
        on_step: called after every step.
        resume: a checkpoint of the same fit to go on from.
        save: called with a checkpoint every few seconds, and if `on_step` raises `Interrupted`.
        on_snapshot: called with the number of steps made and the surface, as often as `snapshots` says.
        **overrides: keys of the settings in place of those given, such as `steps=500, losses={"edge": 0.5}`, or
            `method="gauss-newton", connectivity="fixed"`.

    Example:
        >>> result = fit(source, target, steps=500, seed=1)  # doctest: +SKIP

    Raises:
        ConfigError: a setting that is not allowed.
        DeviceError: the device is not there.
        MeshError: a mesh that has no area or coordinates that are not finite.
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
    settings: Settings | None = None,
    *,
    device: str = "auto",
    dtype: str = "float32",
    threads: int = 1,
    **overrides: Any,  # noqa: ANN401  any key of the settings
) -> list[FitResult | Diverged]:
    """Fit many problems of any sizes, with the same settings; as many side by side as the device has room for.

    What becomes of a problem does not depend on its company: on the CPU to the byte, elsewhere to rounding.

    Args:
        problems: what to fit to what.
        settings: of all fits.
        device: as for `fit`.
        dtype: as for `fit`.
        threads: as for `fit`.
        **overrides: as for `fit`.

    Returns:
        For each problem its result, or why it diverged.

    Example:
        >>> outcomes = fit_batch([Problem(source, target) for target in targets], steps=500)  # doctest: +SKIP

    Raises:
        ConfigError, DeviceError, MeshError: as `fit`, before anything is fitted.
    """
    settings = _settings(settings, overrides)
    if dtype not in get_args(Dtype):
        raise ConfigError(f"dtype: got '{dtype}'; {suggest(str(dtype), get_args(Dtype))}")
    if threads < 1:
        raise ConfigError(f"threads: found {threads}; at least 1 is needed")
    for number, problem in enumerate(problems):
        where = f"problem {number}: " if len(problems) > 1 else ""
        for name, mesh in (("source", problem.source), ("target", problem.target)):
            _require_surface(mesh, where + name)
    place = resolve_device(device, dtype)
    if settings.method == "gauss-newton" and place.type == "mps":
        raise DeviceError("device: 'mps' has no float64, which method: gauss-newton needs; use device: cpu")
    outcomes: dict[Problem, FitResult | Diverged] = {}
    # Gradients are needed here, whatever mode the caller is in.
    with single_thread(), torch.inference_mode(mode=False), search_threads(threads) as pool:
        groups = batches(problems, settings, place)
        for group in groups:
            together = [problems[i] for i in group]
            engine = ENGINES[settings.method](together, settings, place, getattr(torch, dtype), pool)
            if steps_done(together[0]):
                engine.restore([problem.resume for problem in together if problem.resume is not None])
            outcomes |= run(engine, save_end=group is not groups[-1], snapshots=settings.snapshots)
    return [outcomes[problem] for problem in problems]


def _settings(settings: Settings | None, overrides: Mapping[str, Any]) -> Settings:
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
