"""Fit sources to targets: one problem, or many in batches that fit in memory."""

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar, Unpack, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, DeviceError, MeshError, MeshfitWarning
from meshfit.fitting.callbacks import Step
from meshfit.fitting.device import resolve_device, single_thread
from meshfit.fitting.external.engine import External
from meshfit.fitting.first_order import FirstOrder
from meshfit.fitting.gauss_newton.engine import GaussNewton
from meshfit.fitting.keywords import FitKeys, Losses, OptimizerKeys, ViewKeys
from meshfit.fitting.loop import Engine, FitResult, run
from meshfit.fitting.nearest_neighbours import search_threads
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.fitting.progress import shown_progress
from meshfit.fitting.registration.alignment import align as aligned
from meshfit.fitting.registration.engine import RegistrationEngine
from meshfit.fitting.registration.guidance import Guidance
from meshfit.fitting.settings import (
    METHODS,
    Dtype,
    ExternalSettings,
    FirstOrderSettings,
    FitSettings,
    GaussNewtonSettings,
    LossWeights,
    OptimizerSettings,
    ViewSettings,
)
from meshfit.images.hull_source import ANY_ORIGIN, AnyOrigin, control_mesh_from
from meshfit.images.target import ImageTarget
from meshfit.images.targets import as_image_target
from meshfit.images.views import Views
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.any_target import as_mesh_or_points
from meshfit.mesh.cleaning import outward
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.control_mesh import USUAL_VERTS
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas
from meshfit.mesh.io.landmark_files import load_landmarks
from meshfit.mesh.landmarks import Landmarks, PlacedLandmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mismatch import boxes_are_disjoint
from meshfit.mesh.normalisation import Frame, frame_of, placed
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.places import Numbering
from meshfit.mesh.placing_options import Normalisation
from meshfit.mesh.point_cloud import PointCloud, no_closed_surface
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import SOLIDS
from meshfit.mesh.targets import load_target_with_vertex_map
from meshfit.printable import described, option_text, value_text
from meshfit.settings import Settings, build, override
from meshfit.specs import suggest
from meshfit.subdivision.curves.scheme import CurveScheme
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.registry import Scheme, resolve, wrong_domain
from meshfit.subdivision.sphere import icosphere, refined_sphere

_AnyMesh = TypeVar("_AnyMesh", Mesh, PolygonMesh, Mesh | PolygonMesh)

# Memory per face, vertex and sample: twice that of the CPU, as other allocators leave gaps.
_BYTES_PER_ROW = 600
# Enough for the overhead of a step's calls to be small compared with its arithmetic.
_CPU_BYTES = 200e6
_MPS_BYTES = 2e9
_SHARE_OF_DEVICE = 0.5

Placement = Literal["auto", "none", "sphere", "center", "box", "pca", "icp"]
_LARGEST_RATIO = 10.0
# Radius of a source in the target's tutorial frame: around it, or inside it as the search for the rough shape needs.
_RADIUS = {"first-order": 1.0, "gauss-newton": 0.3, "external": 1.0}
_ROUNDING = 1e-12

ENGINES: dict[str, Callable[..., Engine]] = {
    "first-order": FirstOrder,
    "gauss-newton": GaussNewton,
    "external": External,
}
ENGINE_KEYS = frozenset(FitKeys.__annotations__)
"""Keywords of `fit` that are keys of the settings."""


