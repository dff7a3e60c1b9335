"""3MF files: a ZIP archive of objects, components and build items."""

import io
import re
import warnings
import zipfile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.placement import Matrix, PlacedMeshes
from meshfit.mesh.io.xml_elements import (
    Element,
    attribute,
    child,
    children,
    integer_attribute,
    numbers,
    parse_xml,
    require_finite_rows,
    shown,
)
from meshfit.mesh.polygons import PolygonSoup
from meshfit.units import count_text

_MODEL = "3D/3dmodel.model"
_MILLIMETRES = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1e3}
# Extensions that leave the triangles as they are, by a part of their namespace.
_NEUTRAL = ("/production/", "/material/", "/slice/", "/trianglesets/", "/core/")
_UNREAD = {"materials": "basematerials", "colours": "colorgroup", "textures": "texture2dgroup"}
"""Elements that give triangles a look, by what they are in words."""
_FREE_BYTES = 16_000_000
_BYTES_PER_PACKED_BYTE = 100

_Key = tuple[str, int]


class _Use(NamedTuple):
    """An object that a build item or a component uses, and its transform."""

    key: _Key
    transform: Matrix


class _Object(NamedTuple):
    """A mesh, or the objects that make it up."""

    mesh: PolygonSoup | None
    components: list[_Use]


def read_3mf(content: bytes, *, attributes: bool = False) -> PolygonSoup:
    """Read the triangles of the build items of a 3MF file, in its unit.

    A file without build items gives each object that no other uses.

    Args:
        content: of the file.
        attributes: warn of materials, colours and textures, which are not read.

    Raises:
        MeshError: a damaged file, or a required extension that is not supported.

    Warns:
        MeshfitWarning: with the number of objects that the build does not use; of materials, if that is wanted.
    """
    package = _Package(content)
    root = package.root_part()
    model = package.model(root)
    items = [package.use(item, root, "item") for build in children(model, "build") for item in children(build, "item")]
    placed = PlacedMeshes()
    used: set[_Key] = set()
    for item in items or package.unused_objects():
        _place(package, item, placed, used)
    if unused := len([key for key, thing in package.objects.items() if thing.mesh is not None and key not in used]):
        objects = count_text(unused, "object")
        warnings.warn(f"passed over {objects} that the build does not use", MeshfitWarning, stacklevel=2)
    if attributes and (unread := package.unread):
        warnings.warn(f"{', '.join(unread)} are not read from 3MF", MeshfitWarning, stacklevel=2)
    return placed.soup()


def _place(package: "_Package", item: _Use, placed: PlacedMeshes, used: set[_Key]) -> None:
    """Place the meshes of an item, through all components."""
    waiting: list[tuple[_Use, tuple[_Key, ...]]] = [(item, ())]
    while waiting:
        (key, transform), above = waiting.pop()
        if key in above:
            raise MeshError(f"object {key[1]} is a component of itself")
        thing = package.object(key)
        used.add(key)
        placed.spend(0, package.num_bytes)
        if thing.mesh is not None:
            placed.place(thing.mesh, transform, package.num_bytes)
        waiting += [
            (_Use(component.key, transform @ component.transform), (*above, key))
            for component in thing.components[::-1]
        ]


