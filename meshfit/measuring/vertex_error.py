"""Vertex and landmark errors: distances of points of a result from where they belong."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from meshfit.doors import no_type_check
from meshfit.errors import MeasureError
from meshfit.mesh.any_mesh import as_mesh
from meshfit.mesh.io.point_clouds import load_points
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.units import count_text

Positions = Float64[np.ndarray, "N 3"]


@dataclass(frozen=True)
class VertexError:
    """Distances of vertices from where they belong, in the unit of the vertices; each vertex counts the same.

    Attributes:
        rms: root mean square.
        p50: median.
        p99: 99th percentile.
        max: largest.
        percent_of_diagonal: rms, in percent of the diagonal of the target's bounding box.
        vertices: number of vertices whose places are known.
    """

    rms: float
    p50: float
    p99: float
    max: float
    percent_of_diagonal: float
    vertices: int


@dataclass(frozen=True)
class LandmarkError:
    """Distances of landmarks from where they belong, in the unit of the vertices.

    Attributes:
        rms: root mean square, of those that a fit may use; None without any.
        max: the largest of these.
        left_out_rms: root mean square, of those that are held out; None without any.
        left_out_max: the largest of these.
        used: number of landmarks that a fit may use.
        left_out: number of those that are held out.
    """

    rms: float | None
    max: float | None
    left_out_rms: float | None
    left_out_max: float | None
    used: int
    left_out: int


@dataclass(frozen=True, eq=False)
class Truth:
    """Where vertices of a result belong.

    Attributes:
        verts: (N,) the vertices.
        positions: (N, 3) where they belong.
    """

    verts: Int64[np.ndarray, " N"]
    positions: Positions

    @classmethod
    def of_first(cls, positions: Positions) -> "Truth":
        """Return where the first vertices belong."""
        return cls(np.arange(len(positions)), positions)


@no_type_check
def as_truth(truth: Any, result: Mesh) -> Truth:  # noqa: ANN401  any form of positions
    """Return where the vertices of a result belong.

    Args:
        truth: a `Truth`, an (V, 3) array, a file of points or of a mesh, a `PointCloud`, or a mesh in any form that
            `as_mesh` takes, with as many vertices as the result.
        result: V vertices.

    Raises:
        MeasureError: another number of vertices, or a position that is not finite.
    """
    places = truth
    if not isinstance(places, Truth):
        positions = _positions(truth)
        if positions.shape != result.verts.shape:
            given = count_text(len(positions), "vertex") if positions.shape[1:] == (3,) else f"shape {positions.shape}"
            raise MeasureError(f"truth: {given}, but the result has {result.num_verts:,}: expected a place for each")
        places = Truth.of_first(positions)
    if not np.isfinite(places.positions).all():
        bad = int(np.flatnonzero(~np.isfinite(places.positions).all(axis=1))[0])
        raise MeasureError(f"truth: expected finite coordinates, got {places.positions[bad].tolist()} at vertex {bad}")
    return places


@no_type_check
def _positions(truth: Any) -> Positions:  # noqa: ANN401  any form of positions
    if isinstance(truth, str | Path):
        return load_points(truth)
    if isinstance(truth, list | tuple | np.ndarray) and np.ndim(truth) == 2:
        return np.array(truth, dtype=np.float64)
    return truth.verts if isinstance(truth, PointCloud) else as_mesh(truth, "truth").verts


def vertex_error(result: Mesh, truth: Truth, diagonal: float) -> VertexError:
    """Measure how far vertices are from where they belong.

    Args:
        result: the mesh.
        truth: at least one vertex, and where each belongs.
        diagonal: of the target's bounding box.
    """
    distances = np.linalg.norm(result.verts[truth.verts] - truth.positions, axis=1)
    rms = math.sqrt(float((distances**2).mean()))
    median, p99 = (float(value) for value in np.percentile(distances, (50, 99)))
    return VertexError(rms, median, p99, float(distances.max()), 100.0 * rms / diagonal, len(distances))


def landmark_error(result: Mesh, landmarks: PlacedLandmarks) -> LandmarkError:
    """Measure how far landmarks on a result are from where they belong."""
    distances = landmarks.errors(result.verts)
    used, left_out = distances[landmarks.used], distances[~landmarks.used]
    return LandmarkError(*_rms_and_max(used), *_rms_and_max(left_out), len(used), len(left_out))


def _rms_and_max(distances: Float64[np.ndarray, " N"]) -> tuple[float | None, float | None]:
    if not len(distances):
        return None, None
    return math.sqrt(float((distances**2).mean())), float(distances.max())
