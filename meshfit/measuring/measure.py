"""Measure a result against its target."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, MeasureError, MeshError
from meshfit.images.target import ImageTarget
from meshfit.images.targets import as_image_target
from meshfit.images.views import Views
from meshfit.measuring.cloud import CloudFacts, measure_to_cloud
from meshfit.measuring.correspondence import Unmatched, unmatched
from meshfit.measuring.distance import (
    Distance,
    Farthest,
    FarthestPoint,
    Hausdorff,
    NormalAngle,
    Position,
    surface_distances,
)
from meshfit.measuring.edges import Edges, edge_scores
from meshfit.measuring.mask_overlap import MaskOverlap, mask_overlap
from meshfit.measuring.metrics import CORRESPONDING, MEASURED, OF_IMAGES, OF_MEASUREMENTS
from meshfit.measuring.new_defects import NewDefects, new_defects
from meshfit.measuring.points import Chamfer, FScore, NormalConsistency, point_scores
from meshfit.measuring.quality import Quality, mesh_quality
from meshfit.measuring.settings import TAU_OF_FILES, MeasureSettings
from meshfit.measuring.stretch import Stretch, stretch
from meshfit.measuring.surface import as_target, as_triangles, require_surface
from meshfit.measuring.vertex_error import LandmarkError, VertexError, as_truth, landmark_error, vertex_error
from meshfit.mesh.any_mesh import MeshLike
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.landmarks import PlacedLandmarks
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import nearest_on_surface
from meshfit.optional import import_pandas
from meshfit.printable import described, value_text
from meshfit.settings import override
from meshfit.units import count_text, html_table

_SHOWN_FIRST = (
    "hausdorff.symmetric",
    "hausdorff.percent_of_diagonal",
    "distance.mean",
    "distance.rms",
    "f_score.f1",
    "normal_consistency.signed",
    "normal_angle.mean",
    "quality.self_intersecting_faces",
    "quality.flipped_faces",
    "quality.watertight",
)


_SHOWN_FIRST_OF_TEMPLATES = (
    "vertex_error.rms",
    "landmark_error.rms",
    "stretch.p99",
    "new_defects.crossing_faces",
    "unmatched.source",
)
_SHOWN_FIRST_OF_CLOUDS = ("distance.backward_rms", "distance.backward_mean", "hausdorff.backward")


@dataclass(frozen=True)
class Measurement:
    """Distances of a result from its target, and its mesh quality; lengths are in the frame of both meshes.

    Attributes:
        hausdorff: largest distances.
        distance: mean and RMS distances, and percentiles.
        chamfer: chamfer distances between point clouds.
        f_score: share of points matched within a distance.
        normal_consistency: agreement of normals.
        normal_angle: angles between normals at nearest points.
        edges: agreement of creases.
        quality: mesh quality of the result; independent of the target.
        farthest: where the largest distances are.
        cloud: facts of the target where it is a cloud of points; None for a mesh.
        vertex_error: distances of vertices from where they belong; None where that is not known.
        landmark_error: distances of landmarks from where they belong; None without landmarks.
        stretch: stretch of the faces of the source; None without one that has the faces of the result.
        new_defects: defects that the source does not have; None without one.
        unmatched: share of the source without a partner on the target; None without one.
        iou: overlap of masks with those of images; None without images.

    Example:
        >>> import meshfit
        >>> measured = meshfit.measure("octahedron", "octahedron", samples=100, points=100)
        >>> round(measured.hausdorff.symmetric, 9), measured.to_dict()["quality"]["euler_number"]
        (0.0, 2)
        >>> measured.flat()["quality.faces"]
        8
    """

    hausdorff: Hausdorff
    distance: Distance
    chamfer: Chamfer
    f_score: FScore
    normal_consistency: NormalConsistency
    normal_angle: NormalAngle
    edges: Edges
    quality: Quality
    farthest: Farthest
    cloud: CloudFacts | None = None
    vertex_error: VertexError | None = None
    landmark_error: LandmarkError | None = None
    stretch: Stretch | None = None
    new_defects: NewDefects | None = None
    unmatched: Unmatched | None = None
    iou: MaskOverlap | None = None

    def __repr__(self) -> str:
        """Return the most important numbers."""
        hausdorff, quality = self.hausdorff, self.quality
        share = f"{hausdorff.percent_of_diagonal:.3f} % of diagonal"
        closed = "watertight" if quality.watertight else "not watertight"
        crossing = count_text(quality.self_intersecting_faces, "crossing face")
        distances = f"Hausdorff distance {hausdorff.symmetric:.4g} ({share}), mean {self.distance.mean:.4g}"
        if self.cloud is not None:
            to_result = f"RMS {self.distance.backward_rms:.4g}, mean {self.distance.backward_mean:.4g}"
            distances = f"{to_result}, largest {hausdorff.backward:.4g} from {count_text(self.cloud.points, 'point')}"
        return f"Measurement({distances}, {closed}, {crossing})"

    def _repr_html_(self) -> str:
        """Return the most important metrics as a table, and one of all to open, for notebooks."""
        values = self.flat()
        rows = {
            name: (OF_MEASUREMENTS[name].title, OF_MEASUREMENTS[name].text(value)) for name, value in values.items()
        }
        names = _SHOWN_FIRST if self.cloud is None else (*_SHOWN_FIRST_OF_CLOUDS, *_SHOWN_FIRST)
        names = (*(name for name in (*OF_IMAGES, *_SHOWN_FIRST_OF_TEMPLATES) if name in values), *names)
        first = html_table(("metric", "value"), (rows[name] for name in names))
        return (
            f"{first}<details><summary>all metrics</summary>{html_table(('metric', 'value'), rows.values())}</details>"
        )

    def flat(self) -> dict[str, Any]:
        """Return every metric that was measured by its name, `group.name`, in the order of `OF_MEASUREMENTS`."""
        nested = self.to_dict()
        names = (*MEASURED, *(name for name in CORRESPONDING if name.partition(".")[0] in nested))
        names = (*names, *(name for name in OF_IMAGES if name.partition(".")[0] in nested))
        return {name: nested[name.partition(".")[0]][name.partition(".")[2]] for name in names}

    def to_pandas(self) -> Any:  # noqa: ANN401  pandas is optional
        """Return a pandas DataFrame of one row with a column for every metric; `pandas.concat` stacks several.

        Raises:
            ConfigError: pandas is not installed.
        """
        return import_pandas().DataFrame([self.flat()])

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return nested dicts of plain values for JSON; `OF_MEASUREMENTS` names each metric as `group.name`.

        Besides metrics, there are the numbers of points, tau, the reason of a missing value, the farthest points, and
        for a target of points `cloud`. Groups that were not measured are left out.
        """
        values = {group: part for group, part in asdict(self).items() if part is not None}
        for point in values["farthest"].values():
            point |= {key: list(point[key]) for key in ("position", "nearest")}
        return values