@no_type_check
def fit(  # noqa: PLR0913  all but two are optional, by name
    source: "MeshLike",
    target: "MeshLike | PointCloud | ImageTarget | Views",
    settings: "FitSettings | None" = None,
    *,
    method: Literal["first-order", "gauss-newton"] | None = None,
    seed: int = 0,
    scheme: "str | Scheme" = "loop",
    progress: bool = False,
    normalise: Normalisation = "tutorial",
    align: Placement = "auto",
    surface: Surface = "all",
    # both engines
    trace_every: int | None = None,
    snapshots: int | None = None,
    # first-order
    steps: int | None = None,
    samples: int | None = None,
    losses: "Losses | LossWeights | None" = None,
    laplacian: Literal["uniform", "cotangent"] | None = None,
    optimizer: "OptimizerKeys | OptimizerSettings | None" = None,
    views: "ViewKeys | ViewSettings | None" = None,
    # gauss-newton
    connectivity: Literal["remeshed", "fixed"] | None = None,
    variables: Literal["verts", "control"] | None = None,
    limit: bool | None = None,
    verts: int | None = None,
    decimate_from: float | None = None,
    levels: int | None = None,
    coarse_steps: int | None = None,
    tries: int | None = None,
    level_steps: int | None = None,
    last_steps: int | None = None,
    start_fairness: float | None = None,
    fairness: float | None = None,
    last_fairness: float | None = None,
    noise: Literal["auto"] | float | None = None,
    robust: Literal["auto", "off"] | None = None,
    direction: Literal["both", "to-target", "to-source"] | None = None,
    register: Literal["off", "auto", "rigid", "near-rigid", "soft"] | None = None,
    symmetric: bool | None = None,
    offset: float | None = None,
    landmarks: "Landmarks | str | Path | None" = None,
    weights: "ArrayLike | None" = None,
    fixed: "ArrayLike | None" = None,
    rigid: "ArrayLike | None" = None,
    # the computation
    device: str = "auto",
    dtype: Literal["float32", "float64"] = "float32",
    threads: int = 1,
    on_step: "Callable[[Step], None] | None" = None,
    resume: "Checkpoint | None" = None,
    save: "Callable[[Checkpoint], None] | None" = None,
    on_snapshot: "Callable[[int, Mesh | PolygonMesh], None] | None" = None,
    allow_commands: bool = False,
    **unknown: object,
) -> FitResult:
    """Deform a source mesh until it lies on a target.

    Source and target may be in any unit and at any place: they are normalised by the target's frame, in which all
    lengths of settings, losses and the trace are given, and the result is in the target's own coordinates. The same
    settings give the same bytes as `meshfit run`.

    Args:
        source: mesh to start from, in the target's coordinates, in any form that `as_mesh` takes; or `sphere`, which is
            placed around the target, or inside it for `gauss-newton`; or `target`, the target itself with few faces,
            `closed`, the same with its holes filled, `wrap`, one closed surface around it, `open`, an
            open surface through points, `hull`, the visual hull of images, or `auto`: one of these. Its faces are kept,
            refined or replaced, as the method has it. Polygons are triangulated; see `PolygonMesh.triangulated`.
        target: mesh to fit to, in any form that `as_mesh` takes. A closed one that is inside out is turned. Or the
            points of a scan, as a `PointCloud` or a file of points alone, for `gauss-newton`. Or images: `Views`, an
            `ImageTarget`, or a folder of images with cameras.
        settings: settings of either engine, or of another tool; the defaults are those of PyTorch3D's tutorial.
        method: engine: `first-order` (the default) or `gauss-newton`.
        seed: seed of the samples. The same seed, settings and machine give the same bytes on the CPU.
        scheme: subdivision scheme that carries a Gauss–Newton fit from level to level.
        progress: show a bar with the remaining time: on a terminal, in a notebook, or as lines in a log.
        normalise: frame of all lengths: `tutorial` puts the mean of the target's vertices at 0 and its largest
            |coordinate| at 1, `sphere` the farthest vertex at distance 1; `box` puts the centre of its bounding box at
            0 and the diagonal at 1, `cube` the longest side at 1; `none` keeps its coordinates.
        align: placement of the source: `auto` leaves it where it is, unless its bounding box is off the target's or ten
            times larger or smaller: then it is moved and scaled to the target, with a warning; `none` always leaves
            it; `sphere` moves and scales it to the place of the source `sphere`; `center` aligns centroids, `box`
            stretches the source into the target's bounding box, `pca` takes the best of the pose as given and the
            turns of principal axes onto principal axes, and `icp` refines that by iterated closest points.
        surface: part of the target that is fitted: `all`, or what can be seen of it from outside, `outer`, as
            `outer_surface` returns it; then the source `auto` is one skin.
        trace_every: number of steps between two rows of the trace.
        snapshots: number of steps between two calls of `on_snapshot`.
        steps: first-order: number of steps.
        samples: first-order: number of points on each surface in each step.
        losses: first-order: weights of `chamfer`, `normal`, `edge`, `laplacian` and `consistency`, and for a target of
            images of `silhouette`, `depth` and `normals`.
        laplacian: first-order: weights of the Laplacian.
        optimizer: first-order: `name`, `lr`, `momentum` and `schedule`.
        views: first-order: `blur`, `per_step` and `silhouette`, for a target of images.
        connectivity: gauss-newton: `remeshed`, or `fixed` to keep the source's own faces, refined by the scheme.
        variables: gauss-newton: `verts` of the surface, or those of a `control` mesh.
        limit: gauss-newton: whether to fit the limit surface.
        verts: gauss-newton: largest number of vertices of a remeshed result.
        decimate_from: gauss-newton: number of vertices from which a remeshed result is decimated, relative to `verts`.
        levels: gauss-newton: number of subdivision levels.
        coarse_steps: gauss-newton: number of steps of each search for the rough shape.
        tries: gauss-newton: largest number of these searches.
        level_steps: gauss-newton: number of steps at each level.
        last_steps: gauss-newton: number of final steps.
        start_fairness: gauss-newton: weight of smoothness at the start of each level.
        fairness: gauss-newton: weight of smoothness at the end of each level.
        last_fairness: gauss-newton: weight of smoothness at the end of the last steps.
        noise: gauss-newton: standard deviation of the target's points across its surface, or `auto`.
        robust: gauss-newton: `auto` gives up outliers of clouds and of meshes with noise, `off` follows every point.
        direction: gauss-newton: pairs that pull: `both`, only those from the surface `to-target`, or only `to-source`.
        register: gauss-newton: registration of a source whose vertices have a meaning: `rigid`, `near-rigid`,
            `soft`, or `auto` to have it chosen; see `FitResult.registered`.
        symmetric: gauss-newton: whether a registered source that is mirror-symmetric stays so.
        offset: gauss-newton: distance of the result from the target along its normals, outside it if above 0.
        landmarks: for `register`, three or more places on the source and where they belong on the target, or the path
            of a file of such pairs; `load_landmarks` joins two files, `Landmarks.of` takes arrays. Some may be wrong.
        weights: for `register`, (V,) confidence in the data at each vertex of the source, 0 or more.
        fixed: for `register`, (V,) True for vertices of the source that stay where they are.
        rigid: for `register`, (V,) labels: the vertices of each label above 0 move rigidly.
        device: `auto`, `cpu`, `cuda`, `cuda:N` or `mps`.
        dtype: precision of the computation; meshes are float64 in any case.
        threads: number of threads of the nearest-neighbour search on the CPU, of which each problem uses two; the rest
            runs on one. The result does not depend on it.
        on_step: called after every step; may raise `Interrupted`.
        resume: checkpoint of the same fit to continue from.
        save: called with a checkpoint every few seconds, and when `on_step` raises `Interrupted`.
        on_snapshot: called with the number of steps made and the surface, without attributes, every `snapshots` steps.
        allow_commands: whether settings with a `command`, which may come from a file of someone else, may run it.
        **unknown: refused, with the names that are allowed.

    Example:
        >>> import meshfit
        >>> target = meshfit.subdivide("cube", "loop", 3)
        >>> result = meshfit.fit(meshfit.icosphere(2), target, steps=100, samples=500, losses={"edge": 0.1}, seed=1)
        >>> result.mesh.num_verts
        162
        >>> meshfit.measure(result, target, samples=1000).distance.mean < 0.02
        True

    Raises:
        ConfigError: a setting is not allowed.
        DeviceError: the device is not available.
        MeshError: source or target is not a mesh, has no area, or has coordinates that are not finite.
        Diverged: a step was not finite.
        ToolError: an external tool failed.

    Warns:
        MeshfitWarning: the source was moved and scaled to the target; another alignment serves about as well; or the
            fit has a shortfall, such as an end that
            is farther from the target than its source.
    """
    given = {key: value for key, value in locals().items() if key in ENGINE_KEYS and value is not None} | unknown
    settings = _settings(settings, given)
    _require_whole("seed", seed, 0)
    if not isinstance(progress, bool | np.bool_):
        raise ConfigError(f"progress: expected True or False, got {described(progress)}")
    for key, function in (("on_step", on_step), ("save", save), ("on_snapshot", on_snapshot)):
        if function is not None and not callable(function):
            raise ConfigError(f"{key}: expected a function, got {described(function)}")
    if resume is not None and not (isinstance(resume, dict) and resume.keys() >= {"done", "trace", "generator"}):
        raise ConfigError(f"resume: expected a checkpoint that `save` was called with, got {described(resume)}")
    resolve(scheme)
    images = as_image_target(target)
    goal_given: Any = target if images is None else images.shape
    target_mesh = as_mesh_or_points(goal_given)
    _require_surface(target_mesh, "target")
    frame = frame_of(target_mesh.verts, _require_one_of("normalise", normalise, get_args(Normalisation)))
    goal = outward(frame.normalise(target_mesh))
    if _require_one_of("surface", surface, get_args(Surface)) == "outer":
        if isinstance(target_mesh, PointCloud):
            raise ConfigError("surface: outer: a cloud of points has no faces, so none are hidden; remove it")
        goal = frame.normalise(outer_surface(outward(target_mesh)))
    _require_one_of("align", align, get_args(Placement))
    own = not (isinstance(source, str) and (source in ("sphere", *ANY_ORIGIN) or source in SOLIDS))
    _require_closable(target_mesh, own=own)
    image_views = None if images is None else images.views.moved(frame)
    start = _placed_source(source, frame, goal, settings, scheme, align, surface, image_views)
    known = None if landmarks is None else _landmarks(landmarks, source, goal_given, target_mesh, frame, settings)
    guidance = _guidance(known, {"weights": weights, "fixed": fixed, "rigid": rigid}, start.num_verts, settings)
    restored = _Restored(None if normalise == "none" else frame, on_snapshot)
    shown = shown_progress(settings, on_step, source_verts=start.num_verts, scheme=scheme)
    with shown if progress else nullcontext(on_step) as step_made:
        problem = Problem(
            start,
            goal,
            seed,
            step_made,
            resume,
            save,
            scheme,
            restored.snapshot,
            guidance=guidance,
            own=own,
            images=image_views,
        )
        (outcome,) = fit_batch(
            [problem], settings, device=device, dtype=dtype, threads=threads, allow_commands=allow_commands
        )
    if isinstance(outcome, Diverged):
        outcome.last_good = restored.mesh(outcome.last_good)
        raise outcome
    polygons = None if outcome.polygons is None else restored.mesh(outcome.polygons)
    control = None if outcome.control is None else restored.mesh(outcome.control)
    mesh = restored.mesh(outcome.mesh)
    for text in (*outcome.notes, *outcome.shortfalls):
        warnings.warn(text, MeshfitWarning, stacklevel=2)
    found = outcome.landmarks
    if found is not None and normalise != "none":
        found = replace(found, goals=found.goals * frame.scale + frame.centre)
    in_place = replace(outcome, mesh=mesh, control=control, polygons=polygons, landmarks=found)
    return replace(in_place, frame=frame, target=target_mesh)


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
    settings = _settings(settings, overrides)
    if isinstance(settings, ExternalSettings) and settings.command is not None and not allow_commands:
        raise ConfigError(f"fit.command: {settings.name} is run only with allow_commands=True")
    _require_one_of("dtype", dtype, get_args(Dtype))
    _require_whole("threads", threads, 1)
    if not isinstance(device, str):
        raise ConfigError(f"device: expected the name of one, such as 'cpu', got {value_text(device)}")
    problems = _checked_problems(problems)
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
            engine = _engine_for(settings)(batch, settings, torch_device, getattr(torch, dtype), pool)
            if steps_done(batch[0]):
                engine.restore([problem.resume for problem in batch if problem.resume is not None])
            outcomes |= run(engine, save_end=group is not groups[-1], snapshots=settings.snapshots)
    return [outcomes[problem] for problem in problems]


