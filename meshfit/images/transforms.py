"""`transforms.json`: lists of images with their cameras, in the conventions of NeRF, Blender and Nerfstudio."""

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from meshfit.errors import MeshError, ViewError, error_prefix
from meshfit.images.camera import Camera, Pose
from meshfit.images.listing import ListedImage, require_number_of_images, require_undistorted
from meshfit.images.specs import CameraKind
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.specs import suggest

_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
_PINHOLE, _ORTHOGRAPHIC = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV"), "ORTHOGRAPHIC"


def parse_transforms(content: bytes) -> list[ListedImage]:
    """Return the images that a `transforms.json` lists.

    Keys of a frame stand for it alone, those beside `frames` for all: `camera_angle_x` in radians, or `fl_x`, `fl_y`,
    `cx`, `cy`, `w` and `h` in pixels; for an orthographic camera `camera_model: ORTHOGRAPHIC` with `fl_x` in pixels per
    unit, or Blender's `ortho_scale`.

    Raises:
        ViewError: not such a file, or a camera with distortion, a key that is missing, or a pose that is not rigid.
    """
    try:
        whole = JsonObject.parse(content)
        frames = whole.objects("frames")
    except MeshError as error:
        raise ViewError(str(error)) from None
    if "frames" not in whole:
        raise ViewError("has no key 'frames'; expected the transforms.json of NeRF, Blender or Nerfstudio")
    require_number_of_images(len(frames))
    shared = whole.plain()
    shared.pop("frames")
    listed = []
    for frame in frames:
        with error_prefix(frame.place):
            try:
                listed.append(_listed(JsonObject(frame.plain()), JsonObject(shared | frame.plain())))
            except ViewError:
                raise
            except MeshError as error:
                raise ViewError(str(error)) from None
    return listed


def transforms_text(listed: Sequence[ListedImage], cameras: Sequence[Camera]) -> str:
    """Return the text of a `transforms.json`; intrinsics that all cameras share are written once.

    Args:
        listed: the images.
        cameras: their cameras, in the same order.
    """
    intrinsics = [_intrinsics(camera) for camera in cameras]
    shared = intrinsics[0] if all(each == intrinsics[0] for each in intrinsics) else {}
    scales = {image.depth_scale for image in listed if image.depth_scale is not None}
    whole: dict[str, Any] = dict(shared)
    if scales:
        (whole["depth_unit_scale_factor"],) = scales
    frames = []
    for image, camera, own in zip(listed, cameras, intrinsics, strict=True):
        files = {"mask_path": image.mask, "depth_file_path": image.depth, "normal_file_path": image.normals}
        frame: dict[str, Any] = {"file_path": image.file} | {key: name for key, name in files.items() if name}
        frames.append(frame | ({} if shared else own) | {"transform_matrix": camera.pose.tolist()})
    lines = ",\n".join(f"    {json.dumps(frame)}" for frame in frames)
    head = json.dumps(whole, indent=2)[:-2]
    return f'{head},\n  "frames": [\n{lines}\n  ]\n}}\n'


def _intrinsics(camera: Camera) -> dict[str, Any]:
    lengths = {"fl_x": camera.focal[0], "fl_y": camera.focal[1], "cx": camera.centre[0], "cy": camera.centre[1]}
    size = {"w": camera.width, "h": camera.height}
    if camera.kind == "orthographic":
        return {"camera_model": _ORTHOGRAPHIC, **lengths, **size}
    angle = 2 * math.atan(camera.width / (2 * camera.focal[0]))
    return {"camera_model": "PINHOLE", "camera_angle_x": angle, **lengths, **size}


def _listed(frame: JsonObject, values: JsonObject) -> ListedImage:
    """Return one image; `frame` holds the keys of its own, `values` the shared ones too."""
    file = frame.text("file_path")
    matrix = frame.plain().get("transform_matrix")
    if matrix is None:
        raise ViewError("has no key 'transform_matrix', the pose of its camera")
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ViewError("transform_matrix: expected 4 rows of 4 numbers") from None
    model = values.text("camera_model", "PINHOLE").upper()
    if model not in (*_PINHOLE, _ORTHOGRAPHIC):
        if "FISHEYE" in model:
            require_undistorted({"of the model": 1.0}, model)
        raise ViewError(f"camera_model: {suggest(model, (*_PINHOLE, _ORTHOGRAPHIC))}, got {model}")
    if values.plain().get("is_fisheye") is True:
        require_undistorted({"is_fisheye": 1.0}, "a camera")
    coefficients = {key: _number(values, key) for key in _DISTORTION if key in values}
    require_undistorted({key: value for key, value in coefficients.items() if value is not None}, "a camera")
    size = (values.integer("w", least=1), values.integer("h", least=1)) if "w" in values and "h" in values else None
    camera = partial(_camera, values, "orthographic" if model == _ORTHOGRAPHIC else "pinhole", pose)
    camera(*(size or (2, 2)))  # refuses a bad one with its place
    axes = values.text("normal_axes", "world")
    if axes not in ("world", "camera"):
        raise ViewError(f"normal_axes: {suggest(axes, ('world', 'camera'))}, got '{axes}'")
    scale = _number(values, "depth_unit_scale_factor")
    if scale is not None and scale <= 0:
        raise ViewError(f"depth_unit_scale_factor: expected a number above 0, got {scale:g}")
    name = PurePosixPath(file.replace("\\", "/").removeprefix("./"))
    return ListedImage(
        name=str(name.with_suffix("") if name.suffix else name),
        file=file,
        camera=camera,
        size=size,
        mask=_text(frame, "mask_path"),
        depth=_text(frame, "depth_file_path"),
        normals=_text(frame, "normal_file_path"),
        depth_scale=scale,
        normals_in_camera=axes == "camera",
    )


def _camera(values: JsonObject, kind: CameraKind, pose: Pose, width: int, height: int) -> Camera:
    angle, focal = _number(values, "camera_angle_x"), _number(values, "fl_x")
    if kind == "orthographic" and focal is None:
        scale = _number(values, "ortho_scale")
        if scale is None or scale <= 0:
            raise ViewError("an orthographic camera needs fl_x, in pixels per unit, or ortho_scale, its width in units")
        focal = max(width, height) / scale
    if focal is None:
        if angle is None:
            raise ViewError("has neither 'camera_angle_x' nor 'fl_x', the focal length; give one of them")
        if not 0 < angle < math.pi:
            raise ViewError(f"camera_angle_x: expected radians between 0 and pi, got {angle:g}")
        focal = width / (2 * math.tan(angle / 2))
    upright = _number(values, "fl_y")
    upright_angle = _number(values, "camera_angle_y")
    if upright is None and upright_angle is not None and "fl_x" not in values and 0 < upright_angle < math.pi:
        upright = height / (2 * math.tan(upright_angle / 2))
    x, y = _number(values, "cx"), _number(values, "cy")
    centre = (width / 2 if x is None else x, height / 2 if y is None else y)
    return Camera(kind, width, height, (focal, focal if upright is None else upright), centre, pose)


def _number(values: JsonObject, key: str) -> float | None:
    if key not in values:
        return None
    numbers = JsonObject({key: [values.plain()[key]]}).numbers(key)
    return None if numbers is None else numbers[0]


def _text(values: JsonObject, key: str) -> str | None:
    return values.text(key) if key in values else None
