"""The one buffer of a glTF file that is written, with its views and accessors."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_COMPONENT_TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963


class BufferWriter:
    """Bytes of a buffer, and the JSON of its views and accessors."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    @property
    def content(self) -> bytes:
        """The bytes so far."""
        return b"".join(self._pieces)

    def view(self, content: bytes, **members: int) -> int:
        """Append bytes, and return the index of their view, which begins at a multiple of four."""
        if padding := -self._size % 4:
            self._append(bytes(padding))
        place = {"byteOffset": self._size} if self._size else {}
        self.views.append({"buffer": 0, **place, "byteLength": len(content), **members})
        self._append(content)
        return len(self.views) - 1

    def vertex_accessor(self, values: NDArray[Any], *, normalized: bool = False, box: bool = False) -> int:
        """Append data of vertices, each row at a multiple of four bytes, and return the index of its accessor.

        Args:
            values: (V,) or (V, C).
            normalized: integers stand for numbers up to 1.
            box: give the smallest and the largest coordinates too.
        """
        size = values.itemsize * (values.shape[1] if values.ndim > 1 else 1)
        members = {"target": VERTICES}
        content = np.ascontiguousarray(values)
        if size % 4:
            rows = content.view(np.uint8).reshape(len(values), size)
            content = np.pad(rows, ((0, 0), (0, -size % 4)))
            members = {"byteStride": content.shape[1], **members}
        extra: dict[str, Any] = {"normalized": True} if normalized else {}
        if box:
            extra |= {
                "min": values.min(axis=0).astype(float).tolist(),
                "max": values.max(axis=0).astype(float).tolist(),
            }
        return self._accessor(values, self.view(content.tobytes(), **members), **extra)

    def index_accessor(self, indices: NDArray[Any]) -> int:
        """Append indices, and return the index of their accessor."""
        flat = indices.reshape(-1)
        return self._accessor(flat, self.view(flat.tobytes(), target=INDICES))

    def accessor(self, values: NDArray[Any]) -> int:
        """Append other data, and return the index of its accessor."""
        return self._accessor(values, self.view(np.ascontiguousarray(values).tobytes()))

    def _accessor(self, values: NDArray[Any], view: int, **members: Any) -> int:  # noqa: ANN401
        columns = values.shape[1] if values.ndim > 1 else 1
        accessor = {"bufferView": view, "componentType": _COMPONENT_TYPES[values.dtype.str[1:]], "count": len(values)}
        self.accessors.append(accessor | {"type": _TYPES[columns]} | members)
        return len(self.accessors) - 1

    def _append(self, content: bytes) -> None:
        self._pieces.append(content)
        self._size += len(content)
