"""Numbers of a glTF file: buffers, buffer views and accessors, plain or compressed."""

import base64
import binascii
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError
from meshfit.mesh.io.json_objects import JsonObject

Bytes = NDArray[np.uint8]
Numbers = NDArray[Any]

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
WITHOUT_COMPRESSION = "export the file without mesh compression"

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_INDEX_DTYPES = {number: name for number, name in _DTYPES.items() if "u" in name}
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")
# An accessor without data has zeros, and a compressed one can be long: both may announce this much for nothing.
_FREE_BYTES = 1_000_000
_BYTES_PER_COMPRESSED_BYTE = 1024


class Document:
    """A glTF file: its JSON, its binary chunk, and the folder of the files beside it.

    Args:
        root: the JSON.
        binary: the BIN chunk of a GLB file.
        folder: of the file; None where it is not known, as on standard input.
    """

    def __init__(self, root: JsonObject, binary: bytes | None, folder: Path | None) -> None:
        self.root = root
        self.binary = binary
        self._folder = folder
        self._lists: dict[str, list[JsonObject]] = {}
        self._buffers: dict[int, Bytes] = {}
        self._views: dict[int, tuple[Bytes, int]] = {}

    @property
    def num_bytes(self) -> int:
        """The size of all buffers that were read."""
        return sum(map(len, self._buffers.values()))

    def items(self, kind: str) -> list[JsonObject]:
        """Return all `meshes`, all `nodes` and so on."""
        if kind not in self._lists:
            self._lists[kind] = self.root.objects(kind)
        return self._lists[kind]

    def item(self, kind: str, index: int, place: str) -> JsonObject:
        """Return one of the `meshes`, `nodes` and so on, to which `place` refers.

        Raises:
            MeshError: it does not exist.
        """
        items = self.items(kind)
        if index >= len(items):
            raise MeshError(f"{place} refers to {kind}[{index}], but the file has {len(items)} {kind}")
        return items[index]

    def accessor(self, index: int, place: str, *kinds: str, raw: bool = False) -> Numbers:
        """Return (N, C) the elements of an accessor, float64 where it is normalized, else in the type of the file.

        Args:
            index: of the accessor.
            place: that refers to it.
            kinds: SCALAR, VEC3, …, of which the accessor has to be one.
            raw: leave normalized numbers in the type of the file too.

        Raises:
            MeshError: another kind, no data, or data that reaches out of its buffer.
        """
        accessor = self.item("accessors", index, place)
        found = accessor.text("type")
        if found not in kinds:
            expected = " or ".join(kinds)
            raise MeshError(
                f"{place}: expected an accessor of type {expected}, got accessors[{index}] of type {found[:20]}"
            )
        dtype = _dtype(accessor, _DTYPES)
        count, components = accessor.integer("count", least=1), COMPONENTS[found]
        sparse = accessor.member("sparse")
        if "bufferView" in accessor:
            values = self._elements(accessor, count, components, dtype)
        elif sparse is None:
            raise MeshError(f"accessors[{index}] has no data: neither 'bufferView' nor 'sparse'")
        else:
            _require_cheap(count * components * 8, _FREE_BYTES, accessor.place)
            values = np.zeros((count, components), dtype)
        if sparse is not None:
            values = self._with_sparse(values, sparse)
        return dequantized(values) if accessor.flag("normalized") and not raw else values

    def view(self, index: int, place: str) -> tuple[Bytes, int]:
        """Return the bytes of a buffer view and its stride, 0 for none; decode a compressed one."""
        if index not in self._views:
            self._views[index] = self._read_view(self.item("bufferViews", index, place))
        return self._views[index]

    def uri_content(self, uri: str, place: str) -> tuple[bytes, str]:
        """Return the bytes that a URI of a buffer or an image stands for, and their source in words."""
        if uri.startswith("data:"):
            return _data_uri(uri, place), "its data URI"
        path = buffer_path(uri, self._folder, place)
        try:
            return path.read_bytes(), f"'{path.name}'"
        except OSError as error:
            raise MeshError(f"{place}: {path} cannot be read: {error.strerror}") from None

    def _elements(self, owner: JsonObject, count: int, components: int, dtype: np.dtype[Any]) -> Numbers:
        index = owner.integer("bufferView")
        content, stride = self.view(index, owner.place)
        offset, size = owner.integer("byteOffset", 0), components * dtype.itemsize
        stride = stride or size
        if stride < size:
            raise MeshError(
                f"bufferViews[{index}].byteStride is {stride}, but {owner.place} has elements of {size} bytes"
            )
        end = offset + stride * (count - 1) + size
        if end > len(content):
            raise MeshError(f"{owner.place} ends at byte {end} of bufferViews[{index}], which has {len(content)} bytes")
        return np.ndarray((count, components), dtype, content, offset, (stride, dtype.itemsize)).copy()

    def _with_sparse(self, values: Numbers, sparse: JsonObject) -> Numbers:
        count = sparse.integer("count", least=1)
        indices, replacing = sparse.member("indices"), sparse.member("values")
        if indices is None or replacing is None or count > len(values):
            raise MeshError(f"{sparse.place}: expected 'indices' and 'values' of at most {len(values)} elements")
        rows = self._elements(indices, count, 1, _dtype(indices, _INDEX_DTYPES))[:, 0].astype(np.int64)
        if rows[-1] >= len(values) or (np.diff(rows) <= 0).any():
            raise MeshError(f"{indices.place}: expected increasing indices below {len(values)}")
        values[rows] = self._elements(replacing, count, values.shape[1], values.dtype)
        return values

    def _read_view(self, view: JsonObject) -> tuple[Bytes, int]:
        extensions = view.member("extensions")
        for name in MESHOPT:
            compressed = extensions.member(name) if extensions else None
            if compressed is not None and not self._has_data(view.integer("buffer")):
                return _decoded_meshopt(self._slice(compressed), compressed, name)
        return self._slice(view), view.integer("byteStride", 0)

    def _slice(self, view: JsonObject) -> Bytes:
        index = view.integer("buffer")
        content = self._buffer(index, view.place)
        start, length = view.integer("byteOffset", 0), view.integer("byteLength", least=1)
        if start + length > len(content):
            raise MeshError(
                f"{view.place} ends at byte {start + length} of buffers[{index}], which has {len(content)} bytes"
            )
        return content[start : start + length]

    def _has_data(self, index: int) -> bool:
        buffer = self.item("buffers", index, "a buffer view")
        extensions = buffer.member("extensions")
        fallback = extensions is not None and any(name in extensions for name in MESHOPT)
        return "uri" in buffer or (index == 0 and self.binary is not None and not fallback)

    def _buffer(self, index: int, place: str) -> Bytes:
        if index not in self._buffers:
            buffer = self.item("buffers", index, place)
            length = buffer.integer("byteLength", least=1)
            content, source = self._content(buffer, index)
            if len(content) < length:
                raise MeshError(f"{buffer.place} announces {length} bytes, but {source} has {len(content)}")
            self._buffers[index] = np.frombuffer(content, np.uint8, length)
        return self._buffers[index]

    def _content(self, buffer: JsonObject, index: int) -> tuple[bytes, str]:
        if "uri" in buffer:
            return self.uri_content(buffer.text("uri"), buffer.place)
        if index == 0 and self.binary is not None:
            return self.binary, "the BIN chunk"
        raise MeshError(f"{buffer.place} has no data: no 'uri', and no BIN chunk of a GLB file")