class _Package:
    """The archive, and the objects of those of its models that were read."""

    def __init__(self, content: bytes) -> None:
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(content))
            self._members = {info.filename.lstrip("/").lower(): info for info in self._archive.infolist()}
        except Exception:  # noqa: BLE001 - whatever a damaged archive causes
            raise MeshError("expected a ZIP archive, got other or damaged data") from None
        self.num_bytes = len(content)
        self.objects: dict[_Key, _Object] = {}
        self._models: dict[str, Element] = {}
        self._scale = 1.0

    def root_part(self) -> str:
        """Return the name of the model that the archive's relations name, or of its only one."""
        if "_rels/.rels" in self._members:
            relations = parse_xml(self._read("_rels/.rels"), "Relationships", "_rels/.rels: ")
            for relation in children(relations, "Relationship"):
                if (attribute(relation, "Type") or "").endswith("/3dmodel"):
                    return (attribute(relation, "Target") or "").lstrip("/").lower()
        models = [name for name in self._members if name.endswith(".model")]
        if _MODEL.lower() in models or len(models) != 1:
            return _MODEL.lower()
        return models[0]

    def model(self, part: str) -> Element:
        """Return the root element of a model, and add its objects."""
        if part not in self._models:
            content = self._read(part)
            model = parse_xml(content, "model", f"{part}: ")
            _require_extensions(model, content)
            unit = attribute(model, "unit") or "millimeter"
            if unit not in _MILLIMETRES:
                raise MeshError(f"{part}: expected a unit of {', '.join(_MILLIMETRES)}, got {shown(unit)}")
            if not self._models:
                self._scale = _MILLIMETRES[unit]
            self._models[part] = model
            for resources in children(model, "resources"):
                for element in children(resources, "object"):
                    self._add_object(element, part, _MILLIMETRES[unit] / self._scale)
        return self._models[part]

    @property
    def unread(self) -> list[str]:
        """The kinds of properties of triangles in the models that were read, in words."""
        groups = [group for model in self._models.values() for group in children(model, "resources")]
        return [words for words, name in _UNREAD.items() if any(child(group, name) is not None for group in groups)]

    def object(self, key: _Key) -> _Object:
        """Return an object of a model, which is read if it was not yet."""
        self.model(key[0])
        if key not in self.objects:
            raise MeshError(f"{key[0]}: there is no object {key[1]}, which the build or a component names")
        return self.objects[key]

    def unused_objects(self) -> list[_Use]:
        """Return the objects that are a component of no other."""
        components = {component.key for thing in self.objects.values() for component in thing.components}
        return [_Use(key, np.eye(4)) for key in self.objects if key not in components]

    def use(self, element: Element, part: str, kind: str) -> _Use:
        """Return the object that a build item or a component uses."""
        path = attribute(element, "path")
        key = ((path or part).lstrip("/").lower(), integer_attribute(element, "objectid", f"{part}: {kind}"))
        return _Use(key, _transform(element.get("transform"), f"{part}: {kind} of object {key[1]}"))

    def _add_object(self, element: Element, part: str, scale: float) -> None:
        number = integer_attribute(element, "id", f"{part}: object")
        if (part, number) in self.objects:
            raise MeshError(f"{part}: two objects {number}")
        mesh, components = child(element, "mesh"), child(element, "components")
        uses = (
            [self.use(one, part, "component") for one in children(components, "component")]
            if components is not None
            else []
        )
        if mesh is not None and child(mesh, "beamlattice") is not None:
            raise MeshError(
                f"{part}: object {number} is a beam lattice, which is not supported; export it as triangles"
            )
        soup = None if mesh is None else _mesh(mesh, f"{part}: object {number}")
        if soup is not None and scale != 1:
            soup = soup._replace(verts=soup.verts * scale)
        scaled = [use._replace(transform=_scaled_shift(use.transform, scale)) for use in uses]
        self.objects[part, number] = _Object(soup, scaled)

    def _read(self, part: str) -> bytes:
        info = self._members.get(part)
        if info is None:
            raise MeshError(f"its archive has no member {shown(part)}")
        limit = _FREE_BYTES + _BYTES_PER_PACKED_BYTE * self.num_bytes
        if info.file_size > limit:
            raise MeshError(f"its archive member {shown(part)} expands to {info.file_size} bytes, implausibly many")
        try:
            return self._archive.read(info)
        except Exception:  # noqa: BLE001 - whatever a damaged archive causes
            raise MeshError(f"its archive member {shown(part)} is damaged or encrypted") from None


def _require_extensions(model: Element, content: bytes) -> None:
    """Refuse a required extension that adds to the triangles or changes them."""
    spaces = {
        match[1].decode("ascii", "replace"): match[2].decode("ascii", "replace")
        for match in re.finditer(rb"""xmlns:(\w+)\s*=\s*["']([^"']*)["']""", content[:20_000])
    }
    for prefix in (model.get("requiredextensions") or "").split():
        space = spaces.get(prefix, prefix)
        if not any(part in space for part in _NEUTRAL):
            raise MeshError(f"requires the extension {shown(space)}, which is not supported; export plain triangles")


def _mesh(mesh: Element, place: str) -> PolygonSoup:
    verts, triangles = child(mesh, "vertices"), child(mesh, "triangles")
    points = _rows(verts, "vertex", ("x", "y", "z"), np.float64, place)
    corners = _rows(triangles, "triangle", ("v1", "v2", "v3"), np.int64, place)
    require_finite_rows(points, f"{place}: vertex")
    outside = np.flatnonzero(((corners < 0) | (corners >= len(points))).any(axis=1))
    if len(outside):
        bad = int(outside[0])
        raise MeshError(
            f"{place}: triangle {bad} is {corners[bad].tolist()}, but the object has {len(points)} vertices"
        )
    return PolygonSoup.of_triangles(points, corners)


def _rows(
    parent: Element | None, name: str, keys: tuple[str, str, str], dtype: type[np.generic], place: str
) -> NDArray[Any]:
    """Return (N, 3) three attributes of all children with a name."""
    elements = [] if parent is None else list(children(parent, name))
    try:
        rows = [element.attrib[key] for element in elements for key in keys]
    except KeyError:
        bad = next(number for number, element in enumerate(elements) if not set(keys) <= set(element.attrib))
        raise MeshError(f"{place}: {name} {bad} lacks one of {', '.join(keys)}") from None
    try:
        return np.array(rows, dtype=dtype).reshape(-1, 3)
    except (ValueError, OverflowError):
        for number, element in enumerate(elements):
            for key in keys:
                numbers(element.attrib[key], dtype, f"{place}: {key} of {name} {number}")
        raise MeshError(f"{place}: expected one number in each of {', '.join(keys)}") from None


def _transform(text: str | None, place: str) -> Matrix:
    """Return a transform of columns; in the file, four rows follow one another, as points are rows there."""
    matrix = np.eye(4)
    if text is None:
        return matrix
    values = numbers(text, np.float64, place)
    if len(values) != 12 or not np.isfinite(values).all():
        raise MeshError(f"{place}: expected a transform of 12 finite numbers, got {len(values)} numbers")
    matrix[:3] = values.reshape(4, 3).T
    return matrix


def _scaled_shift(transform: Matrix, scale: float) -> Matrix:
    scaled = transform.copy()
    scaled[:3, 3] *= scale
    return scaled
