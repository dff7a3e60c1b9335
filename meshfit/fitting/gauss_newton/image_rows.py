"""Rows of a Gauss–Newton step from images: contours matched both ways, parts outside the masks, and normals.

Contours follow Cashman and Fitzgibbon (2013, What shape are dolphins?): points of the surface whose normals, linear
between vertices as on a smooth surface, are perpendicular to their lines of sight should project onto the contour of
the mask. All rows are linear in positions, and have the form of correspondences.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from scipy.ndimage import maximum_filter
from torch import Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.outline import (
    ContourImage,
    ImagedSurface,
    Indices,
    Outline,
    Pixels,
    SurfacePoints,
    Values,
    Vectors,
    oriented,
)
from meshfit.fitting.gauss_newton.surface import Shape
from meshfit.images.camera import Camera
from meshfit.images.rasteriser import Raster, rasterise
from meshfit.images.views import View, Views
from meshfit.mesh.geometry import face_areas, unit_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query

# Views that a step looks at, in turn.
_VIEWS = 32
# A surface has lost a part if a pixel of a mask is so many times as far from its own mask as from the source's, and
# farther than so many pixels of a raster.
_LOST, _LOST_PIXELS = 2.0, 3.0
# Hulls of fewer views have parts that no mask excludes. The search loses these rightly, and the parts around them.
_ENOUGH_VIEWS = 6
# Least cosine between the normals of matched points of contours.
_FACING = 0.5
# Vertices farther outside a mask than so many pixels are pulled in.
_OUTSIDE = 1.0
# Residuals beyond so many times their median, and so many pixels, pull with a force that grows no more (Huber).
_HUBER, _LEAST_HUBER = 9.0, 2.0
# Least cosines between a face and its line of sight, and its normal in the image.
_GRAZING, _AGREEING = 0.1, 0.2
# Weight of the normals' rows: of the mean squared sine of their error, in squared diagonals.
_NORMALS = 0.04
# Weight of normals from which on they are certain: what faces a camera counts 1.
_CERTAIN = 0.5
# Least weight of the pixels with a normal among the four around a place.
_KNOWN = 0.3
# Weight of all contours, and pixels of a raster from the surface's own contour within which its points are matched to
# them: without and with normals. Points that are rightly inside the contour would pull the surface outwards.
_CONTOURS, _ON_CONTOUR = (1.0, 3.0), (0.4, 0.2)
# Weight of staying in place, relative to the weight of all vertices: without and with normals. Sides of faces that
# normals contradict would shrink to fit better, and the surface drifts along itself.
_DAMPING = (0.1, 4.0)
# Least fairness by contours alone: at 10,000 vertices and one view; it falls with the number of views. The greatest.
_FAIRNESS, _MOST_FAIRNESS = 12.0, 32.0


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows w (n · (Σ c d - r))² over the corners of a face, for a step d: see `Correspondences`."""

    face: Indices
    corners: Vectors
    normals: Vectors
    residuals: Vectors
    weights: Values

    @classmethod
    def none(cls) -> "_Rows":
        """Return no rows."""
        nothing = np.zeros((0, 3))
        return cls(np.zeros(0, dtype=np.int64), nothing, nothing, nothing, np.zeros(0))

    @classmethod
    def along(cls, points: SurfacePoints, gradient: Vectors, error: Values, weights: Values) -> "_Rows":
        """Return the rows that change a value of points, of some gradient, by the negative of its error."""
        length = np.linalg.norm(gradient, axis=1)
        normals = gradient / length[:, None]
        return cls(points.face, points.corners, normals, normals * (error / length)[:, None], weights)