def buffer_path(uri: str, folder: Path | None, place: str) -> Path:
    """Return the path of the file of a buffer or an image, which is in the folder of the glTF file or below it.

    Raises:
        MeshError: another place, no folder, or no such file.
    """
    name = unquote(uri)
    shown = repr(name if len(name) <= 60 else name[:59] + "…")
    parts = name.replace("\\", "/").split("/")
    if _SCHEME.match(name) or not parts[0] or ".." in parts or "\0" in name:
        raise MeshError(f"{place}.uri: expected a file in the folder of the mesh, got {shown}")
    if folder is None:
        raise MeshError(f"{place}.uri: the file {shown} is in the folder of the mesh, which is not known here")
    for path in (folder / name, folder / uri):
        try:
            if path.is_file():
                return path
        except OSError:  # a name too long
            continue
    raise MeshError(f"{place}: its file {shown} is missing in {folder}")


def dequantized(values: Numbers) -> Numbers:
    """Return normalized integers as float64, from -1 or 0 to 1; other numbers as they are."""
    if values.dtype.kind not in "iu":
        return values
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def decoded_draco(content: Bytes, ids: dict[str, int], place: str) -> tuple[dict[str, Numbers], NDArray[np.int64]]:
    """Return the attributes, by name, and the triangles of a mesh that Draco compressed.

    Args:
        content: the compressed mesh.
        ids: of the attributes in it.
        place: of the primitive.

    Raises:
        MeshError: no decoder is installed, or the data is damaged.
    """
    try:
        import DracoPy
    except ImportError:
        raise MeshError(_no_decoder(DRACO, place)) from None
    try:
        mesh = DracoPy.decode(content.tobytes())
        faces = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
        attributes = {name: np.asarray(mesh.get_attribute_by_unique_id(id_)["data"]) for name, id_ in ids.items()}
    except Exception:  # noqa: BLE001 - whatever a decoder does with damaged data
        raise MeshError(f"{place}: its {DRACO} data is damaged") from None
    return attributes, faces