@no_type_check
def measure(  # noqa: PLR0913  the settings, by name
    result: "MeshLike",
    target: "MeshLike | PointCloud | ImageTarget",
    settings: MeasureSettings | None = None,
    *,
    source: "MeshLike | None" = None,
    truth: Any = None,  # noqa: ANN401  any form of positions
    landmarks: PlacedLandmarks | None = None,
    scaled: bool | None = None,
    images: Views | None = None,
    held_out: Views | None = None,
    surface: Literal["all", "outer"] | None = None,
    samples: int | None = None,
    points: int | None = None,
    f_score_tau: float | str | None = None,
    crease_angle: float | None = None,
    seed: int | None = None,
    **unknown: object,
) -> Measurement:
    """Measure a result against its target, both in the same frame.

    The same meshes and settings give bit-identical results.

    Example:
        >>> import meshfit
        >>> measured = meshfit.measure("icosahedron", "octahedron", samples=1000)
        >>> measured
        Measurement(Hausdorff distance 0.2661 (7.683 % of diagonal), mean 0.1501, watertight, 0 crossing faces)
        >>> measured.quality.watertight
        True

    Args:
        result: the fitted mesh, in any form that `as_mesh` takes, such as a `FitResult`. Polygons are triangulated.
        target: the mesh that it was fitted to, in any form that `as_mesh` takes. A closed one that is inside out is
            turned, as it is for a fit. Or the points that it was fitted to, as a `PointCloud` or a file of points
            alone: distances from the target are then exact, and weighted by the area that each point stands for; those
            to the target are to its nearest points, and thus too large by a share of their spacing. Without normals of
            its own, angles are up to 90°, and the signed normal consistency is missing; so are the scores of creases.
            Or an `ImageTarget`: distances are then to its truth, or else to its shape, and masks are compared too.
        settings: numbers of samples and points, tau and seed; defaults if not given.
        source: the mesh that was fitted, with the faces of the result, in any form that `as_mesh` takes: the result is
            then measured against it as well. Its pose and its size do not matter.
        truth: where the vertices of the result belong, in the frame of the target: a mesh, points or an array.
        landmarks: on the result, with their goals in the frame of the target, such as `FitResult.landmarks`.
        scaled: whether the size of the source is without meaning, so that stretch is measured after its mean is
            removed; if not given, it is beyond a ratio of 1.5.
        images: views that it was fitted to, in the frame of the target, whose masks those of the result are compared
            with.
        held_out: views that were kept from the fit; compared in the same way.
        surface: `outer` measures between what can be seen of the two meshes from outside, as `outer_surface` returns
            it, so that parts inside others do not count; `all` between all of both. Mesh quality is that of all.
        samples: number of points on each surface for Hausdorff, mean and RMS distances.
        points: number of points on each surface for chamfer distance, F-score and normal consistency, and on the
            creases of each for the edge scores.
        f_score_tau: distance within which a point counts as matched in the F-score and the edge scores; a text such as
            `1%` is of the diagonal of the target's bounding box. 0.5 % of it if neither this nor settings are given.
        crease_angle: least angle in degrees between the normals at an edge that counts as a crease.
        seed: seed of the points.
        **unknown: refused, with the names that are allowed.

    Raises:
        MeshError: not a mesh.
        MeasureError: a mesh without faces or area, a vertex that is not finite, a source with other faces than the
            result, or a truth with another number of vertices.
        ConfigError: an unknown setting, or a value that is not allowed.
    """
    given = {
        "surface": surface,
        "samples": samples,
        "points": points,
        "f_score_tau": f_score_tau,
        "crease_angle": crease_angle,
    }
    changes = {key: value for key, value in (given | {"seed": seed}).items() if value is not None} | unknown
    if settings is not None and not isinstance(settings, MeasureSettings):
        raise ConfigError(f"settings: expected MeasureSettings, got {value_text(settings)}")
    if landmarks is not None and not isinstance(landmarks, PlacedLandmarks):
        raise ConfigError(f"landmarks: expected those of a FitResult, got {described(landmarks)}")
    if scaled is not None and not isinstance(scaled, bool):
        raise ConfigError(f"scaled: expected true or false, got {value_text(scaled)}")
    goal_given: Any = target
    if (target_images := as_image_target(target)) is not None:
        images, held_out = images or target_images.views, held_out or target_images.held_out
        goal_given = target_images.reference
    _require_views(images, "images")
    _require_views(held_out, "held_out")
    settings = override(settings or MeasureSettings(f_score_tau=TAU_OF_FILES), changes)
    whole, goal = as_triangles(result, "result"), as_target(goal_given)
    require_surface(whole, "result")
    start = None if source is None else _same_faces(as_triangles(source, "source"), whole)
    places = None if truth is None else as_truth(truth, whole)
    distances = _to_cloud(whole, goal, settings) if isinstance(goal, PointCloud) else _to_mesh(whole, goal, settings)
    parts: dict[str, Any] = {"quality": mesh_quality(whole, "result")}
    if places is not None:
        parts |= {"vertex_error": vertex_error(whole, places, bounding_box_diagonal(goal.verts))}
    if landmarks is not None:
        if landmarks.corners.size and int(landmarks.corners.max()) >= whole.num_verts:
            raise MeasureError(f"landmarks: on other vertices than the {whole.num_verts:,} of the result")
        parts |= {"landmark_error": landmark_error(whole, landmarks)}
    if start is not None:
        parts |= {"stretch": stretch(start, whole, scaled=scaled), "new_defects": new_defects(start, whole)}
        parts |= {"unmatched": unmatched(start, whole, goal)}
    if images is not None:
        parts |= {"iou": mask_overlap(whole, images, held_out)}
    return Measurement(**distances, **parts)


