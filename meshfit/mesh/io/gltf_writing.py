"""glTF documents of meshes: triangles, and all that they carry that the format can hold."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.mesh.attributes import GROUP, JOINTS, MATERIAL, WEIGHTS, Attributes, Material, Values, is_uv
from meshfit.mesh.io.attribute_union import is_color
from meshfit.mesh.io.gltf_attributes import semantic_of, with_v_turned
from meshfit.mesh.io.gltf_buffer_writer import BufferWriter
from meshfit.mesh.io.gltf_materials import MaterialWriter, image_kind, is_gltf
from meshfit.mesh.io.gltf_skins import SUFFIX, SkinWriter
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.welding import first_equal
from meshfit.units import count_text

_MOST_COMPONENTS = 4
_ALLOWED = ("i1", "u1", "i2", "u2", "f4")


class _Piece(NamedTuple):
    """Faces that become one node: its name, the vertices, their data by glTF name, and the triangles of each material.

    A vertex of the mesh at whose corners data differs is there more than once.
    """

    name: str
    verts: NDArray[np.float32]
    data: Mapping[str, NDArray[Any]]
    triangles: Mapping[int, NDArray[np.int64]]


def gltf_document(mesh: Mesh | PolygonMesh) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the buffer of a file with the triangles of a mesh, and with what it carries.

    Each group of faces is a node, each material a primitive. Vertices at seams are repeated.
    """
    triangles = PolygonMesh.of(mesh).triangulated()
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "meshfit"}}
    if not triangles.num_faces:
        return document, b""
    buffer, looks = BufferWriter(), dict[str, Any]()
    carried = triangles.attributes
    skin = _skin_writer(carried)
    materials = MaterialWriter(buffer, looks)
    document |= {"scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": []}
    for piece in _pieces(triangles, skin):
        named = {"name": piece.name} if piece.name else {}
        node = {"mesh": len(document["meshes"]), **named, **({"skin": 0} if skin else {})}
        document["scenes"][0]["nodes"].append(len(document["nodes"]))
        document["nodes"].append(node)
        document["meshes"].append(named | {"primitives": _primitives(piece, buffer)})
    for material in carried.materials:
        materials.write(material)
    if skin:
        skin.write(buffer, document)
    materials.finish()
    content = buffer.content
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": len(content)}]}
    return document | looks, content


def left_out_of_gltf(mesh: Mesh | PolygonMesh) -> list[str]:
    """Return what a mesh carries that a glTF file does not hold, in words."""
    carried = mesh.attributes
    losses = [f"face data '{name}'" for name in carried.face if name not in (MATERIAL, GROUP) and not is_color(name)]
    held = {**carried.vertex, **carried.corner}
    data = {name: values for name, values in held.items() if name not in (JOINTS, WEIGHTS)}
    losses += [_data_text(name, values) for name, values in data.items() if _encoded(name, values) is None]
    losses += [f"vertex data '{name}' besides that of corners" for name in carried.vertex if name in carried.corner]
    losses += [f"face data '{name}' besides that of vertices or corners" for name in carried.face if name in held]
    if (carried.skin or held.keys() & {JOINTS, WEIGHTS}) and _skin_writer(carried) is None:
        losses.append("the skin" if carried.skin else "joints and weights without a skin")
    foreign = [material for material in carried.materials if not is_gltf(material)]
    others = [material for material in foreign if _further_images(material)]
    if others:
        losses.append(f"further images of {count_text(len(others), 'material')}")
    textures = [material.texture for material in foreign if material.texture and not image_kind(material.texture)]
    losses += [f"the texture '{texture.name}', which is neither PNG nor JPEG" for texture in textures]
    return list(dict.fromkeys(losses))


def _further_images(material: Material) -> bool:
    """Return whether the definition of a material has images besides that of its base colour."""
    images = material.definition.images if material.definition else ()
    return len(images) > (material.texture is not None)


def _data_text(name: str, values: Values) -> str:
    columns = f" in rows of {values.shape[1]}" if values.ndim == 2 else ""
    return f"'{name}' ({values.dtype}{columns})"


def _skin_writer(carried: Attributes) -> SkinWriter | None:
    joints, weights = (carried.vertex.get(name) for name in (JOINTS, WEIGHTS))
    if carried.skin is None or carried.skin.suffix != SUFFIX or joints is None or weights is None:
        return None
    if (
        joints.ndim != 2
        or joints.shape != weights.shape
        or joints.max(initial=0) >= len(carried.skin.content["joints"])
    ):
        return None
    return SkinWriter(carried.skin, joints, weights)


def _primitives(piece: _Piece, buffer: BufferWriter) -> list[dict[str, Any]]:
    attributes = {"POSITION": buffer.vertex_accessor(piece.verts, box=True)}
    for name, values in piece.data.items():
        normalized = name.startswith("COLOR_") and values.dtype.kind == "u"
        attributes[name] = buffer.vertex_accessor(values, normalized=normalized)
    # The largest 16-bit number restarts a strip, and may not be an index.
    dtype = "<u2" if len(piece.verts) < 2**16 else "<u4"
    return [
        {"attributes": attributes, "indices": buffer.index_accessor(triangles.astype(dtype))}
        | ({"material": material} if material >= 0 else {})
        for material, triangles in piece.triangles.items()
    ]


