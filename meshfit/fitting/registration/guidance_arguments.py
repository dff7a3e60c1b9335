"""Arguments of `fit` that guide a registration: landmarks, weights, and parts that stay or are rigid."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError
from meshfit.fitting.registration.guidance import Guidance
from meshfit.fitting.settings import FitSettings, GaussNewtonSettings
from meshfit.images.hull_source import ANY_ORIGIN
from meshfit.mesh.any_mesh import MeshLike, as_mesh
from meshfit.mesh.io.landmark_files import load_landmarks
from meshfit.mesh.landmarks import Landmarks, PlacedLandmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.places import Numbering
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.solids import SOLIDS
from meshfit.mesh.targets import load_target_with_vertex_map
from meshfit.printable import described


@no_type_check
def guidance_of(
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
def placed_landmarks(
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
    on_source = given.placed(mesh, _numbering(source, mesh), goals)
    if any(given.used):
        on_source.require_enough()
    return on_source.in_frame(frame.centre, frame.scale)


def _numbering(thing: Any, mesh: Mesh | PointCloud) -> Numbering:  # noqa: ANN401  anything that `fit` takes
    """Return what numbers of vertices and faces refer to: a file, or the mesh itself."""
    if isinstance(thing, str | os.PathLike) and os.fspath(thing) not in SOLIDS:
        name = os.fspath(thing)
        if isinstance(mesh, PointCloud):
            return Numbering.of_file(name)
        return Numbering.of_file(name, load_target_with_vertex_map(name, polygons=True, attributes=False)[1])
    return Numbering.of(mesh if isinstance(mesh, PointCloud) else as_mesh(thing))