def _require_views(views: object, role: str) -> None:
    if views is not None and not isinstance(views, Views):
        raise MeshError(f"{role}: expected Views, such as those of an ImageTarget, got {described(views)}")


def _to_cloud(whole: Mesh, target: PointCloud, settings: MeasureSettings) -> dict[str, Any]:
    seen = outer_surface(whole) if settings.surface == "outer" else whole
    parts = measure_to_cloud(seen, target, settings)
    return parts._replace(farthest=_with_faces_of(parts.farthest, (seen, whole), None))._asdict()


def _to_mesh(whole: Mesh, whole_target: Mesh, settings: MeasureSettings) -> dict[str, Any]:
    result, target = whole, whole_target
    if settings.surface == "outer":
        result, target = outer_surface(whole), outer_surface(whole_target)
    hausdorff, distance, normal_angle, farthest = surface_distances(result, target, settings.samples, settings.seed)
    points, tau = settings.points, settings.tau(bounding_box_diagonal(target.verts))
    chamfer, f_score, normal_consistency = point_scores(result, target, points, tau, settings.seed)
    return {
        "hausdorff": hausdorff,
        "distance": distance,
        "chamfer": chamfer,
        "f_score": f_score,
        "normal_consistency": normal_consistency,
        "normal_angle": normal_angle,
        "edges": edge_scores(result, target, points, settings.crease_angle, tau, settings.seed),
        "farthest": _with_faces_of(farthest, (result, whole), (target, whole_target)),
    }


