"""Carried targets: copies of the targets of trials in the run directory, which make it complete without other files.

`targets/HASH.ply` is the target as it was fitted to: cleaned, turned if it was inside out, in its own coordinates and
double precision; of a cloud, its points with the normals of its file, if it had some; of images, what results are
compared with. `targets/HASH.views.npz` holds the images: masks, depth, normals and cameras. The hash is that of the
original file or files, as in the identity of a trial.
"""

import os
import re
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from filelock import FileLock

from meshfit.config.path_parts import TARGETS
from meshfit.errors import MeshError, MeshfitError, MeshfitWarning, StoreError
from meshfit.experiment.storage.run_directory import LOCK, Result, RunDirectory, make_folder, write_atomically
from meshfit.images.folders import PACK_SUFFIX
from meshfit.mesh.cleaning_options import CleaningOptions

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial
    from meshfit.images.target import ImageTarget, LoadedImages
    from meshfit.mesh.mesh import Mesh, Verts
    from meshfit.mesh.point_cloud import PointCloud
    from meshfit.mesh.polygons import PolygonMesh
    from meshfit.mesh.topology import Indices

_CARRIED = re.compile(r"[0-9a-f]{64}")
_LEVELS = 4
"""The number of folders from that of a trial up to the run directory."""


def carried_path(trial: "Trial", store: RunDirectory) -> Path | None:
    """The path of a trial's carried target; None if the run directory carries none."""
    sha256 = dict(trial.inputs).get("target")
    if sha256 is None or not store.carries_targets:
        return None
    return store.root / TARGETS / carried_name(sha256, trial.settings.cleaning)


def present_target(trial: "Trial", store: RunDirectory) -> str:
    """Return the name of a trial's target, or the present path of its file; of its carried copy if that is missing."""
    name, carried = trial.current_path(trial.target), carried_path(trial, store)
    if carried is None or not is_missing(name):
        return name
    copies = (carried.with_name(f"{dict(trial.inputs)['target']}{PACK_SUFFIX}"), carried)
    return next((str(copy) for copy in copies if copy.is_file()), name)


def is_missing(target: str) -> bool:
    """Whether a target is to be read from a file or a folder that is not there."""
    from meshfit.images.specs import RenderedViews, image_spec
    from meshfit.mesh.targets import NAMED_TARGETS

    with suppress(MeshfitError, ValueError):
        if target.startswith(("views:", "images:")):
            spec = image_spec(target)
            target = spec.of if isinstance(spec, RenderedViews) else spec.images
        return target not in NAMED_TARGETS and not os.path.lexists(target)
    return False


def carry(path: Path | None, load: Callable[[], "Mesh | PointCloud"]) -> None:
    """Write a carried target unless it exists, whole or not at all; of several processes, one writes.

    Args:
        path: path from `carried_path`.
        load: returns the target, in its own coordinates.

    Raises:
        StoreError: it cannot be written.
    """

    def content() -> bytes:
        from meshfit.mesh.io.files import encode_mesh
        from meshfit.mesh.io.point_clouds import encode_point_cloud
        from meshfit.mesh.point_cloud import PointCloud

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshfitWarning)  # the trial reports them
            target = load()
            return encode_point_cloud(target) if isinstance(target, PointCloud) else encode_mesh(target, ".ply")

    if path is not None:
        _write_once(path, content)


def carry_images(path: Path | None, load: "Callable[[], LoadedImages]") -> None:
    """Write the images of a target, and what results are compared with, as `carry` does.

    Args:
        path: path from `carried_path`.
        load: returns the images, in their own coordinates.

    Raises:
        StoreError: a file cannot be written.
    """
    if path is None:
        return
    from meshfit.images.packing import pack_target

    def content() -> bytes:
        return pack_target(load())

    _write_once(path.with_suffix(PACK_SUFFIX), content)
    carry(path, lambda: load().target.reference)


def carry_target(path: Path | None, name: str, cleaning: CleaningOptions) -> None:
    """Carry the target of a name or path, of any kind, unless all of it is carried already.

    Raises:
        MeshError: it cannot be loaded.
        StoreError: a file cannot be written.
    """
    from meshfit.images.specs import is_image_target
    from meshfit.images.targets import load_images, load_reference

    if is_image_target(name):
        carry_images(path, cache(lambda: load_images(name)))
    else:
        carry(path, lambda: load_reference(name, cleaning))


