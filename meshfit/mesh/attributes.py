"""Attributes of a mesh: data of its vertices, faces and corners, materials, groups and a skin."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshfit.errors import MeshError
from meshfit.units import count_text

Values = NDArray[Any]
"""One row for each vertex, face or corner, of any numeric type."""

UV, COLOR, JOINTS, WEIGHTS, MATERIAL, GROUP = "uv", "color", "joints", "weights", "material", "group"
SUPPORTED = "supported"
"""Names with a meaning.

uv: (C, 2) of corners, texture coordinates with v upwards; `uv1`, `uv2` for further sets.
color: (·, 3) or (·, 4) of vertices, faces or corners: uint8, uint16, or floats from 0 to 1.
joints, weights: (V, J) of vertices: the joints of the skin that move a vertex, and by how much.
material: (F,) of faces, an index into `materials`; -1 for none.
group: (F,) of faces, an index into `groups`; -1 for none.
supported: (V,) of vertices and (F,) of faces of a result: 1 where the target shows a surface, 0 where it has a hole.
"""


_UV = re.compile(rf"{UV}\d*")


def is_uv(name: str) -> bool:
    """Return whether data of this name is a set of texture coordinates."""
    return _UV.fullmatch(name) is not None


@dataclass(frozen=True, eq=False)
class Image:
    """An image file that a material refers to.

    Attributes:
        name: its file name, which may be empty for one within a GLB.
        content: its bytes, as they are in the file.
    """

    name: str
    content: bytes = field(repr=False)


@dataclass(frozen=True, eq=False)
class MaterialDefinition:
    """A material in the words of its file format, for a file of the same format.

    Attributes:
        suffix: of the format: `.obj` for the lines of an MTL file, `.gltf` for the object of a glTF file.
        content: the definition; images are referred to by their index in `images`, or by their name in an MTL file.
        images: the images that it refers to.
    """

    suffix: str
    content: Any
    images: tuple[Image, ...] = ()


@dataclass(frozen=True, eq=False)
class Material:
    """The look of some faces.

    Attributes:
        name: its name in the file, which may be empty.
        color: red, green, blue and opacity, from 0 to 1, linear: glTF's base colour or MTL's `Kd` and `d`.
        texture: image of the base colour, if there is one.
        definition: all that its own format says of it.
    """

    name: str = ""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    texture: Image | None = None
    definition: MaterialDefinition | None = None


@dataclass(frozen=True, eq=False)
class Skin:
    """The joints that move a mesh, in the words of its file format.

    Attributes:
        suffix: of the format.
        content: the joints and their rest pose.
    """

    suffix: str
    content: Any


@dataclass(frozen=True, eq=False)
class Attributes:
    """Data that a mesh carries besides its shape. Arrays are read-only.

    Attributes:
        vertex: arrays by name, one row for each vertex.
        face: arrays by name, one row for each face.
        corner: arrays by name, one row for each corner of each face, in their order. Texture coordinates are held here;
            a seam is an edge whose two faces have different rows at an end.
        materials: what `face["material"]` counts.
        groups: names of what `face["group"]` counts.
        skin: what `vertex["joints"]` counts.

    Example:
        >>> import meshfit
        >>> import numpy as np
        >>> tetrahedron = meshfit.as_mesh("tetrahedron")
        >>> heat = meshfit.Attributes(vertex={"heat": np.array([0.0, 1.0, 1.0, 0.0])})
        >>> finer = meshfit.subdivide(tetrahedron.with_attributes(heat), "midpoint")
        >>> finer.attributes.vertex["heat"].tolist()
        [0.0, 1.0, 1.0, 0.0, 0.5, 0.5, 0.0, 1.0, 0.5, 0.5]
    """

    vertex: Mapping[str, Values] = field(default_factory=dict)
    face: Mapping[str, Values] = field(default_factory=dict)
    corner: Mapping[str, Values] = field(default_factory=dict)
    materials: tuple[Material, ...] = ()
    groups: tuple[str, ...] = ()
    skin: Skin | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in ("vertex", "face", "corner"):
            rows = {key: _read_only(values) for key, values in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(rows))

    def __bool__(self) -> bool:
        """Return whether there is anything."""
        return bool(self.vertex or self.face or self.corner)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the attributes again in another process; a read-only mapping cannot be sent."""
        return Attributes, (*map(dict, (self.vertex, self.face, self.corner)), self.materials, self.groups, self.skin)

    def without(self, name: str) -> "Attributes":
        """Return all but the data of vertices, faces and corners of this name."""
        vertex, face, corner = (
            {key: values for key, values in rows.items() if key != name}
            for rows in (self.vertex, self.face, self.corner)
        )
        return replace(self, vertex=vertex, face=face, corner=corner)

    @property
    def num_values(self) -> int:
        """The number of numbers in all arrays."""
        return sum(values.size for rows in (self.vertex, self.face, self.corner) for values in rows.values())

    def described(self) -> list[str]:
        """Return what there is in words: `texture coordinates`, `colours`, `2 materials`.

        One group or material without a look that all faces share says nothing, and is not named.
        """
        names = [*self.vertex, *self.face, *self.corner]
        words = {
            "texture coordinates": any(map(is_uv, names)),
            "colours": COLOR in self.vertex,
            "colours of faces": COLOR in self.face,
            "colours of corners": COLOR in self.corner,
            count_text(len(self.materials), "material"): MATERIAL in self.face and self._tells_faces_apart(MATERIAL),
            count_text(len(self.groups), "group"): GROUP in self.face and self._tells_faces_apart(GROUP),
            "skin weights": bool({JOINTS, WEIGHTS} & self.vertex.keys()),
        }
        known = {COLOR, MATERIAL, GROUP, JOINTS, WEIGHTS}
        others = [f"'{name}'" for name in dict.fromkeys(names) if name not in known and not is_uv(name)]
        return [*(text for text, is_there in words.items() if is_there), *others]

    def _tells_faces_apart(self, name: str) -> bool:
        numbers = self.face[name]
        has_look = name == MATERIAL and any(material.definition or material.texture for material in self.materials)
        return has_look or bool((numbers != numbers[:1]).any())

    def require_sizes(self, num_verts: int, num_faces: int, num_corners: int) -> None:
        """Check that each array has one row per vertex, face or corner.

        Raises:
            MeshError: an array of another length, by name.
        """
        for rows, count, noun in (
            (self.vertex, num_verts, "vertex"),
            (self.face, num_faces, "face"),
            (self.corner, num_corners, "corner"),
        ):
            for name, values in rows.items():
                if values.ndim == 0 or len(values) != count:
                    shape = values.shape
                    raise MeshError(f"{noun} data '{name}': expected {count_text(count, 'row')}, got shape {shape}")

    def selected(self, verts: ArrayLike, faces: ArrayLike, corners: ArrayLike) -> "Attributes":
        """Return the attributes of a mesh whose elements come from elements of this one.

        Args:
            verts: index here of each vertex of the other mesh.
            faces: index here of each of its faces.
            corners: index here of each of its corners.
        """
        return replace(
            self,
            vertex={name: values[np.asarray(verts)] for name, values in self.vertex.items()},
            face={name: values[np.asarray(faces)] for name, values in self.face.items()},
            corner={name: values[np.asarray(corners)] for name, values in self.corner.items()},
        )


def _read_only(values: ArrayLike) -> Values:
    array = np.array(values)
    array.setflags(write=False)
    return array


NO_ATTRIBUTES = Attributes()
