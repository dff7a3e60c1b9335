"""Pixels of image files: masks from PNG and the like, depth and normals from PNG, EXR and NPY, and back."""

import io
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Integer, Shaped, UInt8

from meshfit.errors import ViewError
from meshfit.images.camera import MOST_PIXELS
from meshfit.images.folders import FLOAT_SUFFIXES, IMAGE_SUFFIXES
from meshfit.images.views import Depth, Mask, NormalMap
from meshfit.optional import import_optional
from meshfit.paths import format_suffix, path_text
from meshfit.units import size_text

MapFormat = Literal["png", "exr", "npy"]

_PURPOSE, _INSTALL = "images need", "'meshfit[images]'"
_BROKEN = "damaged, or cut off; copy or export it again"
_LARGEST_FILE = 1 << 30
# Values beyond are the background of renderers; shares of the pixels of a drawn mask that are black or white.
_FAR, _BLACK_OR_WHITE, _NEARLY = 1e9, 0.98, 0.1
# Lengths of decoded normals; those of other pixels are not known.
_NORMAL_LENGTHS = (0.7, 1.3)
_DEPTH_CHANNELS = ("Z", "depth.Z", "Depth.Z", "depth", "Depth", "V", "Y", "R")
_NORMAL_CHANNELS = ("XYZ", "RGB")


@dataclass(frozen=True)
class Picture:
    """An image file with what it says of a mask.

    Attributes:
        width: in pixels.
        height: in pixels.
        mask: (H, W) from the alpha channel, or of an image that is black and white; None if there is neither.
    """

    width: int
    height: int
    mask: Mask | None


def read_content(path: Path) -> bytes:
    """Return the bytes of an image file.

    Raises:
        ViewError: it cannot be read, or is too large for an image.
    """
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise ViewError(f"{path_text(path)}: {size_text(size)} are too much for an image; scale it down")
        return path.read_bytes()
    except OSError as error:
        raise ViewError(f"{path_text(path)}: cannot be read: {error.strerror}") from error


def decode_picture(content: bytes, name: str) -> Picture:
    """Return the size of an image, and its mask: where alpha is half or more, or white where all is black or white.

    Raises:
        ViewError: it cannot be decoded.
        ConfigError: Pillow is not installed.
    """
    alpha, grey = _channels(content, name)
    height, width = grey.shape
    if alpha is not None and not (alpha == 1.0).all():
        return Picture(width, height, alpha >= 0.5)
    drawn = ((grey < _NEARLY) | (grey > 1 - _NEARLY)).mean() >= _BLACK_OR_WHITE
    return Picture(width, height, grey >= 0.5 if drawn and grey.max() > 0.5 else None)


def decode_mask(content: bytes, name: str) -> Mask:
    """Return the mask that an image file holds: where alpha, or else brightness, is half of its largest value or more.

    Raises:
        ViewError: it cannot be decoded.
        ConfigError: Pillow is not installed.
    """
    alpha, grey = _channels(content, name)
    values = grey if alpha is None or (alpha == 1.0).all() else alpha
    return np.asarray((values >= values.max() / 2) & (values > 0))


def decode_depth(content: bytes, name: str, scale: float | None, *, positive: bool) -> Depth:
    """Return (H, W) depth, NaN where it is not known: 0 in a PNG, not finite, or beyond 10⁹.

    Args:
        content: of a PNG of one channel, an EXR, or an NPY file.
        name: of the file.
        scale: length of one unit of the file; None if it is not given, which a PNG needs.
        positive: refuse what is not in front of the camera.

    Raises:
        ViewError: it cannot be decoded, or holds something else.
        ConfigError: the library of its format is not installed.
    """
    if format_suffix(name) in FLOAT_SUFFIXES:
        planes = _float_planes(content, name)
        depth = _plane(planes, name, _DEPTH_CHANNELS)
    else:
        if scale is None:
            raise ViewError(
                f"{path_text(name)}: depth in whole numbers needs their unit; set depth_unit_scale_factor, such as "
                "0.001 for millimetres in a scene in metres"
            )
        depth = _whole_numbers(content, name).astype(np.float64)
        depth[depth == 0] = np.nan
    with np.errstate(invalid="ignore"):
        depth = np.where(np.isfinite(depth) & (np.abs(depth) < _FAR), depth, np.nan) * (1.0 if scale is None else scale)
        return np.where(depth > 0, depth, np.nan) if positive else depth