def _pieces(mesh: Mesh, skin: SkinWriter | None) -> Iterator[_Piece]:
    """Yield the faces of each group, those of none last."""
    carried = mesh.attributes
    material = _numbers(mesh, MATERIAL, len(carried.materials))
    group = _numbers(mesh, GROUP, len(carried.groups))
    of_verts = {name: rows for name, values in carried.vertex.items() if (rows := _encoded(name, values)) is not None}
    of_corners = {name: rows for name, values in carried.corner.items() if (rows := _encoded(name, values)) is not None}
    for name, values in carried.face.items():
        if is_color(name) and name not in of_verts | of_corners and (rows := _encoded(name, values)) is not None:
            of_corners[name] = np.repeat(rows, 3, axis=0)
    vertex = {semantic_of(name): rows for name, rows in of_verts.items() if name not in of_corners}
    vertex |= skin.attributes() if skin else {}
    corner = {semantic_of(name): rows for name, rows in of_corners.items()}
    verts = mesh.verts.astype("<f4")
    groups = np.unique(group).tolist()
    for number in [*(number for number in groups if number >= 0), *(number for number in groups if number < 0)]:
        faces = np.flatnonzero(group == number)
        corners = mesh.faces[faces].reshape(-1)
        places = (3 * faces[:, None] + np.arange(3)).reshape(-1)
        at_corners = {name: values[places] for name, values in corner.items()}
        split, origins, from_corner = _split(corners, at_corners, mesh.num_verts, keep_all=len(groups) == 1)
        data = {name: values[origins] for name, values in vertex.items()}
        for name, values in at_corners.items():
            data[name] = np.zeros((len(origins), *values.shape[1:]), values.dtype)
            data[name][from_corner >= 0] = values[from_corner[from_corner >= 0]]
        triangles, chosen = split.reshape(-1, 3), material[faces]
        by_material = {int(index): triangles[chosen == index] for index in _in_order(chosen)}
        name = carried.groups[number] if number >= 0 else ""
        yield _Piece(name, verts[origins], dict(sorted(data.items(), key=_order)), by_material)


def _numbers(mesh: Mesh, name: str, count: int) -> NDArray[np.int64]:
    """Return the material or group of each face; -1 for none, and for one that does not exist."""
    numbers = np.asarray(mesh.attributes.face.get(name, np.full(mesh.num_faces, -1)), dtype=np.int64)
    return np.where((numbers >= 0) & (numbers < count), numbers, -1)


def _split(
    corners: NDArray[np.int64], rows: Mapping[str, NDArray[Any]], num_verts: int, *, keep_all: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Repeat each vertex whose corners have different rows.

    The first of its vertices has its place in the order of the mesh, the others follow at the end.

    Args:
        corners: (C,) vertices of the mesh.
        rows: data of the corners.
        num_verts: of the mesh.
        keep_all: keep vertices of no corner too.

    Returns:
        (C,) new vertices of the corners; (N,) the vertex that each new one comes from, and a corner that has its data,
        -1 for a vertex of no corner.
    """
    columns = [corners[:, None], *(_bits(values) for values in rows.values())]
    first = first_equal(np.concatenate(columns, axis=1)) if rows else _first_of(corners, num_verts)
    found = np.unique(first)
    used, of_used = np.unique(corners[found], return_index=True)
    kept = np.arange(num_verts) if keep_all else used
    further = np.delete(found, of_used)
    from_corner = np.full(len(kept), -1)
    from_corner[np.searchsorted(kept, used)] = found[of_used]
    from_corner = np.concatenate([from_corner, further])
    number = np.empty(len(corners), dtype=np.int64)
    number[from_corner[from_corner >= 0]] = np.flatnonzero(from_corner >= 0)
    return number[first], np.concatenate([kept, corners[further]]), from_corner


def _first_of(corners: NDArray[np.int64], num_verts: int) -> NDArray[np.int64]:
    first = np.empty(num_verts, dtype=np.int64)
    first[corners[::-1]] = np.arange(len(corners))[::-1]
    return first[corners]


def _bits(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return (N, C) integers that are equal where numbers are; 0.0 equals -0.0."""
    table = values[:, None] if values.ndim == 1 else values
    return (table + np.float32(0)).view("<i4").astype(np.int64) if table.dtype.kind == "f" else table.astype(np.int64)


def _in_order(materials: NDArray[np.int64]) -> list[int]:
    """Return the materials, in the order of their numbers, none last."""
    found: list[int] = np.unique(materials).tolist()
    return [index for index in found if index >= 0] + [index for index in found if index < 0]


def _order(item: tuple[str, object]) -> tuple[int, str]:
    kinds = ("TEXCOORD", "COLOR", "JOINTS", "WEIGHTS")
    start = item[0].partition("_")[0]
    return (kinds.index(start) if start in kinds else len(kinds), item[0])


def _encoded(name: str, values: Values) -> NDArray[Any] | None:
    """Return data in a type that glTF allows; None if there is none for it."""
    columns = values.shape[1] if values.ndim > 1 else 1
    kind = values.dtype.kind
    if values.ndim > 2 or name in (JOINTS, WEIGHTS) or kind not in "biuf":
        return None
    if is_uv(name):
        return with_v_turned(values[:, :2]).astype("<f4") if columns >= 2 else None
    if is_color(name) and (columns not in (3, 4) or (kind != "f" and values.dtype not in (np.uint8, np.uint16))):
        return None
    return _in_allowed_type(values) if 1 <= columns <= _MOST_COMPONENTS else None


def _in_allowed_type(values: Values) -> NDArray[Any] | None:
    if values.dtype == np.bool_:
        return values.astype("u1")
    if values.dtype.str[1:] in _ALLOWED:
        return values.astype(values.dtype.newbyteorder("<"))
    single = values.astype("<f4")
    exact = values.dtype.kind == "f" or np.array_equal(single.astype(np.float64), values.astype(np.float64))
    return single if exact else None
