"""Names of files of images and cameras, where they are in a folder, and what results of images are compared with."""

from pathlib import Path

from meshfit.paths import is_folder, is_regular_file

TRANSFORMS = "transforms.json"
_TRANSFORMS_OF_TRAINING = "transforms_train.json"
CAMERAS, IMAGES = "cameras.txt", "images.txt"
"""COLMAP's text files."""
BINARY = ("cameras.bin", "images.bin")
"""The binary form of the two files, which is not read."""
COLMAP_FOLDERS = (".", "sparse/0", "sparse", "colmap")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")
"""Suffixes of photographs and masks."""
FLOAT_SUFFIXES = (".exr", ".npy")
MAP_SUFFIXES = (".png", *FLOAT_SUFFIXES)
"""Suffixes of depth and normal maps."""
PACK_SUFFIX = ".views.npz"
"""Suffix of a target of images as one file."""

IMAGE_REFERENCES = {"truth": "true mesh", "depth": "points of the depth maps", "hull": "visual hull of the masks"}
"""What measurements compare results of images with, by `ImageTarget.compared_with`."""


def camera_files(place: Path) -> list[Path]:
    """Return the files of cameras at a path: a `transforms.json`, or COLMAP's two text files; none without any.

    Args:
        place: of a folder, of a JSON file, or of one of COLMAP's files.
    """
    if is_folder(place):
        for name in (TRANSFORMS, _TRANSFORMS_OF_TRAINING):
            if is_regular_file(place / name):
                return [place / name]
        folders = (place / folder for folder in COLMAP_FOLDERS)
        return next(filter(None, (_colmap_files(folder) for folder in folders)), [])
    if place.name in (CAMERAS, IMAGES):
        return _colmap_files(place.parent)
    return [place] if place.suffix.lower() == ".json" else []


def is_image_folder(place: Path) -> bool:
    """Return whether a folder holds images or cameras rather than meshes or trials."""
    if not is_folder(place):
        return False
    if camera_files(place) or any(is_regular_file(place / folder / BINARY[0]) for folder in COLMAP_FOLDERS):
        return True
    folders = (place, place / "images")
    return any(
        path.suffix.lower() in IMAGE_SUFFIXES for folder in folders if is_folder(folder) for path in folder.iterdir()
    )


def _colmap_files(folder: Path) -> list[Path]:
    files = [folder / CAMERAS, folder / IMAGES]
    return files if any(map(is_regular_file, files)) else []
