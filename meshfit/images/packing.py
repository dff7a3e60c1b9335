"""Targets of images as one file, for workers and run directories that do not share their folder."""

import io
import json
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from meshfit.errors import MeshError, ViewError
from meshfit.images.camera import Camera
from meshfit.images.folders import PACK_SUFFIX
from meshfit.images.target import ImageTarget, LoadedImages
from meshfit.images.views import View, Views
from meshfit.memory import require_memory
from meshfit.mesh.mesh import Mesh
from meshfit.paths import is_regular_file, not_a_file_message, path_text
from meshfit.units import size_text


def pack_target(loaded: LoadedImages) -> bytes:
    """Return a target of images as the content of one file, which is exactly restored."""
    target = loaded.target
    arrays: dict[str, Any] = {}
    parts = {"fitted": target.views, "held_out": target.held_out or ()}
    records = {
        part: [_record(view, f"{part}-{row}", arrays) for row, view in enumerate(views)]
        for part, views in parts.items()
    }
    if target.truth is not None:
        arrays |= {"truth-verts": target.truth.verts, "truth-faces": target.truth.faces}
    record = {"name": target.name, "sha256": loaded.sha256, "label": loaded.label} | records
    arrays["record"] = np.frombuffer(json.dumps(record).encode(), dtype=np.uint8)
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def unpack_target(path: Path) -> LoadedImages:
    """Return the target of images that a file holds.

    Raises:
        ViewError: it cannot be read, or is damaged.
    """
    try:
        _require_room(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)
        record = json.loads(arrays["record"].tobytes())
        views = [_view(entry, arrays) for entry in record["fitted"]]
        held_out = [_view(entry, arrays) for entry in record["held_out"]]
        truth = Mesh(arrays["truth-verts"], arrays["truth-faces"]) if "truth-verts" in arrays else None
        target = ImageTarget(Views(views), truth, record["name"], Views(held_out) if held_out else None)
        return LoadedImages(target, str(record["sha256"]), str(record["label"]))
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise ViewError(f"{path_text(path)}: damaged: {error}") from error


def _require_room(path: Path) -> None:
    """Refuse what is no file, such as a pipe, and a file whose content memory has no room for."""
    if not is_regular_file(path):
        raise ViewError(f"{path_text(path)}: {not_a_file_message(path, (PACK_SUFFIX,))}")
    with ZipFile(path) as archive:
        size = sum(info.file_size for info in archive.infolist())
    require_memory(size, f"{path_text(path)}: unpacks to {size_text(size)}", "take fewer or smaller images")


def packed_names(path: Path) -> tuple[str, str]:
    """Return the title and the label of the target of images that a file holds; its stem where it cannot be read."""
    try:
        _require_room(path)
        with np.load(path, allow_pickle=False) as archive:
            record = json.loads(archive["record"].tobytes())
        return str(record["name"]), str(record["label"])
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error, MeshError):
        stem = path.name.removesuffix(PACK_SUFFIX)
        return stem, stem


def _record(view: View, key: str, arrays: dict[str, Any]) -> dict[str, Any]:
    camera = view.camera
    arrays |= {f"{key}-pose": camera.pose, f"{key}-mask": view.mask}
    for name, values in (("depth", view.depth), ("normals", view.normals)):
        if values is not None:
            arrays[f"{key}-{name}"] = values
    return {
        "key": key,
        "name": view.name,
        "kind": camera.kind,
        "size": [camera.width, camera.height],
        "focal": camera.focal,
        "centre": camera.centre,
    }


def _view(entry: dict[str, Any], arrays: dict[str, Any]) -> View:
    key, (width, height) = entry["key"], entry["size"]
    camera = Camera(entry["kind"], width, height, tuple(entry["focal"]), tuple(entry["centre"]), arrays[f"{key}-pose"])
    return View(entry["name"], camera, arrays[f"{key}-mask"], arrays.get(f"{key}-depth"), arrays.get(f"{key}-normals"))
