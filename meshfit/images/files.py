"""Folders of images with cameras: found, read and written."""

import hashlib
import warnings
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError, MeshfitWarning, ViewError, error_prefix
from meshfit.images.camera import MOST_PIXELS, Camera
from meshfit.images.colmap import parse_colmap
from meshfit.images.folders import (
    BINARY,
    CAMERAS,
    COLMAP_FOLDERS,
    IMAGE_SUFFIXES,
    IMAGES,
    MAP_SUFFIXES,
    TRANSFORMS,
    camera_files,
)
from meshfit.images.formats import (
    MapFormat,
    Picture,
    decode_depth,
    decode_mask,
    decode_normals,
    decode_picture,
    encode_depth,
    encode_normals,
    encode_png,
    read_content,
)
from meshfit.images.listing import ListedImage
from meshfit.images.transforms import parse_transforms, transforms_text
from meshfit.images.views import Depth, NormalMap, View, Views
from meshfit.mesh.io.mesh_file import write_file
from meshfit.paths import file_stem, is_folder, is_regular_file, path_text, quoted_path
from meshfit.units import count_text, size_text

_MASK_FOLDERS = ("masks", "mask")
_LARGEST_LIST = 1 << 26
_MOST_TOTAL = 16 * MOST_PIXELS
_SHOWN = 3
# Depth in 16 bits takes this many units of the deepest value.
_DEPTH_STEPS = 60_000


@dataclass(frozen=True, eq=False)
class LoadedViews:
    """Views from files.

    Attributes:
        views: in the order of the list.
        sha256: over the content of the cameras' files and of all images, in hexadecimal.
    """

    views: Views
    sha256: str


def load_views(cameras: Path, images: Path | None = None) -> LoadedViews:
    """Read the images that a file of cameras lists.

    A mask is that of a mask's file (`mask_path`, or `masks/NAME.png` beside the images), else the alpha of its image,
    else the image itself if it is black and white, else where there is depth. Depth and normals count within the mask.

    Args:
        cameras: a `transforms.json`, one of COLMAP's text files, or a folder that holds them.
        images: folder of the images; by default that of the cameras.

    Raises:
        ViewError: no such files, a camera that cannot be, images of another size, a mask that is empty or full, or a
            file that is missing or damaged.
        ConfigError: the library of a format is not installed.
    """
    files = _camera_files_of(cameras)
    content = [_read_list(path) for path in files]
    with error_prefix(path_text(files[0] if len(files) == 1 else files[0].parent)):
        if len(files) == 1:
            listed = parse_transforms(content[0])
        else:
            listed = parse_colmap(*(text.decode("utf-8", errors="replace") for text in content))
    folder = _Folder(_image_folders(files[0], images), hashlib.sha256(b"".join(content)))
    views, total = [], 0
    for image in listed:
        view = folder.view(image)
        views.append(view)
        total += view.mask.size
        if total > _MOST_TOTAL:
            raise ViewError(f"{path_text(files[0])}: its images have too many pixels in all; scale them down")
    stems = [view.name.rpartition("/")[2] for view in views]
    if len(set(stems)) == len(stems):
        views = [replace(view, name=stem) for view, stem in zip(views, stems, strict=True)]
    if any(image.size is None for image in listed):
        _require_one_size(views, files[0])
    _require_masks(views, files[0])
    with error_prefix(path_text(files[0])):
        whole = Views(views)
    _warn_of_others(folder.used)
    return LoadedViews(whole, folder.sha256.hexdigest())


def listed_files(folder: Path) -> list[Path]:
    """Return the files that the `transforms.json` of a folder lists and that are in it; none where it has no such list.

    Raises:
        ViewError: the list cannot be read.
    """
    place = folder / TRANSFORMS
    if not is_regular_file(place):
        return []
    with error_prefix(path_text(place)):
        listed = parse_transforms(_read_list(place))
    names = {name for image in listed for name in (image.file, image.mask, image.depth, image.normals) if name}
    within = folder.resolve()
    paths = sorted(folder / name for name in names)
    return [path for path in paths if is_regular_file(path) and path.resolve().is_relative_to(within)]