@no_type_check
def _guidance(
    landmarks: PlacedLandmarks | None, given: Mapping[str, "ArrayLike | None"], num_verts: int, settings: FitSettings
) -> Guidance | None:
    """Return what is known of the source, checked; None if nothing is."""
    arrays = {}
    for name, values in given.items():
        if values is None:
            continue
        if not (isinstance(settings, GaussNewtonSettings) and settings.prior is not None):
            raise ConfigError(f"{name}: only a fit with register='rigid' or 'near-rigid' uses them")
        try:
            array = np.asarray(values, dtype={"weights": np.float64, "fixed": bool, "rigid": np.int64}[name])
        except (TypeError, ValueError):
            raise ConfigError(f"{name}: expected a number for each vertex, got {described(values)}") from None
        arrays[name] = array
    if landmarks is None and not arrays:
        return None
    guidance = Guidance(landmarks, **arrays)
    guidance.require_size(num_verts)
    return guidance


@no_type_check
def _landmarks(
    given: "Landmarks | str | Path",
    source: MeshLike,
    target: "MeshLike | PointCloud",
    target_mesh: Mesh | PointCloud,
    frame: Frame,
    settings: FitSettings,
) -> PlacedLandmarks:
    """Return landmarks on the source, with their goals in the normalised frame."""
    if isinstance(given, str | Path):
        given = load_landmarks(given)
    if not isinstance(given, Landmarks):
        remedy = "Landmarks.of(places, goals), or the path of a file"
        raise ConfigError(f"landmarks: expected Landmarks, got {described(given)}; give {remedy}")
    if isinstance(source, str) and source in (*ANY_ORIGIN, "sphere"):
        raise ConfigError(f"landmarks: the source '{source}' has no places of its own; give a mesh")
    if any(given.used) and not (isinstance(settings, GaussNewtonSettings) and settings.prior is not None):
        raise ConfigError("landmarks: only a fit with register='rigid', 'near-rigid' or 'soft' uses them")
    goals = given.goal_positions(target_mesh, _numbering(target, target_mesh))
    mesh = as_mesh(source, "source", triangles=True)
    placed_landmarks = given.placed(mesh, _numbering(source, mesh), goals)
    if any(given.used):
        placed_landmarks.require_enough()
    return placed_landmarks.in_frame(frame.centre, frame.scale)


