"""Fit one source to one target."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import torch

from meshfit.errors import ConfigError, MeshError
from meshfit.fitting.device import resolve_device, single_thread
from meshfit.fitting.first_order import Checkpoint, FirstOrder, Problem, run
from meshfit.fitting.progress import Step
from meshfit.fitting.settings import Dtype, FitSettings
from meshfit.fitting.trace import Trace
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.mesh import Mesh
from meshfit.settings import override
from meshfit.specs import suggest

ENGINES = {"first-order": FirstOrder}


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit leaves.

    Attributes:
        mesh: the deformed source, with the source's own faces.
        trace: the objective and its terms by step.
        device: what it ran on.
    """

    mesh: Mesh
    trace: Trace
    device: str


def fit(  # noqa: PLR0913  all but two are optional, by name
    source: Mesh,
    target: Mesh,
    settings: FitSettings | None = None,
    *,
    seed: int = 0,
    device: str = "auto",
    dtype: str = "float32",
    on_step: Callable[[Step], None] | None = None,
    resume: Checkpoint | None = None,
    save: Callable[[Checkpoint], None] | None = None,
    **overrides: Any,  # noqa: ANN401  any key of FitSettings
) -> FitResult:
    """Deform a source mesh until it lies on a target.

    Lengths in the settings are those of the verts as given; normalise the target first, or use `meshfit run`.

    Args:
        source: where to start; its faces are kept.
        target: what to reach.
        settings: of the fit; defaults are those of PyTorch3D's tutorial.
        seed: of the samples. The same seed, settings and machine give the same bytes on the CPU.
        device: `auto`, `cpu`, `cuda`, `cuda:N` or `mps`.
        dtype: of the computation, `float32` or `float64`; meshes are float64 on both sides of it.
        on_step: called after every step.
        resume: a checkpoint of the same fit to go on from.
        save: called with a checkpoint every few seconds, and if `on_step` raises `Interrupted`.
        **overrides: keys of `FitSettings` in place of those in `settings`, such as `steps=500, losses={"edge": 0.5}`.

    Example:
        >>> result = fit(source, target, steps=500, seed=1)  # doctest: +SKIP

    Raises:
        ConfigError: a setting that is not allowed.
        DeviceError: the device is not there.
        MeshError: a mesh that has no area or coordinates that are not finite.
        Diverged: a step was not finite.
    """
    settings = override(settings or FitSettings(), overrides)
    if dtype not in get_args(Dtype):
        raise ConfigError(f"dtype: found '{dtype}'; {suggest(str(dtype), get_args(Dtype))}")
    for name, mesh in (("source", source), ("target", target)):
        _require_surface(mesh, name)
    place = resolve_device(device, dtype)
    problem = Problem(source, target, settings, seed, place, getattr(torch, dtype))
    # Gradients are needed here, whatever mode the caller is in.
    with single_thread(), torch.inference_mode(mode=False):
        engine = ENGINES[settings.method](problem)
        if resume is not None:
            engine.restore(resume)
        run(engine, on_step, save)
    return FitResult(engine.mesh, engine.trace, str(place))


def _require_surface(mesh: Mesh, name: str) -> None:
    finite = np.isfinite(mesh.verts).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: vertex {int(np.flatnonzero(~finite)[0])} has a coordinate that is not finite")
    if not mesh.num_faces or not face_areas(mesh).sum() > 0:
        raise MeshError(f"{name}: the mesh has no area")
