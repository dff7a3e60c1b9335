"""Fit many problems, in batches that fit in memory."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Unpack, get_args

import torch

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, DeviceError
from meshfit.fitting.arguments import require_one_of, require_surface, require_whole, settings_of
from meshfit.fitting.device import resolve_device, single_thread
from meshfit.fitting.external.engine import External
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.keywords import FitKeys
from meshfit.fitting.loop import Engine, FitResult, run
from meshfit.fitting.nearest_neighbours import search_threads
from meshfit.fitting.problem import Diverged, Problem
from meshfit.fitting.registration.engine import RegistrationEngine
from meshfit.fitting.settings import Dtype, ExternalSettings, FirstOrderSettings, FitSettings, GaussNewtonSettings
from meshfit.printable import described, value_text

# Memory per face, vertex and sample: twice that of the CPU, as other allocators leave gaps.
_BYTES_PER_ROW = 600
# Enough for the overhead of a step's calls to be small compared with its arithmetic.
_CPU_BYTES = 200e6
_MPS_BYTES = 2e9
_SHARE_OF_DEVICE = 0.5

ENGINES: dict[str, Callable[..., Engine]] = {
    "first-order": FirstOrder,
    "gauss-newton": GaussNewton,
    "external": External,
}


@no_type_check
def fit_batch(
    problems: Sequence[Problem],
    settings: FitSettings | None = None,
    *,
    device: str = "auto",
    dtype: str = "float32",
    threads: int = 1,
    allow_commands: bool = False,
    **overrides: Unpack[FitKeys],
) -> list[FitResult | Diverged]:
    """Fit many problems of any sizes with the same settings, as many side by side as the device has memory for.

    Nothing is normalised or aligned: lengths in the settings are in the unit of the vertices, so that targets, and
    sources with them, must be in a normalised frame; see `frame_of`. `fit` does all of this for one problem.

    On the CPU, each result is byte-identical regardless of the rest of the batch; elsewhere it agrees up to rounding.

    Args:
        problems: pairs of source and target.
        settings: settings of all fits.
        device: as in `fit`.
        dtype: as in `fit`.
        threads: as in `fit`.
        allow_commands: as in `fit`.
        **overrides: keys of the settings to replace, such as `steps=500, losses={"edge": 0.5}`, or
            `method="gauss-newton", connectivity="fixed"`.

    Returns:
        The result of each problem, or why it diverged.

    Example:
        >>> import meshfit
        >>> problems = [meshfit.Problem("icosahedron", "octahedron", seed) for seed in range(3)]
        >>> outcomes = meshfit.fit_batch(problems, steps=5, samples=100)
        >>> [outcome.mesh.num_verts for outcome in outcomes]
        [12, 12, 12]

    Raises:
        ConfigError, DeviceError, MeshError: as `fit`, before the first step.
    """
    settings = settings_of(settings, overrides)
    if isinstance(settings, ExternalSettings) and settings.command is not None and not allow_commands:
        raise ConfigError(f"fit.command: {settings.name} is run only with allow_commands=True")
    require_one_of("dtype", dtype, get_args(Dtype))
    require_whole("threads", threads, 1)
    if not isinstance(device, str):
        raise ConfigError(f"device: expected the name of one, such as 'cpu', got {value_text(device)}")
    problems = _checked_problems(problems)
    for number, problem in enumerate(problems):
        prefix = f"problem {number}: " if len(problems) > 1 else ""
        require_surface(problem.source, f"{prefix}source")
        require_surface(problem.target, f"{prefix}target")
    torch_device = resolve_device(device, dtype)
    if settings.method == "gauss-newton" and torch_device.type == "mps":
        raise DeviceError("device: 'mps' has no float64, which method: gauss-newton needs; use device: cpu")
    outcomes: dict[Problem, FitResult | Diverged] = {}
    # Gradients are computed here, even if the caller is in inference mode.
    with single_thread(), torch.inference_mode(mode=False), search_threads(threads) as pool:
        groups = batches(problems, settings, torch_device)
        for group in groups:
            batch = [problems[i] for i in group]
            engine = _engine_for(settings)(batch, settings, torch_device, getattr(torch, dtype), pool)
            if steps_done(batch[0]):
                engine.restore([problem.resume for problem in batch if problem.resume is not None])
            outcomes |= run(engine, save_end=group is not groups[-1], snapshots=settings.snapshots)
    return [outcomes[problem] for problem in problems]


def _engine_for(settings: FitSettings) -> Callable[..., Engine]:
    if isinstance(settings, GaussNewtonSettings) and settings.prior is not None:
        return RegistrationEngine
    return ENGINES[settings.method]


@no_type_check
def _checked_problems(problems: Sequence[Problem]) -> list[Problem]:
    remedy = "give a list, such as [Problem(source, target, seed)]"
    if not isinstance(problems, Iterable) or isinstance(problems, str | bytes | Mapping):
        raise ConfigError(f"problems: expected a list of Problem, got {described(problems)}; {remedy}")
    try:
        listed = list(problems)
    except Exception as error:
        raise ConfigError(f"problems: expected a list of Problem, got {described(problems)}; {remedy}") from error
    for number, problem in enumerate(listed):
        if not isinstance(problem, Problem):
            raise ConfigError(f"problem {number}: expected a Problem, got {described(problem)}; {remedy}")
    return listed


def batches(problems: Sequence[Problem], settings: FitSettings, device: torch.device) -> list[list[int]]:
    """Split problems into batches that are stepped together, as large as the device has memory for.

    All problems of a batch have made the same number of steps; those that continue from checkpoints may differ.

    Returns:
        Indices into `problems`, batch by batch.
    """
    if isinstance(
        settings, GaussNewtonSettings | ExternalSettings
    ):  # steps its problems one after the other in any case
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