def _numbering(thing: Any, mesh: Mesh | PointCloud) -> Numbering:  # noqa: ANN401  anything that `fit` takes
    """Return what numbers of vertices and faces refer to: a file, or the mesh itself."""
    if isinstance(thing, str | os.PathLike) and os.fspath(thing) not in SOLIDS:
        name = os.fspath(thing)
        if isinstance(mesh, PointCloud):
            return Numbering.of_file(name)
        return Numbering.of_file(name, load_target_with_vertex_map(name, polygons=True, attributes=False)[1])
    return Numbering.of(mesh if isinstance(mesh, PointCloud) else as_mesh(thing))


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


@no_type_check
def _settings(settings: FitSettings | None, overrides: Mapping[str, Any]) -> FitSettings:
    changes = {key: _plain(value) for key, value in overrides.items() if value is not None}
    if settings is not None and not isinstance(settings, tuple(METHODS.values())):
        names = "FirstOrderSettings, GaussNewtonSettings or ExternalSettings"
        raise ConfigError(f"settings: expected {names}, got {value_text(settings)}")
    method = changes.get("method", "first-order" if settings is None else settings.method)
    if not isinstance(method, str) or method not in METHODS:
        raise ConfigError(f"method: got {option_text(method)}; {suggest(str(method), METHODS)}")
    _require_keys(changes, method)
    if settings is None or settings.method != method:
        return build(METHODS[method], changes)
    return override(settings, changes)