def decode_normals(content: bytes, name: str) -> NormalMap:
    """Return (H, W, 3) unit normals, NaN where there is none.

    Args:
        content: of an EXR or NPY file of three channels, or a PNG in which 0 to 255, or 65,535, stands for -1 to 1.
        name: of the file.

    Raises:
        ViewError: it cannot be decoded, or holds something else.
        ConfigError: the library of its format is not installed.
    """
    if format_suffix(name) in FLOAT_SUFFIXES:
        planes = _float_planes(content, name)
        found = next((c for c in _NORMAL_CHANNELS if all(_ends(planes, channel) for channel in c)), None)
        if found is None:
            raise ViewError(f"{path_text(name)}: expected three channels of normals, got {', '.join(planes)}")
        normals = np.stack([planes[_ends(planes, channel)] for channel in found], axis=2)
    else:
        normals = 2 * _colours(content, name) - 1
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        known = (length > _NORMAL_LENGTHS[0]) & (length < _NORMAL_LENGTHS[1])
        return np.where(known, normals / length, np.nan)


def encode_png(pixels: UInt8[np.ndarray, "H W *C"] | Integer[np.ndarray, "H W"]) -> bytes:
    """Return a PNG of 8-bit pixels of 1, 3 or 4 channels, or of 16-bit pixels of one.

    Raises:
        ConfigError: Pillow is not installed.
    """
    image = import_optional("PIL.Image", _PURPOSE, _INSTALL)
    stream = io.BytesIO()
    image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def encode_depth(depth: Depth, file_format: MapFormat, scale: float) -> bytes:
    """Return a depth map: of a PNG in 16 bits in units of `scale`, else as it is.

    Raises:
        ConfigError: the library of the format is not installed.
    """
    if file_format == "png":
        return encode_png(np.nan_to_num(np.rint(depth / scale)).astype(np.uint16))
    return _encode_npy(depth) if file_format == "npy" else _encode_exr({"Z": depth})


def encode_normals(normals: NormalMap, file_format: MapFormat) -> bytes:
    """Return a normal map: of a PNG in 8 bits, else as it is.

    Raises:
        ConfigError: the library of the format is not installed.
    """
    if file_format == "png":
        return encode_png(np.rint(np.nan_to_num(normals, nan=0.0) * 127.5 + 127.5).astype(np.uint8))
    return (
        _encode_npy(normals)
        if file_format == "npy"
        else _encode_exr(dict(zip("XYZ", np.moveaxis(normals, 2, 0), strict=True)))
    )


def require_writer(file_format: MapFormat) -> None:
    """Refuse to go on where the libraries of images in a format are not installed.

    Raises:
        ConfigError: one is not.
    """
    import_optional("PIL.Image", _PURPOSE, _INSTALL)
    if file_format == "exr":
        import_optional("OpenEXR", "EXR files need", _INSTALL)


def _colours(content: bytes, name: str) -> NormalMap:
    """Return (H, W, 3) red, green and blue from 0 to 1, of a PNG in the precision that it has.

    Raises:
        ViewError: it cannot be decoded, or has no colours.
    """
    opened = _opened(content, name)
    if opened.mode not in ("RGB", "RGBA", "P"):
        raise ViewError(f"{path_text(name)}: expected normals in three channels, got {opened.mode} pixels")
    raw = _raw_mode(content)
    if raw not in ("RGB;16B", "RGBA;16B"):
        return np.asarray(opened.convert("RGB"), dtype=np.float64) / 255
    # Pillow keeps the first byte of each number; taken for little-endian ones, it is the second.
    high, low = (
        np.asarray(_opened(content, name, each))[:, :, :3].astype(np.float64) for each in (raw, f"{raw[:-1]}L")
    )
    return np.asarray((256 * high + low) / 65535)


def _raw_mode(content: bytes) -> str:
    """Return Pillow's name for the layout of a PNG's bytes, such as `RGB;16B`."""
    tiles = import_optional("PIL.Image", _PURPOSE, _INSTALL).open(io.BytesIO(content)).tile
    return str(tiles[0][3]) if tiles else ""


def _opened(content: bytes, name: str, raw_mode: str | None = None) -> Any:  # noqa: ANN401  Pillow is optional
    """Return a decoded image; its bytes are taken for those of a raw mode, if one is given."""
    image = import_optional("PIL.Image", _PURPOSE, _INSTALL)
    with warnings.catch_warnings():
        warnings.simplefilter("error", image.DecompressionBombWarning)
        try:
            opened = image.open(io.BytesIO(content))
            if opened.width * opened.height > MOST_PIXELS:
                raise ViewError(
                    f"{path_text(name)}: {opened.width} × {opened.height} pixels are too many; scale it down"
                )
            if raw_mode is not None:
                opened.tile = [(*tile[:3], raw_mode) for tile in opened.tile]
            opened.load()
        except (image.DecompressionBombWarning, image.DecompressionBombError):
            raise ViewError(f"{path_text(name)}: has too many pixels; scale it down") from None
        except image.UnidentifiedImageError:
            known = ", ".join(IMAGE_SUFFIXES)
            raise ViewError(f"{path_text(name)}: not an image that can be read; expected one of {known}") from None
        except (OSError, SyntaxError, ValueError, EOFError):
            raise ViewError(f"{path_text(name)}: {_BROKEN}") from None
    return opened


