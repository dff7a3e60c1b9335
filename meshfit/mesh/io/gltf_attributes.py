"""Texture coordinates, colours and custom data of glTF primitives, and the names that they have in a mesh."""

import re

import numpy as np

from meshfit.errors import MeshError
from meshfit.mesh.attributes import COLOR, MATERIAL, UV, Attributes, Values, is_uv
from meshfit.mesh.io.attribute_union import is_color, is_reserved
from meshfit.mesh.io.gltf_primitives import Primitive

_SET = re.compile(r"(TEXCOORD|COLOR)_(\d{1,3})")
_NAMES = {"TEXCOORD": UV, "COLOR": COLOR}
_ANY = ("SCALAR", "VEC2", "VEC3", "VEC4")
_KINDS = {"TEXCOORD": ("VEC2",), "COLOR": ("VEC3", "VEC4")}


def attribute_name(semantic: str) -> str | None:
    """Return the name in a mesh of a glTF attribute such as `TEXCOORD_0`; None for one that is not kept.

    A custom attribute loses its underscore, unless what is left has a meaning of its own.
    """
    if match := _SET.fullmatch(semantic):
        number = int(match[2])
        return _NAMES[match[1]] + (str(number) if number else "")
    if semantic.startswith("_"):
        name = semantic[1:]
        return semantic if not name or is_reserved(name) else name
    return None


def semantic_of(name: str) -> str:
    """Return the name in a glTF file of texture coordinates, colours or custom data of a mesh."""
    for semantic, start in _NAMES.items():
        if is_uv(name) if start == UV else is_color(name):
            return f"{semantic}_{name[len(start) :] or 0}"
    return f"_{name}"


def with_v_turned(values: Values) -> Values:
    """Return texture coordinates with v counted from the other end: glTF's points down, that of a mesh up.

    In double precision, this loses nothing of single precision there and back.
    """
    turned = np.array(values, dtype=np.float64)
    turned[:, 1] = 1 - turned[:, 1]
    return turned


def read_attributes(
    primitive: Primitive, num_verts: int, num_faces: int, material: int
) -> tuple[Attributes, list[str]]:
    """Return what the vertices and faces of a primitive carry, and the faults for which some of it is left out.

    Args:
        primitive: of the file.
        num_verts: the number of its vertices.
        num_faces: the number of its triangles.
        material: of its faces, -1 for none.
    """
    vertex: dict[str, Values] = {}
    faults = []
    for semantic in primitive.names():
        name = attribute_name(semantic)
        if name is None:
            continue
        try:
            vertex[name] = _values(primitive, semantic, num_verts)
        except MeshError as fault:
            faults.append(str(fault))
    return Attributes(vertex=vertex, face={MATERIAL: np.full(num_faces, material)}), faults


def _values(primitive: Primitive, semantic: str, num_verts: int) -> Values:
    kind = semantic.partition("_")[0]
    values = primitive.attribute(semantic, *_KINDS.get(kind, _ANY), raw=kind == "COLOR")
    if values is None:
        raise MeshError(f"{primitive.place}.attributes.{semantic}: expected an accessor")
    if len(values) != num_verts:
        raise MeshError(f"{primitive.place}.attributes.{semantic}: {len(values)} rows for {num_verts} vertices")
    if kind == "TEXCOORD":
        return with_v_turned(values)
    if kind == "COLOR":
        if values.dtype not in (np.uint8, np.uint16, np.float32):
            raise MeshError(f"{primitive.place}.attributes.{semantic}: expected colours of type 5121, 5123 or 5126")
        return values
    if values.dtype == np.float64:  # normalized
        values = values.astype(np.float32)
    return values[:, 0] if values.shape[1] == 1 else values
