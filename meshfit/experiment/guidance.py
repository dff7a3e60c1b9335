"""Guidance of a trial: landmarks, weights, and parts that stay or are rigid, read from the files that settings name."""

from pathlib import Path

import numpy as np

from meshfit.config.experiment import ExperimentSettings
from meshfit.config.source_settings import SourceSettings, VertexValueSettings
from meshfit.errors import MeshError, error_prefix
from meshfit.experiment.source import AnyMesh, levels_of, own_control_mesh
from meshfit.fitting.registration.guidance import Guidance
from meshfit.mesh.cleaning import VertexMap
from meshfit.mesh.io.landmark_files import load_landmarks
from meshfit.mesh.io.vertex_values import read_vertex_values
from meshfit.mesh.landmarks import Landmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.places import Numbering
from meshfit.mesh.point_cloud import PointCloud
from meshfit.specs import suggest
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.registry import Scheme

_VALUES = ("weights", "fixed", "rigid")


def landmarks_path(settings: ExperimentSettings, target: str) -> str | None:
    """Return the file of the places on a target; None if it has none.

    Args:
        settings: of the experiment.
        target: short name of the target.
    """
    pattern = settings.target.landmarks
    return None if pattern is None else pattern.replace("{target}", target)


def read_landmarks(source: SourceSettings, target_file: str | None) -> Landmarks | None:
    """Read the landmarks of a source, and of a target that has a file of its own; None without landmarks.

    Raises:
        MeshfitError: a file cannot be read, or there are too few landmarks.
    """
    options = source.landmarks
    if options is None:
        return None
    landmarks = load_landmarks(options.file, target_file)
    if not landmarks.has_goals:
        raise MeshError(
            f"source.landmarks: {landmarks.origin}: has places on one side alone; set target.landmarks to a file with "
            "the same names on the target"
        )
    with error_prefix("source.landmarks.hold_out"):
        return landmarks.held_out(options.hold_out)


def guidance_of(
    source: SourceSettings,
    scheme: Scheme,
    landmarks: Landmarks | None = None,
    target: tuple[str, Mesh | PointCloud, Frame] | None = None,
) -> Guidance | None:
    """Return the guidance of a refined source; None if the settings have none.

    Args:
        source: the settings, with the present paths of files.
        scheme: that refines it.
        landmarks: as `read_landmarks` returns them.
        target: the path of its file, the target in the coordinates of its file, and its frame, for landmarks.

    Raises:
        MeshfitError: values or landmarks that do not go with the source, or with the target.
    """
    if landmarks is None and all(getattr(source, key) is None for key in _VALUES):
        return None
    control, vertex_map = own_control_mesh(source, polygons=isinstance(scheme, PolygonScheme))
    values = {}
    for key, dtype in zip(_VALUES, (np.float64, bool, np.int64), strict=True):
        options = getattr(source, key)
        if options is not None:
            with error_prefix(f"source.{key}"):
                values[key] = _values(options, control, vertex_map, source.mesh).astype(dtype)
    placed = None
    if landmarks is not None and target is not None:
        name, mesh, frame = target
        goals = landmarks.goal_positions(mesh, Numbering.of_file(name))
        surface = control if isinstance(control, Mesh) else control.triangulated()
        placed = landmarks.placed(surface, _numbering(source, surface, vertex_map), goals)
        if placed.used.any():
            placed.require_enough()
        placed = placed.in_frame(frame.centre, frame.scale)
    guidance = Guidance(placed, **values)
    with error_prefix("source"):
        guidance.require_size(control.num_verts)
    return guidance.refined(control, scheme, levels_of(source, control, scheme))


def _numbering(source: SourceSettings, mesh: Mesh, vertex_map: VertexMap | None) -> Numbering:
    if vertex_map is not None and vertex_map.num_file_verts == mesh.num_verts and not Path(source.mesh).is_file():
        return Numbering.of(mesh)  # built in
    return Numbering.of_file(source.mesh, vertex_map)


def _values(options: VertexValueSettings, control: AnyMesh, vertex_map: VertexMap | None, name: str) -> np.ndarray:
    if options.file is not None:
        if vertex_map is None:
            raise MeshError(f"file: refers to the vertices of {name}, which source.decimate replaces")
        return read_vertex_values(options.file, vertex_map)
    assert options.attribute is not None  # noqa: S101  the settings hold one of the two
    found = control.attributes.vertex.get(options.attribute)
    if found is None:
        names = list(control.attributes.vertex)
        allowed = suggest(options.attribute, names) if names else "it has none"
        raise MeshError(f"attribute: {name} has no vertex data '{options.attribute}': {allowed}")
    values = np.asarray(found)
    if values.reshape(len(values), -1).shape[1] != 1:
        raise MeshError(f"attribute: '{options.attribute}': expected one number for each vertex")
    return values.reshape(-1)