def _plain(value: Any) -> Any:  # noqa: ANN401  any value of a setting
    return value.model_dump() if isinstance(value, Settings) else value


def _require_keys(changes: Mapping[str, Any], method: str) -> None:
    """Refuse keys that only the other engine has, and name it."""
    allowed = METHODS[method].model_fields
    for key in changes:
        engine = next((name for name, model in METHODS.items() if key in model.model_fields), None)
        if key not in allowed and engine is not None:
            text = f"no such key: it is one of method='{engine}', and this is '{method}'"
            raise ConfigError(f"{key}: {text}; allowed: {', '.join(allowed)}")


@no_type_check
def _require_one_of(key: str, value: str, allowed: Sequence[str]) -> Any:  # noqa: ANN401  one of several literals
    if not isinstance(value, str) or value not in allowed:
        raise ConfigError(f"{key}: got {option_text(value)}; {suggest(str(value), allowed)}")
    return value


@no_type_check
def _require_whole(key: str, value: int, least: int) -> None:
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ConfigError(f"{key}: expected a whole number of at least {least}, got {value_text(value)}")


@no_type_check
def _require_closable(target: Mesh | PointCloud, *, own: bool) -> None:
    """Refuse points without a closed surface, unless a source of the caller's own may be open."""
    if isinstance(target, PointCloud) and not own and (fault := no_closed_surface(target)):
        raise MeshError(f"target: {fault}")


