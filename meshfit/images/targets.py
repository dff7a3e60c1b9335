"""Loading of targets of images, and of any target with its content's hash."""

import hashlib
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from meshfit.doors import no_type_check
from meshfit.errors import MeshfitWarning, ViewError, error_prefix
from meshfit.images.files import load_views, renamed
from meshfit.images.folders import PACK_SUFFIX
from meshfit.images.packing import unpack_target
from meshfit.images.rasteriser import render_view
from meshfit.images.specs import ImageFiles, RenderedViews, image_spec, is_image_target
from meshfit.images.sphere_cameras import cameras_around, directions_between, sphere_directions
from meshfit.images.target import ImageTarget, LoadedImages
from meshfit.images.views import View, Views
from meshfit.mesh.any_target import require_mesh
from meshfit.mesh.cleaning import outward
from meshfit.mesh.cleaning_options import CleaningOptions
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.targets import file_sha256, load_target, target_path
from meshfit.paths import path_text
from meshfit.printable import described

_VERSION = 1
"""Increased whenever the same rendered views have other pixels."""


def load_shape(target: str, cleaning: CleaningOptions | None = None) -> Mesh | PointCloud:
    """Load what a fit to any target starts from: the mesh or the points, of images their shape.

    Raises:
        MeshError: it cannot be loaded.
    """
    return load_image_target(target).shape if is_image_target(target) else load_target(target, cleaning)


def load_reference(target: str, cleaning: CleaningOptions | None = None) -> Mesh | PointCloud:
    """Load what results of any target are compared with, turned if it is inside out: of images the truth, if known.

    Raises:
        MeshError: it cannot be loaded.
    """
    if is_image_target(target):
        return load_image_target(target).reference
    return outward(load_target(target, cleaning))


def content_sha256(target: str) -> str:
    """Return the SHA-256 of all that any target is made from, in hexadecimal.

    Raises:
        MeshError: it cannot be loaded.
    """
    return load_images(target).sha256 if is_image_target(target) else file_sha256(target_path(target))


def load_images(target: str) -> LoadedImages:
    """Load or render a target of images, in its own coordinates.

    Raises:
        MeshError: it cannot be loaded.
        ConfigError: the library of a format is not installed.
    """
    if target.endswith(PACK_SUFFIX):
        return unpack_target(Path(target))
    spec = image_spec(target)
    return _rendered(spec) if isinstance(spec, RenderedViews) else _loaded(spec)


@no_type_check
def load_image_target(target: str | Path) -> ImageTarget:
    """Load or render a target of images, in its own coordinates.

    Args:
        target: folder of images with cameras, file of cameras, or a text as in a config, such as
            `views:of=bunny,count=12,size=256,depth=true`.

    Example:
        >>> import meshfit
        >>> target = meshfit.load_image_target("views:of=bone,count=3,size=64,depth=true")
        >>> target
        ImageTarget('bone (3 views, depth, 64 px)', Views(3 views, depth))
        >>> result = meshfit.fit("bone", target, method="gauss-newton", connectivity="fixed", levels=0)
        >>> result.mesh.num_verts
        1513

    Raises:
        MeshError: it cannot be loaded.
        ConfigError: the library of a format is not installed.
    """
    if not isinstance(target, str | Path) or not str(target):
        raise ViewError(f"target: expected a folder of images with cameras, or its path, got {described(target)}")
    return load_images(str(target)).target


@no_type_check
def as_image_target(target: object) -> ImageTarget | None:
    """Return a target of images in any form: one, `Views`, or what a name or path stands for; None for others.

    Raises:
        MeshError: it cannot be loaded.
    """
    if isinstance(target, Views):
        return ImageTarget(target, None, "views")
    if isinstance(target, str | Path) and str(target) and is_image_target(str(target)):
        return load_image_target(target)
    return target if isinstance(target, ImageTarget) else None


def _rendered(spec: RenderedViews) -> LoadedImages:
    with error_prefix(str(spec)):
        mesh = _truth(spec.of)
        taken = sphere_directions(spec.count)
        between = directions_between(taken, spec.hold_out)
        cameras = cameras_around(mesh, taken, spec.size, kind=spec.kind)
        others = cameras_around(mesh, between, spec.size, kind=spec.kind) if spec.hold_out else []
    views = [render_view(mesh, camera, depth=spec.depth, normals=spec.normals) for camera in cameras]
    held_out = [render_view(mesh, camera, depth=False, normals=False) for camera in others]
    held = Views(renamed(held_out, "held-out-")) if held_out else None
    content = {key: value for key, value in vars(spec).items() if key != "of"}
    content |= {"mesh": file_sha256(target_path(spec.of)), "version": _VERSION}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    return LoadedImages(ImageTarget(Views(renamed(views, "view-")), mesh, spec.title, held), digest, spec.label)


def _loaded(spec: ImageFiles) -> LoadedImages:
    folder = Path(spec.images)
    loaded = load_views(Path(spec.cameras), folder) if spec.cameras else load_views(folder)
    views = Views([_used(view, spec) for view in loaded.views])
    with error_prefix(path_text(spec.images)):
        fitted, held_out = views.held_out(spec.hold_out)
    truth = None
    content: dict[str, Any] = {"images": loaded.sha256, "version": _VERSION}
    content |= {key: getattr(spec, key) for key in ("depth", "normals", "hold_out")}
    if spec.truth:
        with error_prefix("truth"):
            truth = _truth(spec.truth)
            content |= {"truth": file_sha256(target_path(spec.truth))}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    return LoadedImages(ImageTarget(fitted, truth, spec.title, held_out), digest, spec.label)


def _truth(name: str) -> Mesh:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        return outward(require_mesh(load_target(name), name))


def _used(view: View, spec: ImageFiles) -> View:
    return replace(view, depth=view.depth if spec.depth else None, normals=view.normals if spec.normals else None)