def save_views(
    folder: Path, views: Views, shades: Iterable[Float64[np.ndarray, "H W"]], file_format: MapFormat = "exr"
) -> list[Path]:
    """Write views as a folder of PNG files whose alpha is the mask, with depth, normals and a `transforms.json`.

    Args:
        folder: is created; files of the same names are replaced.
        views: with depth and normals where they are to be written.
        shades: (H, W) brightness of each image, from 0 to 1.
        file_format: of depth and normals: `npy` holds them exactly, `exr` in 32 bits, `png` depth in 16 bits and
            normals in 8.

    Returns:
        The files.

    Raises:
        MeshError: a file cannot be written.
        ConfigError: the library of a format is not installed.
    """
    deepest = max(
        (float(np.nanmax(view.depth)) for view in views if view.depth is not None and view.mask.any()), default=0.0
    )
    scale = deepest / _DEPTH_STEPS if file_format == "png" and deepest > 0 else None
    contents: dict[str, bytes] = {}
    listed = []
    for view, shade in zip(views, shades, strict=True):
        grey = np.rint(np.where(view.mask, shade, 0.0) * 255).astype(np.uint8)
        alpha = np.where(view.mask, 255, 0).astype(np.uint8)
        image = f"images/{view.name}.png"
        contents[image] = encode_png(np.dstack([grey, grey, grey, alpha]))
        depth = normals = None
        if view.depth is not None:
            depth = f"depth/{view.name}.{file_format}"
            contents[depth] = encode_depth(view.depth, file_format, scale or 1.0)
        if view.normals is not None:
            normals = f"normals/{view.name}.{file_format}"
            contents[normals] = encode_normals(view.normals, file_format)
        listed.append(ListedImage(view.name, image, _no_camera, None, None, depth, normals, scale if depth else None))
    contents[TRANSFORMS] = transforms_text(listed, [view.camera for view in views]).encode()
    for name, content in contents.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MeshError(
                f"{path_text(path.parent)}: cannot be created: {error.strerror}; give another place"
            ) from None
        write_file(path, content)
    return [folder / name for name in contents]


def _no_camera(width: int, height: int) -> Camera:
    raise NotImplementedError  # what is written has its camera beside it


def _camera_files_of(place: Path) -> list[Path]:
    files = camera_files(place)
    if files:
        missing = [path for path in files if not is_regular_file(path)]
        if missing:
            raise ViewError(
                f"{path_text(missing[0])}: no such file"
                + ("; COLMAP's cameras are two files, cameras.txt and images.txt" if len(files) > 1 else "")
            )
        return files
    text, wanted = path_text(place), f"{TRANSFORMS}, or COLMAP's {CAMERAS} and {IMAGES}"
    if not is_folder(place):
        fault = f"not a file of cameras; expected {wanted}" if is_regular_file(place) else "no such file or folder"
        raise ViewError(f"{text}: {fault}")
    for folder in COLMAP_FOLDERS:
        if is_regular_file(place / folder / BINARY[0]):
            command = (
                f"colmap model_converter --input_path {place / folder} --output_path {place / folder} --output_type TXT"
            )
            raise ViewError(f"{path_text(place / folder)}: COLMAP's binary files are not read; convert them: {command}")
    raise ViewError(f"{text}: has no cameras; expected {wanted} in it")


