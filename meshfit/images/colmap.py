"""COLMAP's text files: `cameras.txt` and `images.txt`."""

from functools import partial
from pathlib import PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from meshfit.errors import ViewError, error_prefix
from meshfit.images.camera import Camera, Pose
from meshfit.images.folders import CAMERAS, IMAGES
from meshfit.images.listing import ListedImage, require_number_of_images, require_undistorted
from meshfit.specs import suggest

# By model: number of focal lengths, and names of the parameters after the principal point.
_MODELS: dict[str, tuple[int, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (1, ()),
    "PINHOLE": (2, ()),
    "SIMPLE_RADIAL": (1, ("k",)),
    "RADIAL": (1, ("k1", "k2")),
    "OPENCV": (2, ("k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (2, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
}
# COLMAP's camera looks along +z with y down.
_AXES = np.diag([1.0, -1.0, -1.0])
_Lens = tuple[int, int, tuple[float, float], tuple[float, float]]


def parse_colmap(cameras: str, images: str) -> list[ListedImage]:
    """Return the images that COLMAP's text files list.

    Args:
        cameras: text of `cameras.txt`.
        images: text of `images.txt`.

    Raises:
        ViewError: not such files, or a camera with distortion.
    """
    lenses: dict[str, _Lens] = {}
    for number, words in _rows(cameras):
        with error_prefix(f"{CAMERAS}, line {number}"):
            lenses[words[0]] = _lens(words)
    listed, after_image = [], False
    for number, words in _rows(images, blank=True):
        if after_image and _are_points(words):
            after_image = False
            continue
        if not words:
            continue
        with error_prefix(f"{IMAGES}, line {number}"):
            listed.append(_image(words, lenses))
        after_image = True
    with error_prefix(IMAGES):
        require_number_of_images(len(listed))
    return sorted(listed, key=lambda image: image.name)


def _rows(text: str, *, blank: bool = False) -> list[tuple[int, list[str]]]:
    rows = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1) if not line.startswith("#")]
    return rows if blank else [(number, words) for number, words in rows if words]


def _are_points(words: list[str]) -> bool:
    """Return whether a line holds the points of an image: X, Y and the number of a point, again and again."""
    return len(words) % 3 == 0 and _numbers(words) is not None


def _numbers(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _lens(words: list[str]) -> _Lens:
    if len(words) < 4:
        raise ViewError(f"expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got {len(words)} values")
    model, numbers = words[1].upper(), _numbers(words[2:])
    if model not in _MODELS:
        if "FISHEYE" in model or model in ("FOV", "THIN_PRISM_FISHEYE"):
            require_undistorted({"of the model": 1.0}, model)
        raise ViewError(f"camera model {model}: {suggest(model, list(_MODELS))}")
    num_focal, extra = _MODELS[model]
    wanted = 2 + num_focal + 2 + len(extra)
    if numbers is None or len(numbers) != wanted or not (numbers[0].is_integer() and numbers[1].is_integer()):
        raise ViewError(f"{model}: expected {wanted} numbers: width, height and {wanted - 2} parameters")
    require_undistorted(dict(zip(extra, numbers[4 + num_focal :], strict=True)), model)
    focal, centre = numbers[2 : 2 + num_focal], numbers[2 + num_focal : 4 + num_focal]
    return int(numbers[0]), int(numbers[1]), (focal[0], focal[-1]), (centre[0], centre[1])


def _image(words: list[str], lenses: dict[str, _Lens]) -> ListedImage:
    numbers = _numbers(words[1:8])
    if len(words) < 10 or numbers is None:
        raise ViewError("expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
    if not np.isfinite(numbers).all() or not any(numbers[:4]):
        raise ViewError("the pose holds numbers that are not finite, or a quaternion of 0")
    if words[8] not in lenses:
        raise ViewError(f"camera {words[8]} is not in {CAMERAS}, which has {', '.join(lenses) or 'none'}")
    name = " ".join(words[9:])
    to_camera = Rotation.from_quat([*numbers[1:4], numbers[0]]).as_matrix()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = to_camera.T @ _AXES, -to_camera.T @ numbers[4:7]
    lens = lenses[words[8]]
    camera = partial(_camera, lens, pose)
    return ListedImage(str(PurePosixPath(name).with_suffix("")), name, camera, (lens[0], lens[1]))


def _camera(lens: _Lens, pose: Pose, width: int, height: int) -> Camera:
    return Camera("pinhole", width, height, lens[2], lens[3], pose)