def _same_faces(source: Mesh, result: Mesh) -> Mesh:
    """Return the source; refuse one whose faces are not those of the result."""
    require_surface(source, "source")
    if source.num_verts == result.num_verts and np.array_equal(source.faces, result.faces):
        return source
    counts = [
        f"{count_text(mesh.num_verts, 'vertex')} and {count_text(mesh.num_faces, 'face')}" for mesh in (source, result)
    ]
    other = f"the result {counts[1]}" if counts[0] != counts[1] else "the result as many, with other corners"
    raise MeasureError(f"the source has {counts[0]}, {other}: expected the mesh that was fitted, with the same faces")


def _with_faces_of(farthest: Farthest, results: tuple[Mesh, Mesh], targets: tuple[Mesh, Mesh] | None) -> Farthest:
    """Replace the faces of outer surfaces, which come first, by those of the meshes that they are parts of."""

    def in_whole(meshes: tuple[Mesh, Mesh] | None, face: int | None, position: Position) -> int | None:
        if meshes is None or meshes[0] is meshes[1]:
            return face
        return int(nearest_on_surface(meshes[1], np.array([position])).faces[0])

    def replaced(
        point: FarthestPoint, origin: tuple[Mesh, Mesh] | None, other: tuple[Mesh, Mesh] | None
    ) -> FarthestPoint:
        face, nearest = in_whole(origin, point.face, point.position), in_whole(other, point.nearest_face, point.nearest)
        return replace(point, face=face, nearest_face=nearest)

    return Farthest(replaced(farthest.forward, results, targets), replaced(farthest.backward, targets, results))
