"""Fit a source to a target: normalised and aligned, in the target's own coordinates again."""

import warnings
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, MeshfitWarning
from meshfit.fitting.arguments import (
    require_closable,
    require_one_of,
    require_surface,
    require_whole,
    settings_of,
    with_pieces,
)
from meshfit.fitting.batch import fit_batch
from meshfit.fitting.callbacks import Step
from meshfit.fitting.differences import BY_KEYWORD, warn_of_differences
from meshfit.fitting.keywords import FitKeys, Losses, OptimizerKeys, ViewKeys
from meshfit.fitting.loop import FitResult
from meshfit.fitting.placement import Placement, placed_source
from meshfit.fitting.problem import Checkpoint, Diverged, Problem
from meshfit.fitting.progress import shown_progress
from meshfit.fitting.registration.guidance_arguments import guidance_of, placed_landmarks
from meshfit.fitting.settings import FitSettings, LossWeights, OptimizerSettings, ViewSettings
from meshfit.images.hull_source import ANY_ORIGIN
from meshfit.images.target import ImageTarget
from meshfit.images.targets import as_image_target
from meshfit.images.views import Views
from meshfit.mesh.any_mesh import MeshLike
from meshfit.mesh.any_target import as_mesh_or_points
from meshfit.mesh.cleaning import outward
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.landmarks import Landmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame, frame_of
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.placing_options import Normalisation
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import SOLIDS
from meshfit.printable import described
from meshfit.subdivision.registry import Scheme, resolve

_AnyMesh = TypeVar("_AnyMesh", Mesh, PolygonMesh, Mesh | PolygonMesh)

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
    keep: Literal["all", "largest"] | float | None = None,
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
            stretches the source into the target's bounding box, `icp` takes the best pose that iterated closest points
            find, also on a part of the target, and `pca` only makes the shared parts' centroids, principal axes and
            sizes coincide.
        surface: part of the target that is fitted: `all`, or what can be seen of it from outside, `outer`, as
            `outer_surface` returns it; then the source `auto` is one skin.
        keep: pieces of the target that are fitted: `all` (or None), the `largest`, or those of at least a share of its
            size, above 0 and up to 1; parts nearer to each other than 1 % of its extent are one piece.
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
        MeshfitWarning: the source was moved and scaled to the target; another alignment serves about as well; small
            pieces are far off the others; source and target differ in topology or much in size, lie apart, or one is
            open; or the fit has a shortfall, such as an end that is farther from the target than its source.
    """
    given = {key: value for key, value in locals().items() if key in ENGINE_KEYS and value is not None} | unknown
    settings = settings_of(settings, given)
    require_whole("seed", seed, 0)
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
    require_surface(target_mesh, "target")
    numbered, target_mesh = target_mesh, with_pieces(target_mesh, keep, has_images=images is not None)
    frame = frame_of(target_mesh.verts, require_one_of("normalise", normalise, get_args(Normalisation)))
    goal = outward(frame.normalise(target_mesh))
    if require_one_of("surface", surface, get_args(Surface)) == "outer":
        if isinstance(target_mesh, PointCloud):
            raise ConfigError("surface: outer: a cloud of points has no faces, so none are hidden; remove it")
        goal = frame.normalise(outer_surface(outward(target_mesh)))
    require_one_of("align", align, get_args(Placement))
    own = not (isinstance(source, str) and (source in ("sphere", *ANY_ORIGIN) or source in SOLIDS))
    require_closable(target_mesh, own=own)
    image_views = None if images is None else images.views.moved(frame)
    start = placed_source(source, frame, goal, settings, scheme, align, surface, image_views)
    triangles = start.triangulated() if isinstance(start, PolygonMesh) else start
    fills = isinstance(source, str) and source == "closed"
    warn_of_differences(triangles, goal, settings, surface, fills=fills, remedies=BY_KEYWORD)
    known = None if landmarks is None else placed_landmarks(landmarks, source, goal_given, numbered, frame, settings)
    guidance = guidance_of(known, {"weights": weights, "fixed": fixed, "rigid": rigid}, start.num_verts, settings)
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