@dataclass(frozen=True, eq=False)
class ImageRows:
    """The views of a target, as rows of Gauss–Newton steps.

    Attributes:
        images: those with a contour.
        have_normals: whether a view has normals.
        shows_depth: whether the rest of the target comes from depth, not from the masks.
    """

    images: tuple[ContourImage, ...]
    have_normals: bool
    shows_depth: bool

    @classmethod
    def of(cls, views: Views) -> "ImageRows":
        """Return the rows of views."""
        images = tuple(image for image in map(ContourImage.of, views) if image is not None)
        return cls(images, any(view.normals is not None for view in views), views.have_depth)

    def least_fairness(self, num_verts: int) -> float:
        """Return the fairness below which a surface that only contours hold would be rough between them.

        Contours of more views are closer to each other. The factor was found with 4, 8 and 32 views of three meshes.
        """
        if self.have_normals or self.shows_depth:
            return 0.0
        return min(_FAIRNESS / max(len(self.images), 1) * (num_verts / 10_000) ** 2, _MOST_FAIRNESS)

    def loses_parts(self, surface: Mesh, source: Mesh) -> bool:
        """Return whether a surface leaves a part of a mask uncovered that its source covers; False for few views."""
        if len(self.images) < _ENOUGH_VIEWS:
            return False
        after, before = (max(image.uncovered(mesh) for image in self.images) for mesh in (surface, source))
        return after > max(_LOST * before, _LOST_PIXELS)

    def adapted(self, pairs: Correspondences, shape: Shape, number: int) -> Correspondences:
        """Return the rows of the images; behind those of the target's points, where these come from depth.

        Args:
            pairs: correspondences with the target's points.
            shape: the surface.
            number: of the step, which tells whose turn it is where there are many views.
        """
        surface, count = ImagedSurface.of(shape), min(len(self.images), _VIEWS)
        turn = [self.images[(number * count + k) % len(self.images)] for k in range(count)]
        held = int(self.have_normals and not self.shows_depth)
        rows, matched, seen = [_damping(surface, _DAMPING[held])], list[float](), np.zeros_like(surface.middles)
        contours = list[_Rows]()
        for image in turn:
            raster = rasterise(surface.mesh, image.camera)
            outline = Outline.of(surface, image, raster, _ON_CONTOUR[held])
            each = count / _CONTOURS[held]
            contours += [_to_contour(outline, image, each), _from_contour(outline, image, each)]
            matched.append(contours[-1].weights.astype(bool).mean() if len(contours[-1].weights) else 0.0)
            rows.append(_from_outside(surface, image, count))
            if image.view.normals is not None:
                seen += _seen_normals(surface, image, raster)
        rows += contours
        if self.have_normals:
            rows.append(_normal_rows(surface, seen))
        if self.shows_depth:
            return _joined(rows, shape, pairs)
        share = float(np.mean(matched)) if matched else 0.0
        none = replace(
            pairs,
            **{key: getattr(pairs, key)[:0] for key in ("face", "corners", "normals", "residuals", "weights")},
            matched=share,
            reached=share,
            membranes=torch.zeros_like(pairs.membranes),
            measured=_distance(_concatenated(contours)),
        )
        return _joined(rows, shape, none)


def _to_contour(outline: Outline, image: ContourImage, count: float) -> _Rows:
    """Return the rows that bring the outline of the surface to the nearest points of the contour that face its way."""
    points, contour = outline.points, image.silhouette
    if not len(points.face):
        return _Rows.none()
    goal = image.contour(oriented(points.pixels, outline.directions))
    directions = contour.normals[goal]
    faces = np.einsum("nk,nk->n", directions, outline.directions) > _FACING
    error = np.einsum("nk,nk->n", contour.points[goal] - points.pixels, directions)
    weights = faces * _huber(error) / (len(faces) * count)
    return _Rows.along(points, _gradient(points.positions, directions, image.view.camera), error, weights)


def _from_contour(outline: Outline, image: ContourImage, count: float) -> _Rows:
    """Return the rows that bring the nearest points of the outline that face its way to the contour."""
    contour = image.silhouette
    if not len(outline.points.face):
        return _Rows.none()
    nearest = nearest_point_query(oriented(outline.points.pixels, outline.directions))
    found = nearest(oriented(contour.points, contour.normals))
    points = outline.points[found]
    faces = np.einsum("nk,nk->n", contour.normals, outline.directions[found]) > _FACING
    error = np.einsum("nk,nk->n", contour.points - points.pixels, contour.normals)
    weights = faces * _huber(error) * contour.lengths / (contour.lengths.sum() * count)
    return _Rows.along(points, _gradient(points.positions, contour.normals, image.view.camera), error, weights)


def _from_outside(surface: ImagedSurface, image: ContourImage, count: int) -> _Rows:
    """Return the rows that bring vertices outside the mask to the nearest point of its contour."""
    camera, contour = image.view.camera, image.silhouette
    pixels, _ = camera.project(surface.mesh.verts)
    outside = np.flatnonzero(contour.distance_at(pixels) < -_OUTSIDE)
    if not len(outside):
        return _Rows.none()
    points = surface.verts(outside, camera)
    offset = contour.points[image.nearest(points.pixels)] - points.pixels
    error = np.linalg.norm(offset, axis=1)
    gradient = _gradient(points.positions, offset / error[:, None], camera)
    return _Rows.along(points, gradient, error, _huber(error) * surface.shares[outside] / count)


def _seen_normals(surface: ImagedSurface, image: ContourImage, raster: Raster) -> Vectors:
    """Return (F, 3) the normals that an image shows at the middles of faces, as long as they count, 0 if not seen."""
    camera, found = image.view.camera, np.zeros_like(surface.middles)
    cosine = np.einsum("nk,nk->n", surface.face_normals, image.towards(surface.middles))
    face = np.flatnonzero(cosine > _GRAZING)
    pixels, depth = camera.project(surface.middles[face])
    deepest = maximum_filter(np.where(raster.face < 0, -np.inf, raster.depth), size=3)
    pixel = 1 / (image.scale * min(camera.focal)) * (depth if camera.kind == "pinhole" else 1.0)
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    shown = inside & (depth <= deepest[image.cell(pixels)] + pixel)
    face, pixels = face[shown], pixels[shown]
    normals = _interpolated(image.view, pixels)
    agrees = np.einsum("nk,nk->n", normals, surface.face_normals[face])
    found[face] = normals * (cosine[face] * np.where(agrees > _AGREEING, agrees, 0.0) ** 2)[:, None]
    return found


