"""Lists of images with their cameras, as files such as `transforms.json` hold them."""

from collections.abc import Callable
from dataclasses import dataclass

from meshfit.errors import ViewError
from meshfit.images.camera import Camera

MOST_IMAGES = 10_000
"""Images of the longest list that is read."""


@dataclass(frozen=True)
class ListedImage:
    """An image in a list.

    Attributes:
        name: of the view.
        file: path of the image, as the list has it.
        camera: returns the camera of an image of a width and height.
        size: (width, height) that the list gives; None if it gives none.
        mask: path of its mask; None if the list has none.
        depth: path of its depth map, or None.
        normals: path of its normal map, or None.
        depth_scale: length of one unit of the depth map; None if it is not given.
        normals_in_camera: whether normals are in the axes of the camera, not of the world.
    """

    name: str
    file: str
    camera: Callable[[int, int], Camera]
    size: tuple[int, int] | None = None
    mask: str | None = None
    depth: str | None = None
    normals: str | None = None
    depth_scale: float | None = None
    normals_in_camera: bool = False


def require_number_of_images(count: int) -> None:
    """Refuse a list without images, or one that is too long.

    Raises:
        ViewError: naming the number.
    """
    if not count:
        raise ViewError("lists no image; expected one or more")
    if count > MOST_IMAGES:
        raise ViewError(f"lists {count:,} images; at most {MOST_IMAGES:,} are read, so leave some out")


def require_undistorted(distortion: dict[str, float], model: str) -> None:
    """Refuse a camera with lens distortion.

    Raises:
        ViewError: a coefficient is not 0.
    """
    for name, value in distortion.items():
        if value != 0:
            raise ViewError(
                f"{model} with lens distortion, {name} = {value:g}; undistort the images first, such as by `colmap "
                "image_undistorter`, and give its cameras"
            )