def _channels(content: bytes, name: str) -> tuple[Float64[np.ndarray, "H W"] | None, Float64[np.ndarray, "H W"]]:
    """Return alpha, if there is one, and brightness, both from 0 to 1."""
    opened = _opened(content, name)
    alpha = None
    if opened.mode in ("RGBA", "LA", "PA") or "transparency" in opened.info:
        opened = opened.convert("RGBA")
        alpha = np.asarray(opened.getchannel("A"), dtype=np.float64) / 255
    if opened.mode.startswith("I"):
        return None, np.asarray(opened, dtype=np.float64) / 65535
    return alpha, np.asarray(opened.convert("L"), dtype=np.float64) / 255


def _whole_numbers(content: bytes, name: str) -> Shaped[np.ndarray, "H W"]:
    opened = _opened(content, name)
    if opened.mode not in ("L", "I", "I;16", "I;16B"):
        raise ViewError(f"{path_text(name)}: expected depth in one channel of 8 or 16 bits, got {opened.mode} pixels")
    return np.asarray(opened)


def _float_planes(content: bytes, name: str) -> dict[str, Float64[np.ndarray, "H W"]]:
    """Return the channels of an EXR or NPY file by name; those of NPY are Z alone, or X, Y, Z."""
    if format_suffix(name) == ".exr":
        return _exr_planes(content, name)
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:  # noqa: BLE001  a damaged header may raise anything
        raise ViewError(f"{path_text(name)}: {_BROKEN}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.size > 4 * MOST_PIXELS:
        raise ViewError(f"{path_text(name)}: expected an array of numbers, rows by columns")
    array = array[:, :, 0] if array.ndim == 3 and array.shape[2] == 1 else array
    if array.ndim == 2:
        return {"Z": array.astype(np.float64)}
    if array.ndim == 3 and array.shape[2] == 3:
        return {axis: array[:, :, k].astype(np.float64) for k, axis in enumerate("XYZ")}
    raise ViewError(f"{path_text(name)}: expected rows by columns, or these by 3, got shape {array.shape}")


def _plane(
    planes: dict[str, Float64[np.ndarray, "H W"]], name: str, wanted: tuple[str, ...]
) -> Float64[np.ndarray, "H W"]:
    if len(planes) == 1:
        return next(iter(planes.values()))
    found = next((channel for channel in wanted if channel in planes), None)
    if found is None or (set(planes) >= set("XYZ")):
        raise ViewError(f"{path_text(name)}: expected one channel of depth, got {', '.join(planes)}")
    return planes[found]


def _ends(planes: dict[str, Float64[np.ndarray, "H W"]], channel: str) -> str:
    """Return the name of a channel, such as `X` or `normal.X`; empty if there is none."""
    return next((name for name in planes if name.rpartition(".")[2] == channel), "")


def _exr_planes(content: bytes, name: str) -> dict[str, Float64[np.ndarray, "H W"]]:
    library = import_optional("OpenEXR", "EXR files need", _INSTALL)
    with tempfile.TemporaryDirectory(prefix="meshfit-") as folder, _silent():
        path = Path(folder, "image.exr")
        path.write_bytes(content)
        try:
            _require_pixels(library.File(str(path), header_only=True).header()["dataWindow"], name)
            channels = library.File(str(path), separate_channels=True).channels()
            planes = {str(key): np.array(channel.pixels, dtype=np.float64) for key, channel in channels.items()}
        except (RuntimeError, ValueError, TypeError, IndexError):
            planes = {}
    if not planes or any(plane.ndim != 2 for plane in planes.values()):
        raise ViewError(f"{path_text(name)}: {_BROKEN}")
    return planes


def _require_pixels(window: tuple[Integer[np.ndarray, "2"], Integer[np.ndarray, "2"]], name: str) -> None:
    """Refuse an image of too many pixels by its header, as a file of nothing is small."""
    low, high = window
    width, height = (int(high[k]) - int(low[k]) + 1 for k in range(2))
    if width * height > MOST_PIXELS:
        raise ViewError(f"{path_text(name)}: {width} × {height} pixels are too many; scale it down")


def _encode_exr(planes: dict[str, Float64[np.ndarray, "H W"]]) -> bytes:
    library = import_optional("OpenEXR", "EXR files need", _INSTALL)
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with tempfile.TemporaryDirectory(prefix="meshfit-") as folder:
        path = Path(folder, "image.exr")
        channels = {name: np.ascontiguousarray(plane, dtype=np.float32) for name, plane in planes.items()}
        library.File(header, channels).write(str(path))
        return path.read_bytes()


def _encode_npy(array: Float64[np.ndarray, "..."]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


@contextmanager
def _silent() -> Iterator[None]:
    """Drop what a C++ library prints to stderr of a damaged file, within the block."""
    sys.stderr.flush()
    kept = os.dup(2)
    with Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