def _interpolated(view: View, pixels: Pixels) -> Vectors:
    """Return the unit normals of an image, linear between pixel centres; 0 where most of these have none."""
    normals, mask = view.normals, view.mask
    assert normals is not None  # noqa: S101  the caller has looked
    corner = np.floor(pixels - 0.5).astype(np.int64)
    within = pixels - 0.5 - corner
    total, known = np.zeros((len(pixels), 3)), np.zeros(len(pixels))
    for right in (0, 1):
        for below in (0, 1):
            column = np.clip(corner[:, 0] + right, 0, mask.shape[1] - 1)
            row = np.clip(corner[:, 1] + below, 0, mask.shape[0] - 1)
            value = normals[row, column]
            weight = np.abs(1 - right - within[:, 0]) * np.abs(1 - below - within[:, 1])
            weight = np.where(np.isfinite(value).all(axis=1), weight, 0.0)
            total += np.nan_to_num(value) * weight[:, None]
            known += weight
    total[known < _KNOWN] = 0.0
    return unit_vectors(total)


def _normal_rows(surface: ImagedSurface, seen: Vectors) -> _Rows:
    """Return the rows that make the sides of faces perpendicular to the mean of the normals that images show there."""
    length, faces, verts = np.linalg.norm(seen, axis=1), surface.mesh.faces, surface.mesh.verts
    face = np.flatnonzero(length > 0)
    normals = seen[face] / length[face, None]
    areas = face_areas(surface.mesh)
    weight = _NORMALS * surface.size**2 * (areas / areas.sum())[face] * np.minimum(length[face] / _CERTAIN, 1.0) / 3
    parts = []
    for k in range(3):
        side = verts[faces[face, (k + 1) % 3]] - verts[faces[face, k]]
        corners = np.zeros((len(face), 3))
        corners[:, k], corners[:, (k + 1) % 3] = -1.0, 1.0
        error = -np.einsum("nk,nk->n", normals, side)
        square = np.einsum("nk,nk->n", side, side)
        weights = np.divide(weight, square, out=np.zeros_like(weight), where=square > 0)
        parts.append(_Rows(face, corners, normals, normals * error[:, None], weights))
    return _concatenated(parts)


def _damping(surface: ImagedSurface, weight: float) -> _Rows:
    """Return the rows that keep vertices in place, as far as the weight of residuals along the target says.

    Their normals are 0, so that only that weight counts.
    """
    face, corner = surface.face_of_vert
    nothing = np.zeros((len(face), 3))
    return _Rows(face, np.eye(3)[corner], nothing, nothing, weight * surface.shares)


def _huber(error: Values) -> Values:
    """Return the weights of residuals in pixels, which fall for the largest (Huber's function)."""
    most = max(_HUBER * float(np.median(np.abs(error))), _LEAST_HUBER)
    return np.asarray(most / np.maximum(np.abs(error), most))


def _gradient(points: Vectors, directions: Pixels, camera: Camera) -> Vectors:
    """Return the gradients, in world coordinates, of the pixel coordinates of points along directions in the image."""
    local, (horizontal, vertical) = camera.to_camera(points), camera.focal
    gradient = np.zeros_like(points)
    gradient[:, 0], gradient[:, 1] = horizontal * directions[:, 0], -vertical * directions[:, 1]
    if camera.kind == "pinhole":
        depth = -local[:, 2]
        gradient[:, 2] = np.einsum("nk,nk->n", gradient[:, :2], local[:, :2]) / depth
        gradient /= depth[:, None]
    return np.asarray(gradient @ camera.pose[:3, :3].T)


def _distance(rows: _Rows) -> float:
    """Return the root of the weighted mean of squared residuals; 0 without rows."""
    square = float(rows.weights @ np.square(rows.residuals).sum(axis=1))
    return float(np.sqrt(square / max(rows.weights.sum(), np.finfo(np.float64).tiny)))


def _concatenated(parts: Sequence[_Rows]) -> _Rows:
    names = [field.name for field in fields(_Rows)]
    return _Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _joined(parts: Sequence[_Rows], shape: Shape, pairs: Correspondences) -> Correspondences:
    """Return the correspondences, and behind them all rows."""
    rows, verts = _concatenated(parts), shape.verts

    def tensor(values: Values | Vectors) -> Tensor:
        return torch.tensor(values, dtype=verts.dtype, device=verts.device)

    return replace(
        pairs,
        face=torch.cat([pairs.face, torch.tensor(rows.face, device=verts.device)]),
        corners=torch.cat([pairs.corners, tensor(rows.corners)]),
        normals=torch.cat([pairs.normals, tensor(rows.normals)]),
        residuals=torch.cat([pairs.residuals, tensor(rows.residuals)]),
        weights=torch.cat([pairs.weights, tensor(rows.weights)]),
        measured=pairs.distance,
    )