def _write_once(path: Path, content: Callable[[], bytes]) -> None:
    if path.is_file():
        return
    data = content()
    make_folder(path.parent)
    with FileLock(path.parent / LOCK):
        for part in path.parent.glob(f".{path.name}.*"):  # left by a killed process
            part.unlink(missing_ok=True)
        if not path.is_file():
            write_atomically(path, data)


def carry_for_remote(trial: "Trial", store: RunDirectory) -> None:
    """Carry the target of a trial that will run in a directory of its own, unless the file has changed since the plan.

    Raises:
        StoreError: it cannot be written.
    """
    from meshfit.images.targets import content_sha256

    path = carried_path(trial, store)
    if path is None or path.is_file():
        return
    with suppress(MeshError):  # the trial reports it
        if content_sha256(trial.target) == dict(trial.inputs)["target"]:
            carry_target(path, trial.target, trial.settings.cleaning)


def find_carried(folder: Path, record: Result) -> Path | None:
    """Find the carried target of a trial by its folder and `result.json`, wherever the run directory is now."""
    sha256 = record.get("inputs", {}).get("target")
    if not isinstance(sha256, str):
        return None
    name = carried_name(sha256, CleaningOptions.of(record.get("settings", {})))
    for place in (Path(os.path.abspath(folder)), folder.resolve()):  # noqa: PTH100  a run directory may be a link
        for above in (place, *place.parents[:_LEVELS]):
            if (path := above / TARGETS / name).is_file():
                return path
    return None


def unused_targets(root: Path, records: Iterable[Result]) -> list[Path]:
    """Return the carried targets of a run directory that none of its trials, by their records, was fitted to."""
    used = {
        carried_name(record.get("inputs", {}).get("target", ""), CleaningOptions.of(record.get("settings", {})))
        for record in records
    }
    used |= {str(Path(name).with_suffix(PACK_SUFFIX)) for name in used}
    carried = sorted(path for suffix in (".ply", PACK_SUFFIX) for path in (root / TARGETS).glob(f"*{suffix}"))
    return [path for path in carried if _CARRIED.match(path.name) and path.name not in used]


def remove_targets(root: Path, paths: Iterable[Path]) -> None:
    """Remove carried targets of a run directory, and their folder if it becomes empty.

    Raises:
        StoreError: one cannot be removed.
    """
    folder = root / TARGETS
    try:
        with FileLock(folder / LOCK):
            for path in paths:
                path.unlink(missing_ok=True)
            if not any(path.name != LOCK for path in folder.iterdir()):
                (folder / LOCK).unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()
    except OSError as error:
        raise StoreError(f"{error.filename or folder}: cannot be removed: {error.strerror}") from error


def read_target(folder: Path, record: Result) -> "Mesh | PointCloud":
    """Read the target of a trial in its own coordinates: the carried one, else its file if that has not changed.

    It is as it was for the fit: a mesh is turned if it is inside out, of its pieces or its surface only that is left
    which the settings keep, and points that a sensor saw have normals towards it.

    Args:
        folder: the folder of the trial.
        record: content of its `result.json`.

    Raises:
        MeshError: neither can be read.
    """
    carried, damage = find_carried(folder, record), None
    if carried is not None:
        try:
            return _as_fitted(read_carried(carried), record)
        except MeshError as error:
            damage = error
    try:
        return _as_fitted(_original(record), record)
    except MeshError as error:
        if damage is not None:
            raise damage from None
        remedy = f"and the run directory has no copy of it: copy its folder '{TARGETS}' too"
        raise MeshError(f"{error}; {remedy}") from None


def read_images(folder: Path, record: Result) -> "ImageTarget | None":
    """Read the images that a trial was fitted to, in their own coordinates; None if its target was none of images.

    They are the carried ones, else their files if these have not changed.

    Args:
        folder: the folder of the trial.
        record: content of its `result.json`.

    Raises:
        MeshError: neither can be read.
    """
    if "images" not in record:
        return None
    from meshfit.images.packing import unpack_target
    from meshfit.images.targets import load_images

    carried = find_carried(folder, record)
    if carried is not None and (pack := carried.with_suffix(PACK_SUFFIX)).is_file():
        return unpack_target(pack).target
    _require_unchanged(record)
    return load_images(record["settings"]["targets"][0]).target


