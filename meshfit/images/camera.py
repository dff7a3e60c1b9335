"""Pinhole and orthographic cameras."""

from dataclasses import dataclass
from typing import get_args

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from meshfit.doors import no_type_check
from meshfit.errors import ViewError
from meshfit.images.specs import CameraKind
from meshfit.mesh.normalisation import Frame
from meshfit.printable import option_text
from meshfit.specs import suggest

Pose = Float64[np.ndarray, "4 4"]
Pixels = Float64[np.ndarray, "N 2"]
Points = Float64[np.ndarray, "N 3"]
Depths = Float64[np.ndarray, " N"]

MOST_PIXELS = 1 << 26
"""Pixels of the largest image: 8192 × 8192."""

# How far a rotation in a file with few digits is from an orthogonal matrix.
_RIGID = 1e-3
# How far one is that has been made orthogonal, which stays as it is.
_ORTHOGONAL = 1e-14


@dataclass(frozen=True, eq=False, init=False)
class Camera:
    """A camera without lens distortion.

    Axes are those of OpenGL, Blender and NeRF: x points right, y up, and the camera looks along −z. In pixels, x points
    right and y down, and the centre of the top left pixel is at (0.5, 0.5). Cameras of equal values are equal.

    Attributes:
        kind: of projection.
        width: of the image, in pixels.
        height: of the image.
        focal: (fx, fy) focal lengths in pixels; of an orthographic camera, pixels per unit of length.
        centre: (cx, cy) principal point, in pixels.
        pose: (4, 4) float64, read-only, from camera to world coordinates; its rotation is made exactly orthogonal.

    Example:
        >>> import numpy as np
        >>> import meshfit
        >>> pose = np.eye(4)
        >>> pose[2, 3] = 4.0
        >>> camera = meshfit.Camera("pinhole", 64, 64, (80.0, 80.0), (32.0, 32.0), pose)
        >>> pixels, depth = camera.project(np.array([[0.0, 0.1, 0.0]]))
        >>> pixels.tolist(), depth.tolist()
        ([[32.0, 30.0]], [4.0])

    Raises:
        ViewError: a value that no camera has; a pose that is not rigid.
    """

    kind: CameraKind
    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    pose: Pose

    @no_type_check
    def __init__(
        self,
        kind: CameraKind,
        width: int,
        height: int,
        focal: tuple[float, float],
        centre: tuple[float, float],
        pose: ArrayLike,
    ) -> None:
        if kind not in get_args(CameraKind):
            raise ViewError(f"camera: got the kind {option_text(kind)}; {suggest(str(kind), get_args(CameraKind))}")
        set_value = object.__setattr__
        set_value(self, "kind", kind)
        for name, size in (("width", width), ("height", height)):
            if size != int(size) or size < 1:
                raise ViewError(f"camera: expected a {name} of 1 pixel or more, got {size}")
            set_value(self, name, int(size))
        if self.width * self.height > MOST_PIXELS:
            raise ViewError(f"camera: {self.width} × {self.height} pixels are more than {MOST_PIXELS:,}; scale it down")
        for name, values in (("focal", focal), ("centre", centre)):
            pair = np.array(values, dtype=np.float64)
            if pair.shape != (2,) or not np.isfinite(pair).all() or (name == "focal" and not (pair > 0).all()):
                which = "positive focal lengths" if name == "focal" else "a principal point of finite numbers"
                raise ViewError(f"camera: expected {which}, got {pair.tolist()}")
            set_value(self, name, (float(pair[0]), float(pair[1])))
        set_value(self, "pose", _rigid(pose))

    def __eq__(self, other: object) -> bool:
        """Return whether all values are equal."""
        return isinstance(other, Camera) and self._values == other._values

    def __hash__(self) -> int:
        """Return a hash of all values."""
        return hash(self._values)

    def __repr__(self) -> str:
        """Return kind, size and position."""
        position = ", ".join(f"{value:.4g}" for value in self.position)
        return f"Camera({self.kind}, {self.width} × {self.height}, at ({position}))"

    @property
    def position(self) -> Float64[np.ndarray, "3"]:
        """The centre of projection; of an orthographic camera, where depth is 0 on the axis."""
        return np.asarray(self.pose[:3, 3])

    @property
    def forward(self) -> Float64[np.ndarray, "3"]:
        """The unit direction of view, −z of the camera."""
        return np.asarray(-self.pose[:3, 2])

    def to_camera(self, points: Points) -> Points:
        """Return points in camera coordinates: x right, y up, and z the negative of the depth."""
        return np.asarray((points - self.position) @ self.pose[:3, :3])

    def project(self, points: Points) -> tuple[Pixels, Depths]:
        """Return pixel coordinates and depth of points.

        Args:
            points: (N, 3) in world coordinates.

        Returns:
            (N, 2) pixels, not finite where a pinhole camera sees a point at depth 0, and (N,) depth: the distance
            along the axis of view, positive in front.
        """
        local = self.to_camera(points)
        depth = -local[:, 2]
        plane = local[:, :2]
        if self.kind == "pinhole":
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = plane / depth[:, None]
        return plane * self._per_unit + self.centre, depth

    def unproject(self, pixels: Pixels, depth: Depths) -> Points:
        """Return the points that are seen at pixels, at a depth.

        Args:
            pixels: (N, 2).
            depth: (N,) along the axis of view.
        """
        plane = self._on_plane(pixels)
        if self.kind == "pinhole":
            plane = plane * depth[:, None]
        return np.asarray(np.column_stack([plane, -depth]) @ self.pose[:3, :3].T + self.position)

    def rays(self, pixels: Pixels) -> tuple[Points, Points]:
        """Return (N, 3) origins and (N, 3) unit directions of the lines of sight through pixels."""
        plane = self._on_plane(pixels)
        ahead = np.broadcast_to(self.forward, (len(pixels), 3))
        rotation = self.pose[:3, :3]
        if self.kind == "orthographic":
            return plane @ rotation[:, :2].T + self.position, ahead.copy()
        directions = plane @ rotation[:, :2].T + ahead
        origins = np.broadcast_to(self.position, (len(pixels), 3)).copy()
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def pixel_centres(self) -> Float64[np.ndarray, "P 2"]:
        """Return the centres of all pixels, row by row."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.column_stack([x.ravel(), y.ravel()])

    def moved(self, frame: Frame) -> "Camera":
        """Return the camera that sees normalised coordinates where this one sees the original ones."""
        pose = self.pose.copy()
        pose[:3, 3] = (self.position - frame.centre) / frame.scale
        factor = frame.scale if self.kind == "orthographic" else 1.0
        focal = (self.focal[0] * factor, self.focal[1] * factor)
        return Camera(self.kind, self.width, self.height, focal, self.centre, pose)

    @property
    def _per_unit(self) -> Float64[np.ndarray, "2"]:
        return np.array([self.focal[0], -self.focal[1]])

    def _on_plane(self, pixels: Pixels) -> Pixels:
        return np.asarray((pixels - self.centre) / self._per_unit)

    @property
    def _values(self) -> tuple[object, ...]:
        return self.kind, self.width, self.height, self.focal, self.centre, (self.pose + 0.0).tobytes()


def _rigid(pose: ArrayLike) -> Pose:
    try:
        matrix = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ViewError("camera: the pose is not a matrix of numbers; expected 4 × 4 of them") from None
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise ViewError(f"camera: expected a pose of 4 × 4 numbers, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ViewError("camera: the pose holds numbers that are not finite")
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-9):
        raise ViewError(f"camera: the last row of the pose is {matrix[3].tolist()}; expected [0, 0, 0, 1]")
    rotation = matrix[:3, :3]
    product = rotation.T @ rotation
    if abs(product - np.eye(3)).max() > _RIGID:
        scale = float(np.cbrt(abs(np.linalg.det(rotation))))
        if scale > 0 and abs(product / scale**2 - np.eye(3)).max() <= _RIGID:
            fault = f"the pose scales by {scale:.4g}; divide its rotation by that"
        else:
            fault = "the first three rows and columns of the pose are not a rotation; expected orthogonal unit vectors"
        raise ViewError(f"camera: {fault}")
    if np.linalg.det(rotation) < 0:
        raise ViewError("camera: the pose is mirrored: its axes are left-handed; negate one of its columns")
    if abs(product - np.eye(3)).max() > _ORTHOGONAL:
        left, _, right = np.linalg.svd(rotation)
        matrix[:3, :3] = left @ right
    matrix.setflags(write=False)
    return matrix