def _read_list(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > _LARGEST_LIST:
            raise ViewError(
                f"{path_text(path)}: {size_text(size)} are too much for a list of cameras; is it another file?"
            )
        return path.read_bytes()
    except OSError as error:
        raise ViewError(f"{path_text(path)}: cannot be read: {error.strerror}") from error


def _image_folders(cameras: Path, images: Path | None) -> list[Path]:
    if images is not None:
        if not is_folder(images):
            raise ViewError(f"{path_text(images)}: no such folder of images")
        return [images, images / "images"]
    folder = cameras.parent
    if cameras.suffix.lower() == ".json":
        return [folder]
    above = [folder, folder.parent, folder.parent.parent]
    return [place for each in above for place in (each / "images", each)]


@dataclass
class _Folder:
    """Images in one of several folders, and the hash of all that has been read.

    Attributes:
        folders: where to look for a file.
        sha256: over what has been read.
        used: images that a list names.
    """

    folders: list[Path]
    sha256: "hashlib._Hash"
    used: list[Path] = field(default_factory=list)

    def view(self, image: ListedImage) -> View:
        """Read one image and its maps.

        Raises:
            ViewError: naming the file.
        """
        path, picture = self._picture(image)
        mask_path = self._mask_path(image, path)
        size = self._size(image, path, picture, mask_path)
        with error_prefix(path_text(path)):
            camera = image.camera(*size)
        mask = None if picture is None else picture.mask
        if mask_path is not None:
            mask = decode_mask(self._read(mask_path), str(mask_path))
            _require_size(mask.shape, size, mask_path)
        depth, normals = self._depth(image, camera, size), self._normals(image, camera, size)
        if mask is None and depth is not None:
            mask = np.isfinite(depth)
        if mask is None:
            raise ViewError(
                f"{path_text(path)}: has no mask: no transparent pixel, and no mask_path or masks/{path.stem}.png; cut "
                "the object out, or add one"
            )
        depth = None if depth is None else np.where(mask, depth, np.nan)
        if depth is not None and mask.any() and not np.isfinite(depth).any():
            raise ViewError(
                f"{path_text(self._find(image.depth or ''))}: has no depth within the mask; is it of another image?"
            )
        normals = None if normals is None else np.where(mask[:, :, None], normals, np.nan)
        return View(image.name, camera, mask, depth, normals)

    def _picture(self, image: ListedImage) -> tuple[Path, Picture | None]:
        """Return the path of an image, and its size and mask; None where there is a mask's or depth's file instead."""
        try:
            path = self._find(image.file, IMAGE_SUFFIXES)
        except ViewError:
            if image.mask is None and image.depth is None:
                raise
            return Path(image.file), None
        self.used.append(path)
        return path, decode_picture(self._read(path), str(path))

    def _mask_path(self, image: ListedImage, path: Path) -> Path | None:
        if image.mask is not None:
            return self._find(image.mask, IMAGE_SUFFIXES)
        if path.parent.name in _MASK_FOLDERS:
            return None
        names = (f"{Path(image.file).name}.png", f"{file_stem(image.file)}.png")
        above = dict.fromkeys([*(each for folder in self.folders for each in (folder, folder.parent)), path.parent])
        found = (each / folder / name for each in above for folder in _MASK_FOLDERS for name in names)
        return next(filter(is_regular_file, found), None)

    def _size(self, image: ListedImage, path: Path, picture: Picture | None, mask_path: Path | None) -> tuple[int, int]:
        if picture is not None:
            size = (picture.width, picture.height)
            if image.size is not None and image.size != size:
                raise ViewError(
                    f"{path_text(path)}: has {size[0]} × {size[1]} pixels, and its camera {image.size[0]} × "
                    f"{image.size[1]}; give the cameras of these images, or images of that size"
                )
            return size
        if image.size is not None:
            return image.size
        if mask_path is None:
            raise ViewError(f"{path_text(path)}: no such image, and its camera has no w and h; give them")
        mask = decode_mask(read_content(mask_path), str(mask_path))
        return mask.shape[1], mask.shape[0]

    def _depth(self, image: ListedImage, camera: Camera, size: tuple[int, int]) -> Depth | None:
        if image.depth is None:
            return None
        path = self._find(image.depth, MAP_SUFFIXES)
        positive = camera.kind == "pinhole"
        depth = decode_depth(self._read(path), str(path), image.depth_scale, positive=positive)
        _require_size(depth.shape, size, path)
        return depth

    def _normals(self, image: ListedImage, camera: Camera, size: tuple[int, int]) -> NormalMap | None:
        if image.normals is None:
            return None
        path = self._find(image.normals, MAP_SUFFIXES)
        normals = decode_normals(self._read(path), str(path))
        _require_size(normals.shape, size, path)
        return np.asarray(normals @ camera.pose[:3, :3].T) if image.normals_in_camera else normals

    def _read(self, path: Path) -> bytes:
        content = read_content(path)
        self.sha256.update(len(content).to_bytes(8, "little") + content)
        return content

    def _find(self, name: str, suffixes: tuple[str, ...] = ()) -> Path:
        """Return the file of a name in a list, which may lack its suffix, in one of the folders.

        Raises:
            ViewError: there is none.
        """
        parts = Path(name.replace("\\", "/"))
        tries = [folder / each for folder in self.folders for each in dict.fromkeys((parts, Path(parts.name)))]
        for path in tries:
            if is_regular_file(path):
                return path
            for suffix in suffixes:
                if is_regular_file(named := path.with_name(f"{path.name}{suffix}")):
                    return named
        raise ViewError(
            f"{path_text(tries[0])}: no such image; the cameras list it, so put it there or remove its entry"
        )


def _require_size(shape: tuple[int, ...], size: tuple[int, int], path: Path) -> None:
    if shape[:2] != size[::-1]:
        raise ViewError(
            f"{path_text(path)}: has {shape[1]} × {shape[0]} pixels, and its camera {size[0]} × {size[1]}; give one of "
            "that size"
        )


def _require_masks(views: list[View], cameras: Path) -> None:
    """Refuse masks that are empty, or full and without depth.

    Raises:
        ViewError: naming the view.
    """
    for view in views:
        if not view.mask.any():
            raise ViewError(
                f"{path_text(cameras)}: the mask of '{view.name}' is empty; leave that image out, or correct its mask"
            )
        if view.mask.all() and view.depth is None:
            raise ViewError(
                f"{path_text(cameras)}: the mask of '{view.name}' is full, so it shows no outline; cut the object out, "
                "or leave that image out"
            )


def _require_one_size(views: list[View], cameras: Path) -> None:
    """Refuse images of several sizes, whose list gives no size.

    Raises:
        ViewError: naming two of them.
    """
    sizes = Counter((view.camera.width, view.camera.height) for view in views)
    if len(sizes) > 1:
        usual = sizes.most_common(1)[0][0]
        view = next(view for view in views if (view.camera.width, view.camera.height) != usual)
        raise ViewError(
            f"{path_text(cameras)}: '{view.name}' has {view.camera.width} × {view.camera.height} pixels, and others "
            f"{usual[0]} × {usual[1]}; give images of one size, or w, h and fl_x for each"
        )


def _warn_of_others(used: list[Path]) -> None:
    """Warn of images beside those in the list that no camera is known for; maps of listed images are none of them."""
    known = {path.resolve() for path in used}
    others = []
    for folder in dict.fromkeys(path.parent for path in used):
        suffixes = {path.suffix for path in used if path.parent == folder}
        stems = tuple(path.stem for path in used if path.parent == folder)
        others += [
            path
            for path in sorted(folder.iterdir())
            if path.suffix in suffixes and path.resolve() not in known and not path.stem.startswith(stems)
        ]
    if others:
        names = ", ".join(quoted_path(path.name) for path in others[:_SHOWN]) + (" …" if len(others) > _SHOWN else "")
        text = f"{count_text(len(others), 'image')} without a camera left out: {names}"
        warnings.warn(f"{path_text(others[0].parent)}: {text}", MeshfitWarning, stacklevel=3)


def renamed(views: Iterable[View], prefix: str) -> list[View]:
    """Return views named by a prefix and a number of two digits or more."""
    rows = list(views)
    digits = max(2, len(str(len(rows) - 1)))
    return [replace(view, name=f"{prefix}{row:0{digits}}") for row, view in enumerate(rows)]