def _as_fitted(target: "Mesh | PointCloud", record: Result) -> "Mesh | PointCloud":
    from meshfit.mesh.cleaning import outward
    from meshfit.mesh.point_cloud import PointCloud, seen_cloud
    from meshfit.mesh.separate_pieces import kept_pieces

    settings = record.get("settings", {}).get("target", {})
    target = kept_pieces(outward(target), settings.get("keep"))
    if isinstance(target, PointCloud):
        return seen_cloud(target, settings.get("sensor"))
    mesh: Mesh = target
    if settings.get("surface", "all") == "all":
        return mesh
    from meshfit.mesh.outer_surface import outer_surface

    return outer_surface(mesh)


def read_carried(path: Path) -> "Mesh | PointCloud":
    """Read a carried target exactly as it was written.

    Raises:
        MeshError: no such file, or one that is damaged.
    """
    from meshfit.mesh.io.files import open_mesh_file
    from meshfit.mesh.io.point_clouds import read_written_points

    points = read_written_points(open_mesh_file(path, "mesh"))
    return triangles(read_written_mesh(path)) if points is None else points


def _original(record: Result) -> "Mesh | PointCloud":
    from meshfit.images.targets import load_reference

    _require_unchanged(record)
    return load_reference(record["settings"]["targets"][0], CleaningOptions.of(record["settings"]))


def _require_unchanged(record: Result) -> None:
    from meshfit.images.specs import is_image_target
    from meshfit.images.targets import content_sha256
    from meshfit.mesh.targets import target_path

    target, expected = record["settings"]["targets"][0], record.get("inputs", {}).get("target")
    if expected is not None and content_sha256(target) != expected:
        place = target if is_image_target(target) else target_path(target)
        raise MeshError(f"{place}: not the file that the trial was fitted to: it has changed since")


def read_written_mesh(path: Path) -> "Mesh | PolygonMesh":
    """Read a mesh that a trial wrote exactly as it was written, without cleaning; polygons unless all are triangles.

    Raises:
        MeshError: no such file, or one that is damaged.
    """
    from meshfit.mesh.io.files import open_mesh_file, read_soup
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh

    soup = read_soup(open_mesh_file(path, "mesh"))
    corners, num_verts = soup.corners, len(soup.verts)
    if not len(soup.sizes) or corners.min() < 0 or corners.max() >= num_verts:
        raise MeshError(f"{path}: damaged: its faces do not match its {num_verts} vertices")
    mesh = PolygonMesh(soup.verts, soup.corners, soup.sizes, soup.attributes)
    return Mesh(mesh.verts, mesh.corners.reshape(-1, 3), mesh.attributes) if (mesh.sizes == 3).all() else mesh


@lru_cache(maxsize=2)  # a worker runs the trials of a target in succession
def file_numbers(target: str, _sha256: str | None) -> "tuple[Verts, Indices, int]":
    """Return the vertices of a target's file, the corners of its faces one after the other, and their number.

    Args:
        target: as for `target_path`.
        _sha256: of its content, so that another content is read again.

    Raises:
        MeshError: it cannot be read.
    """
    from meshfit.mesh.io.files import POINT_FORMATS, parse_file, read_soup
    from meshfit.mesh.targets import open_target

    file = open_target(target)
    if file.suffix in POINT_FORMATS:
        verts = parse_file(file, POINT_FORMATS[file.suffix].read, POINT_FORMATS).verts
        return np.asarray(verts, dtype=np.float64), np.empty(0, dtype=np.int64), 0
    soup = read_soup(file)
    return np.asarray(soup.verts, dtype=np.float64), np.asarray(soup.corners, dtype=np.int64), len(soup.sizes)


def triangles(mesh: "Mesh | PolygonMesh") -> "Mesh":
    """Return a mesh with its polygons triangulated."""
    from meshfit.mesh.mesh import Mesh

    return mesh if isinstance(mesh, Mesh) else mesh.triangulated()


def carried_name(sha256: str, cleaning: CleaningOptions) -> str:
    """Return the name of a carried target, by the SHA-256 of what it was made from and the cleaning of its file."""
    weld = f"-weld-{cleaning.weld!r}" if cleaning.weld else ""
    repair = "" if cleaning.repair == "split" else f"-{cleaning.repair}"
    return f"{sha256}{weld}{repair}.ply"
