"""The meshes of a trial in the normalised frame that its numbers refer to, and the distances between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeasureError, StoreError
from meshfit.experiment.storage.frame import frame_of, written_frame
from meshfit.experiment.storage.mesh_files import check_mesh_file
from meshfit.experiment.storage.run_directory import RESULT, Result, read_json
from meshfit.experiment.storage.targets import read_target
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import point_distances
from meshfit.report.figures.cloud_surfels import drawn, measurable

SOURCE, FITTED = "source.ply", "result.ply"

_ALIKE = 0.01

_Label = TypeVar("_Label")


@dataclass(frozen=True)
class TrialMeshes:
    """The source, fitted and target mesh of a trial, all in its normalised frame.

    Attributes:
        facts: content of its `result.json`.
        frame: map from the target file's coordinates to the normalised ones.
        source: the subdivided source mesh.
        result: the fitted mesh.
        target: the target, as it is drawn: points as discs.
        measured_to: the target, as distances are measured to it.
        cloud: the points of the target; None if it is a mesh.
    """

    facts: Result
    frame: Frame
    source: Mesh
    result: Mesh
    target: Mesh
    measured_to: Mesh
    cloud: PointCloud | None = None


def read_trial_meshes(folder: Path) -> TrialMeshes:
    """Read the meshes of a complete trial from its folder.

    Raises:
        StoreError: `result.json` cannot be read, or is not the result of a trial.
        MeshError: a mesh cannot be read, or the target no longer exists.
    """
    facts = read_json(folder / RESULT)
    try:
        frame, _ = frame_of(facts), facts["settings"]["targets"][0]
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise StoreError(f"{folder / RESULT}: not the result of a trial: {error}") from None
    source, result = (read_normalised(folder / name, facts) for name in (SOURCE, FITTED))
    target = frame.normalise(read_target(folder, facts))
    cloud = target if isinstance(target, PointCloud) else None
    return TrialMeshes(facts, frame, source, result, drawn(target), measurable(target), cloud)


def read_normalised(path: Path, facts: Result) -> Mesh:
    """Read a mesh that a trial wrote, in its normalised frame whatever frame it was written in."""
    check_mesh_file(path, facts)
    mesh = load_mesh(path, attributes=False)
    return frame_of(facts).normalise(mesh) if written_frame(facts) == "target" else mesh


def distances_to(result: Mesh, target: Mesh) -> Float64[np.ndarray, " V"]:
    """(V,) distance from each vertex of a result to the target's surface, in the unit of both.

    The largest is at most the Hausdorff distance from the result to the target, which includes points within faces.

    Raises:
        MeasureError: the target has no faces, or a coordinate is not finite.
    """
    if not target.num_faces:
        raise MeasureError("the target has no faces, so there is no surface to measure distances to")
    if not (np.isfinite(result.verts).all() and np.isfinite(target.verts).all()):
        raise MeasureError("distances can be measured between finite coordinates only")
    return point_distances(target, result.verts) if result.num_verts else np.zeros(0)


def worst_vertex(distances: Float64[np.ndarray, " V"]) -> int:
    """Return the index of the vertex farthest from the target; the first one if there are several.

    Raises:
        MeasureError: there are no vertices.
    """
    if not len(distances):
        raise MeasureError("a mesh without vertices has no worst vertex")
    return int(np.argmax(distances))


def distinct_meshes(labelled: Sequence[tuple[_Label, Mesh]]) -> list[tuple[list[_Label], Mesh]]:
    """Group meshes that look alike: the first mesh of each group, with the labels of all.

    Sources often are one shape to the eye although their vertices differ, such as a sphere refined by several schemes.
    """
    groups: list[tuple[list[_Label], Mesh]] = []
    for label, mesh in labelled:
        labels = next((labels for labels, first in groups if _look_alike(first, mesh)), None)
        if labels is None:
            groups.append(([label], mesh))
        else:
            labels.append(label)
    return groups


def _look_alike(first: Mesh, second: Mesh) -> bool:
    """Whether two surfaces are nowhere farther apart than 1 % of their size."""
    apart = max(float(distances_to(first, second).max()), float(distances_to(second, first).max()))
    return apart <= _ALIKE * bounding_box_diagonal(first.verts)
