"""glTF documents of meshes: triangles, and all that they carry that the format can hold."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.mesh.attributes import COLOR, GROUP, JOINTS, MATERIAL, WEIGHTS, Attributes, Values, is_uv
from meshfit.mesh.io.attribute_union import is_color
from meshfit.mesh.io.gltf_attributes import semantic_of, with_v_turned
from meshfit.mesh.io.gltf_buffer_writer import BufferWriter
from meshfit.mesh.io.gltf_materials import SUFFIX, MaterialWriter, image_kind
from meshfit.mesh.io.gltf_skins import SkinWriter
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.welding import first_equal

_MOST_COMPONENTS = 4
_CUSTOM_DTYPES = ("i1", "u1", "i2", "u2", "f4")


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
    pieces = list(_pieces(triangles, skin))
    for piece in pieces:
        node: dict[str, Any] = {"mesh": len(document["meshes"])}
        node |= {"name": piece.name} if piece.name else {}
        node |= {"skin": 0} if skin else {}
        document["scenes"][0]["nodes"].append(len(document["nodes"]))
        document["nodes"].append(node)
        document["meshes"].append(({"name": piece.name} if piece.name else {}) | {"primitives": _primitives(piece, buffer)})
    numbers: dict[int, int] = {}
    for mesh_entry in document["meshes"]:
        for primitive in mesh_entry["primitives"]:
            if "material" in primitive:
                given = primitive["material"]
                if given not in numbers:
                    numbers[given] = materials.write(carried.materials[given])
                primitive["material"] = numbers[given]
    if skin:
        skin.write(buffer, document)
    materials.finish()
    content = buffer.content
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": len(content)}]}
    return document | looks, content


def gltf_losses(mesh: Mesh | PolygonMesh) -> list[str]:
    """Return what a mesh carries that a glTF file does not hold, in words."""
    carried = mesh.attributes
    losses = [f"face data '{name}'" for name in carried.face if name not in (MATERIAL, GROUP) and not is_color(name)]
    for name in {**carried.vertex, **carried.corner}:
        places = [rows[name] for rows in (carried.corner, carried.vertex) if name in rows]
        if name in (JOINTS, WEIGHTS):
            continue
        if len(places) > 1:
            losses.append(f"vertex data '{name}' besides that of corners")
        if _encoded(name, places[0]) is None:
            losses.append(f"'{name}' of {places[0].dtype} in rows of {places[0].shape[1:] or 1}")
    for name in carried.face:
        if is_color(name) and (name in carried.vertex or name in carried.corner):
            losses.append(f"face data '{name}' besides that of vertices or corners")
    if carried.skin is not None and carried.skin.suffix != SUFFIX:
        losses.append("the skin")
    elif (JOINTS in carried.vertex or WEIGHTS in carried.vertex) and _skin_writer(carried) is None:
        losses.append("joints and weights without a skin")
    foreign = [material for material in carried.materials if material.definition and material.definition.suffix != SUFFIX]
    if foreign:
        losses.append("settings of materials other than colour and texture")
    for material in carried.materials:
        plain = material.definition is None or material.definition.suffix != SUFFIX
        if plain and material.texture is not None and not image_kind(material.texture):
            losses.append(f"the texture '{material.texture.name}', which is neither PNG nor JPEG")
    return list(dict.fromkeys(losses))


def _skin_writer(carried: Attributes) -> SkinWriter | None:
    joints, weights = (carried.vertex.get(name) for name in (JOINTS, WEIGHTS))
    if carried.skin is None or carried.skin.suffix != SUFFIX or joints is None or weights is None:
        return None
    if joints.ndim != 2 or joints.shape != weights.shape or joints.max(initial=0) >= len(carried.skin.content["joints"]):
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
    none = np.full(mesh.num_faces, -1)
    material = np.where(np.isin(carried.face.get(MATERIAL, none), range(len(carried.materials))), carried.face.get(MATERIAL, none), -1)
    group = np.where(np.isin(carried.face.get(GROUP, none), range(len(carried.groups))), carried.face.get(GROUP, none), -1)
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
        rows = {name: values.reshape(mesh.num_faces, 3, -1)[faces].reshape(len(corners), *values.shape[1:]) for name, values in corner.items()}
        split, origins, from_corner = _split(corners, rows, mesh.num_verts, keep_all=len(groups) == 1)
        data = {name: values[origins] for name, values in vertex.items()}
        for name, values in rows.items():
            data[name] = np.zeros((len(origins), *values.shape[1:]), values.dtype)
            data[name][from_corner >= 0] = values[from_corner[from_corner >= 0]]
        triangles, chosen = split.reshape(-1, 3), material[faces]
        by_material = {int(index): triangles[chosen == index] for index in _in_order(chosen)}
        name = carried.groups[number] if number >= 0 else ""
        yield _Piece(name, verts[origins], dict(sorted(data.items(), key=_order)), by_material)


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
    if values.ndim > 2 or name in (JOINTS, WEIGHTS) or values.dtype.kind not in "biuf":
        return None
    if is_uv(name):
        return with_v_turned(values[:, :2]).astype("<f4") if columns >= 2 else None
    if is_color(name):
        if columns not in (3, 4) or (values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16)):
            return None
        return values.astype("<f4" if values.dtype.kind == "f" else values.dtype.newbyteorder("<"))
    if not 1 <= columns <= _MOST_COMPONENTS:
        return None
    if values.dtype == np.bool_:
        return values.astype("u1")
    if values.dtype.str[1:] in _CUSTOM_DTYPES:
        return values.astype(values.dtype.newbyteorder("<"))
    single = values.astype("<f4")
    if values.dtype.kind in "iu" and not np.array_equal(single.astype(np.float64), values.astype(np.float64)):
        return None
    return single
