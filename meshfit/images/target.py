"""Images as the target of a fit."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64

from meshfit.images.views import View, Views
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.point_cloud import PointCloud

_Grid = Float64[np.ndarray, "H W 3"]
# A neighbouring pixel that is deeper by more widths of a pixel lies beyond an edge of the object.
_STEEP = 6.0


@dataclass(frozen=True, eq=False)
class ImageTarget:
    """Views of an object, and its mesh where that is known.

    Attributes:
        views: to fit.
        truth: the object's mesh, which measurements compare with and which no fit sees; or None.
        name: in tables.
        held_out: views that only measurements see; or None.

    Example:
        >>> import meshfit
        >>> target = meshfit.load_image_target("views:of=bone,count=3,size=64,depth=true")
        >>> target.shape
        PointCloud(1,880 points with normals, box 0.9443 × 0.191 × 0.4339)
        >>> len(target.views), target.held_out
        (3, Views(4 views))

    Raises:
        ViewError: the views are not `Views`.
    """

    views: Views
    truth: Mesh | None
    name: str
    held_out: Views | None = None

    @cached_property
    def shape(self) -> Mesh | PointCloud:
        """The points of the depth maps, with normals; without depth in every view, the visual hull of the masks."""
        if self.views.have_depth:
            return depth_cloud(self.views)
        from meshfit.images.visual_hull import visual_hull  # brings libigl

        return visual_hull(self.views)

    @property
    def reference(self) -> Mesh | PointCloud:
        """The mesh or points that measurements compare with: the truth if it is known, else the shape."""
        return self.shape if self.truth is None else self.truth

    @property
    def compared_with(self) -> Literal["truth", "depth", "hull"]:
        """The kind of the reference."""
        if self.truth is not None:
            return "truth"
        return "depth" if self.views.have_depth else "hull"

    @property
    def record(self) -> dict[str, int | str]:
        """Numbers of views, and what distances are to, for the records of a trial."""
        held_out = 0 if self.held_out is None else len(self.held_out)
        return {"views": len(self.views), "held_out": held_out, "compared_with": self.compared_with}

    def moved(self, frame: Frame) -> "ImageTarget":
        """Return the images and the truth in normalised coordinates."""
        truth = None if self.truth is None else frame.normalise(self.truth)
        held_out = None if self.held_out is None else self.held_out.moved(frame)
        return ImageTarget(self.views.moved(frame), truth, self.name, held_out)

    def __repr__(self) -> str:
        """Return the name and the views."""
        return f"ImageTarget('{self.name}', {self.views!r})"


@dataclass(frozen=True, eq=False)
class LoadedImages:
    """A target of images that was loaded.

    Attributes:
        target: the images.
        sha256: over all that it is made from.
        label: its short name, for folders.
    """

    target: ImageTarget
    sha256: str
    label: str


def depth_cloud(views: Views) -> PointCloud:
    """Return the points of all depth maps, with the normals of the images or else those of neighbouring pixels.

    The sensor is known where a single pinhole camera has seen all points.

    Args:
        views: each with depth.

    Raises:
        MeshError: fewer than four pixels have a depth.
    """
    parts = [_view_cloud(view) for view in views]
    cameras = {view.camera for view in views}
    camera = next(iter(cameras))
    sensor = camera.position.tolist() if len(cameras) == 1 and camera.kind == "pinhole" else None
    return PointCloud(np.concatenate([points for points, _ in parts]), np.concatenate([n for _, n in parts]), sensor)


def _view_cloud(view: View) -> tuple[Float64[np.ndarray, "N 3"], Float64[np.ndarray, "N 3"]]:
    """Return (N, 3) points and (N, 3) normals of the pixels with a depth; a normal that is not known is 0."""
    camera = view.camera
    assert view.depth is not None  # noqa: S101  the caller has looked
    seen = view.mask & np.isfinite(view.depth)
    grid = np.full((camera.height, camera.width, 3), np.nan)
    grid[seen] = camera.unproject(camera.pixel_centres()[seen.ravel()], view.depth[seen])
    normals = np.zeros_like(grid) if view.normals is None else np.nan_to_num(view.normals)
    unknown = seen & ~normals.any(axis=2)
    if unknown.any():
        normals = np.where(unknown[:, :, None], _grid_normals(grid, view), normals)
    return grid[seen], normals[seen]


def _grid_normals(grid: _Grid, view: View) -> _Grid:
    """Return unit normals towards the camera, from differences of neighbouring points; 0 at edges of the object."""
    camera = view.camera
    assert view.depth is not None  # noqa: S101
    width = (
        np.abs(view.depth) / min(camera.focal)
        if camera.kind == "pinhole"
        else np.full(grid.shape[:2], 1 / min(camera.focal))
    )
    down, across = (_central(grid, view.depth, _STEEP * width, axis) for axis in (0, 1))
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    usable: Bool[np.ndarray, "H W 1"] = np.isfinite(length) & (length > 0)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=usable)
    towards = camera.position - grid if camera.kind == "pinhole" else np.broadcast_to(-camera.forward, grid.shape)
    away = np.einsum("hwk,hwk->hw", normals, np.nan_to_num(towards)) < 0
    return np.asarray(np.where(away[:, :, None], -normals, normals))


def _central(grid: _Grid, depth: Float64[np.ndarray, "H W"], most: Float64[np.ndarray, "H W"], axis: int) -> _Grid:
    """Return the mean of the differences to the neighbours on both sides, as far as they are on the same surface."""
    step = np.diff(grid, axis=axis)
    steep = np.abs(np.diff(depth, axis=axis)) > np.delete(most, -1, axis=axis)
    step[steep] = np.nan
    empty = np.full_like(np.take(grid, [0], axis=axis), np.nan)
    both = np.stack([np.concatenate([empty, step], axis=axis), np.concatenate([step, empty], axis=axis)])
    known = np.isfinite(both).all(axis=3, keepdims=True)
    count = known.sum(axis=0)
    total = np.where(known, both, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0))
