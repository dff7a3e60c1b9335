"""Targets of images as configs and command lines name them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from meshfit.errors import ViewError
from meshfit.images.folders import PACK_SUFFIX, camera_files, is_image_folder
from meshfit.mesh.targets import NAMED_TARGETS, target_title
from meshfit.paths import file_stem
from meshfit.specs import suggest
from meshfit.units import count_text

CameraKind = Literal["pinhole", "orthographic"]
_VIEWS, _IMAGES = "views", "images"
_LARGEST_SIZE, _MOST_VIEWS = 4096, 1000
_SIZE = 256


@dataclass(frozen=True)
class RenderedViews:
    """Views of a mesh from cameras on a sphere around it.

    Attributes:
        of: name of a target, or path of a mesh file.
        count: number of views to fit.
        size: width and height of the images in pixels.
        kind: of the cameras.
        depth: whether the views have depth.
        normals: whether they have normals.
        hold_out: number of further views, between the others, that only measurements see.
    """

    of: str
    count: int = 12
    size: int = _SIZE
    kind: CameraKind = "pinhole"
    depth: bool = False
    normals: bool = False
    hold_out: int = 4

    def __str__(self) -> str:
        """Return the canonical text, without what is as by default."""
        return _text(_VIEWS, self, ("of", "count"))

    @property
    def title(self) -> str:
        """`bunny (12 views, depth)`."""
        parts = [count_text(self.count, "view"), *self._extras]
        if self.size != _SIZE:
            parts.append(f"{self.size} px")
        return f"{target_title(self.of)} ({', '.join(parts)})"

    @property
    def label(self) -> str:
        """`bunny-12-views-depth`, for names of folders."""
        size = [] if self.size == _SIZE else [str(self.size)]
        name = self.of if self.of in NAMED_TARGETS else file_stem(self.of)
        return "-".join([name, count_text(self.count, "view").replace(" ", "-"), *self._extras, *size])

    @property
    def _extras(self) -> list[str]:
        kind = [] if self.kind == "pinhole" else [self.kind]
        return [*kind, *(["depth"] if self.depth else []), *(["normals"] if self.normals else [])]


@dataclass(frozen=True)
class ImageFiles:
    """Images in files.

    Attributes:
        images: folder of the images, or with their cameras.
        cameras: file or folder of the cameras; empty for those in the folder of the images.
        truth: mesh that measurements compare with; empty without one.
        depth: whether depth is used where there is some.
        normals: whether normals are used where there are some.
        hold_out: number of views, chosen evenly, that only measurements see.
    """

    images: str
    cameras: str = ""
    truth: str = ""
    depth: bool = True
    normals: bool = True
    hold_out: int = 0

    def __str__(self) -> str:
        """Return the canonical text: the path alone where all else is as by default."""
        return self.images if self == ImageFiles(self.images) else _text(_IMAGES, self, ("images",))

    @property
    def title(self) -> str:
        """The name of the folder."""
        return self._packed[0] if self._packed else self.label

    @property
    def label(self) -> str:
        """The name of the folder, with what is not used."""
        if self._packed:
            return self._packed[1]
        place = Path(self.images)
        place = place.parent if place.suffix and not place.is_dir() else place
        unused = [f"no-{key}" for key in ("depth", "normals") if not getattr(self, key)]
        return "-".join([place.resolve().name or "images", *unused])

    @cached_property
    def _packed(self) -> tuple[str, str] | None:
        """Title and label of the target that a single file holds; None for other files."""
        if not self.images.endswith(PACK_SUFFIX):
            return None
        from meshfit.images.packing import packed_names  # brings numpy

        return packed_names(Path(self.images))


ImageSpec = RenderedViews | ImageFiles
_KINDS: Mapping[str, type[RenderedViews] | type[ImageFiles]] = {_VIEWS: RenderedViews, _IMAGES: ImageFiles}


def is_image_target(target: str) -> bool:
    """Return whether a target, as a config or a command line names it, consists of images."""
    if target.startswith((f"{_VIEWS}:", f"{_IMAGES}:")):
        return True
    if target in NAMED_TARGETS or not target:
        return False
    return target.endswith(PACK_SUFFIX) or bool(camera_files(Path(target))) or is_image_folder(Path(target))


def image_spec(target: str) -> ImageSpec:
    """Return what a target of images says.

    Raises:
        ViewError: a key or a value that is not allowed.
    """
    kind, colon, text = target.partition(":")
    if not (colon and kind in _KINDS):
        return ImageFiles(target)
    pairs = {}
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not equals:
            raise ViewError(f"'{target}': expected 'key=value', got '{part}'; a path here cannot have a comma")
        pairs[key.strip()] = value.strip()
    return spec_of(kind, pairs)


def spec_of_mapping(data: Mapping[str, Any]) -> ImageSpec:
    """Return the spec of `{views: {of: bunny, count: 12}}`, or of `{images: FOLDER, cameras: FILE}`.

    Raises:
        ViewError: a key or a value that is not allowed.
    """
    if _VIEWS in data:
        if len(data) > 1 or not isinstance(data[_VIEWS], Mapping):
            raise ViewError("views: expected a mapping such as {of: bunny, count: 12, size: 256}, and no key beside it")
        return spec_of(_VIEWS, data[_VIEWS])
    if _IMAGES not in data:
        raise ViewError("expected a name, a path, {views: {of: TARGET, count: 12}} or {images: FOLDER, cameras: FILE}")
    return spec_of(_IMAGES, data)


def spec_of(kind: str, data: Mapping[str, Any]) -> ImageSpec:
    """Return the spec of a kind, `views` or `images`, from values or their texts.

    Raises:
        ViewError: a key or a value that is not allowed.
    """
    made = _KINDS[kind]
    fields = made.__dataclass_fields__
    values: dict[str, Any] = {}
    for key, value in data.items():
        if key not in fields:
            raise ViewError(f"{kind}: no such key '{key}': {suggest(str(key), list(fields))}")
        values[key] = _value(kind, key, value, type_of=type(fields[key].default))
    first = next(iter(fields))
    if not values.get(first):
        raise ViewError(f"{kind}: '{first}' is missing: {'the target to see' if kind == _VIEWS else 'the folder'}")
    if "," in "".join(value for value in values.values() if isinstance(value, str)):
        raise ViewError(f"{kind}: a path with a comma cannot be given here; rename it, or use a link")
    return made(**values)


def title_of_target(target: str) -> str:
    """Return the name of any target in tables: `bunny`, or of images `bunny (12 views)`."""
    return image_spec(target).title if is_image_target(target) else target_title(target)


def label_of_target(target: str) -> str:
    """Return the short name of any target, for folders: a name, the stem of a file, or `bunny-12-views`."""
    if is_image_target(target):
        return image_spec(target).label
    return target if target in NAMED_TARGETS else file_stem(target)


def path_of_images(target: str) -> str:
    """Return the path of the images of a target, or the name or path of the mesh that they show."""
    spec = image_spec(target)
    return spec.of if isinstance(spec, RenderedViews) else spec.images


def _value(kind: str, key: str, value: Any, type_of: type) -> Any:  # noqa: ANN401  any YAML value
    place = f"{kind}.{key}"
    if key == "kind":
        if value not in get_args(CameraKind):
            raise ViewError(f"{place}: got '{value}'; {suggest(str(value), get_args(CameraKind))}")
        return value
    if type_of is bool:
        known: dict[Any, bool] = {True: True, False: False, "true": True, "false": False}
        if not isinstance(value, bool | str) or value not in known:
            raise ViewError(f"{place}: expected true or false, got {value!r}")
        return known[value]
    if type_of is int:
        least, most = {"count": (1, _MOST_VIEWS), "size": (8, _LARGEST_SIZE)}.get(key, (0, _MOST_VIEWS))
        number = int(value) if isinstance(value, str) and value.isdecimal() else value
        if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
            raise ViewError(f"{place}: expected an integer from {least} to {most}, got {value!r}")
        return number
    if not isinstance(value, str):
        raise ViewError(f"{place}: expected text, got {value!r}")
    return value


def _text(kind: str, spec: ImageSpec, always: tuple[str, ...]) -> str:
    def word(value: object) -> str:
        return str(value).lower() if isinstance(value, bool) else str(value)

    fields = type(spec).__dataclass_fields__
    given = {key: getattr(spec, key) for key in fields if key in always or getattr(spec, key) != fields[key].default}
    return f"{kind}:" + ",".join(f"{key}={word(value)}" for key, value in given.items())