def _decoded_meshopt(content: Bytes, view: JsonObject, name: str) -> tuple[Bytes, int]:
    mode, count, stride = view.text("mode"), view.integer("count", least=1), view.integer("byteStride", least=1)
    if mode == "ATTRIBUTES":
        allowed = stride % 4 == 0 and stride <= 256
    else:
        allowed = mode in {"TRIANGLES", "INDICES"} and stride in {2, 4} and (mode == "INDICES" or count % 3 == 0)
    if not allowed:
        raise MeshError(f"{view.place}: mode {mode[:20]!r} with byteStride {stride} and count {count} is not valid")
    _require_cheap(count * stride, _FREE_BYTES + _BYTES_PER_COMPRESSED_BYTE * len(content), view.place)
    try:
        import meshoptimizer
    except ImportError:
        raise MeshError(_no_decoder(name, view.place)) from None
    decode: Callable[..., NDArray[Any]] = {
        "ATTRIBUTES": meshoptimizer.decode_vertex_buffer,
        "TRIANGLES": meshoptimizer.decode_index_buffer,
        "INDICES": meshoptimizer.decode_index_sequence,
    }[mode]
    try:
        # Its index decoders always return 32 bits, and fill them only when they are asked for 4 bytes.
        values = decode(count, stride if mode == "ATTRIBUTES" else 4, content)
    except Exception:  # noqa: BLE001 - whatever a decoder does with damaged data
        raise MeshError(f"{view.place}: its data is damaged") from None
    if mode != "ATTRIBUTES":
        return values.astype("<u4" if stride == 4 else "<u2").view(np.uint8), 0
    return _unfiltered(values.view(np.uint8).reshape(-1), view), stride


def _unfiltered(content: Bytes, view: JsonObject) -> Bytes:
    kind = view.text("filter", "NONE")
    if kind == "EXPONENTIAL":
        words = content.view("<i4")
        numbers: Numbers = np.ldexp(((words << 8) >> 8).astype(np.float64), words >> 24).astype("<f4")
        return numbers.view(np.uint8)
    if kind != "NONE":
        raise MeshError(f"{view.place}: data with the filter {kind[:20]!r} is not supported; {WITHOUT_COMPRESSION}")
    return content


def _no_decoder(name: str, place: str) -> str:
    return f"{place}: {name} needs a decoder: pip install 'meshfit[gltf]', or {WITHOUT_COMPRESSION}"


def _require_cheap(num_bytes: int, limit: int, place: str) -> None:
    if num_bytes > limit:
        raise MeshError(f"{place} announces {num_bytes} bytes, far more than the file can hold")


def _dtype(owner: JsonObject, allowed: dict[int, str]) -> np.dtype[Any]:
    number = owner.integer("componentType")
    if number not in allowed:
        raise MeshError(f"{owner.place}.componentType: expected one of {', '.join(map(str, allowed))}, got {number}")
    return np.dtype(allowed[number])


def _data_uri(uri: str, place: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise MeshError(f"{place}.uri: a data URI without data")
    if not head.endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(unquote_to_bytes(body), validate=True)
    except binascii.Error:
        raise MeshError(f"{place}.uri: its base64 is damaged") from None