@no_type_check
def _placed_source(  # noqa: PLR0913, PLR0917  as the caller has them
    source: "MeshLike",
    frame: Frame,
    goal: Mesh | PointCloud,
    settings: FitSettings,
    scheme: str | Scheme,
    how: Placement,
    surface: Surface,
    images: Views | None = None,
) -> Mesh | PolygonMesh:
    """Return the source in the normalised frame, aligned with the target."""
    if isinstance(source, str) and source == "sphere":
        return _around(goal, _sphere(settings, scheme))
    if isinstance(source, str) and source in ANY_ORIGIN:
        return _from_target(goal, source, settings, scheme, surface, images)
    mesh = as_mesh(source, "source")
    _require_surface(as_mesh(mesh, "source", triangles=True), "source")
    mesh = mesh.with_verts((mesh.verts - frame.centre) / frame.scale)
    registered = isinstance(settings, GaussNewtonSettings) and settings.prior is not None
    if how == "auto" and (registered or _has_same_place(mesh, goal)):
        return mesh
    if how == "auto":
        sizes = " and ".join(
            " × ".join(f"{length:.3g}" for length in np.ptp(verts, axis=0) * frame.scale)
            for verts in (mesh.verts, goal.verts)
        )
        text = f"the source was moved and scaled to the target, which it is far from (boxes {sizes})"
        warnings.warn(f"{text}; align='none' keeps it in place", MeshfitWarning, stacklevel=3)
    if how == "auto" or how == "sphere":  # noqa: PLR1714  the others remain, for the type checker
        return _around(goal, mesh.with_verts(placed(mesh.verts, _RADIUS[settings.method])))
    triangles = as_mesh(mesh, "source", triangles=True)
    found = aligned(triangles, goal, how)
    if found.doubt:
        warnings.warn(f"align='{how}': {found.doubt}; check the result", MeshfitWarning, stacklevel=3)
    return mesh.with_verts(found.mesh.verts)


def _sphere(settings: FitSettings, scheme: str | Scheme) -> Mesh | PolygonMesh:
    """Return the source of the bundled configs: of `tutorial` for the first-order engine, else of `accurate`."""
    if settings.method == "first-order":
        return icosphere(4)
    declared = resolve(scheme)
    if isinstance(declared, CurveScheme):
        raise wrong_domain(declared, "triangles")
    return refined_sphere(declared, 3, _RADIUS[settings.method])


def _from_target(
    goal: Mesh | PointCloud,
    origin: AnyOrigin,
    settings: FitSettings,
    scheme: str | Scheme,
    surface: Surface,
    images: Views | None,
) -> Mesh | PolygonMesh:
    """Return the source of the bundled config `accurate`: a control mesh made from the target."""
    verts = USUAL_VERTS
    if isinstance(settings, GaussNewtonSettings) and settings.connectivity == "fixed":
        verts = max(12, int((settings.verts - 2) / 4**settings.levels) + 2)
    mesh = control_mesh_from(goal, images, origin, verts=verts, surface=surface).mesh
    return PolygonMesh.of(mesh) if isinstance(resolve(scheme), PolygonScheme) else mesh


def _around(goal: Mesh | PointCloud, mesh: Mesh | PolygonMesh) -> Mesh | PolygonMesh:
    """Move a mesh from the tutorial's frame of the target to the frame that the target is in."""
    frame = frame_of(goal.verts, "tutorial")
    if np.allclose(frame.centre, 0.0, atol=_ROUNDING) and abs(frame.scale - 1.0) < _ROUNDING:
        return mesh
    return frame.restore(mesh)


def _has_same_place(source: Mesh | PolygonMesh, target: Mesh | PointCloud) -> bool:
    """Return whether bounding boxes overlap, and differ in size by less than ten times."""
    ratio = bounding_box_diagonal(source.verts) / bounding_box_diagonal(target.verts)
    return 1 / _LARGEST_RATIO < ratio < _LARGEST_RATIO and not boxes_are_disjoint(source, target)


class _Restored:
    """Meshes of a fit, brought back to the target's own coordinates; unchanged without a frame."""

    def __init__(self, frame: Frame | None, on_snapshot: Callable[[int, Mesh | PolygonMesh], None] | None) -> None:
        self._frame, self._on_snapshot = frame, on_snapshot

    def mesh(self, mesh: _AnyMesh) -> _AnyMesh:
        """Return the mesh in the target's coordinates."""
        return mesh if self._frame is None else self._frame.restore(mesh)

    def snapshot(self, step: int, mesh: Mesh | PolygonMesh) -> None:
        """Hand a snapshot to the caller."""
        if self._on_snapshot is not None:
            self._on_snapshot(step, self.mesh(mesh))


def _require_surface(mesh: Mesh | PointCloud, name: str) -> None:
    finite = np.isfinite(mesh.verts).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: vertex {int(np.flatnonzero(~finite)[0])} has a coordinate that is not finite")
    if isinstance(mesh, PointCloud):
        return
    if not mesh.num_faces or not face_areas(mesh).sum() > 0:
        raise MeshError(f"{name}: the mesh has no area")


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
