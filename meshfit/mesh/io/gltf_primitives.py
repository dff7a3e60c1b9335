"""Primitives of a glTF mesh: attributes, and triangles from lists, strips and fans."""

import warnings

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.gltf_buffers import COMPONENTS, DRACO, Document, Numbers, decoded_draco, dequantized
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.units import count_text

TRIANGLES, STRIP, FAN = 4, 5, 6


class Primitive:
    """The attributes and triangles of a primitive, from its accessors or from its Draco data."""

    def __init__(self, document: Document, primitive: JsonObject) -> None:
        self._document = document
        self._primitive = primitive
        self._place = primitive.place
        self._attributes = primitive.member("attributes") or JsonObject({}, f"{primitive.place}.attributes")
        self._decoded: dict[str, Numbers] = {}
        self._decoded_triangles: NDArray[np.int64] | None = None
        extensions = primitive.member("extensions")
        draco = extensions.member(DRACO) if extensions else None
        if draco is not None and not self._has_plain_data():
            ids = draco.member("attributes") or JsonObject({}, draco.place)
            content, _ = document.view(draco.integer("bufferView"), draco.place)
            numbers = {name: ids.integer(name) for name in ids.names() if name in self._attributes}
            self._decoded, self._decoded_triangles = decoded_draco(content, numbers, self._place)

    @property
    def place(self) -> str:
        """Its place in the file."""
        return self._place

    def names(self) -> list[str]:
        """Return the names of its attributes."""
        return self._attributes.names()

    def attribute(self, name: str, *kinds: str, raw: bool = False) -> Numbers | None:
        """Return (N, C) an attribute of one of some types, such as VEC3, None if there is none.

        Args:
            name: of the attribute.
            kinds: the types.
            raw: leave normalized numbers in the type of the file.
        """
        if name not in self._attributes:
            return None
        index = self._attributes.integer(name)
        accessor = self._document.item("accessors", index, self._attributes.place)
        if name not in self._decoded:
            return self._document.accessor(index, f"{self._attributes.place}.{name}", *kinds, raw=raw)
        values = self._decoded[name]
        if values.ndim != 2 or values.shape[1] not in [COMPONENTS[kind] for kind in kinds]:
            widths = " or ".join(str(COMPONENTS[kind]) for kind in kinds)
            raise MeshError(f"{self._place}: expected a {name} of {widths} components in its {DRACO} data")
        return dequantized(values) if accessor.flag("normalized") and not raw else values

    def vertex_key(self) -> object:
        """Return a key that is equal for primitives with the same vertices."""
        names = [
            name for name in self._attributes.names() if name == "POSITION" or name.startswith(("JOINTS", "WEIGHTS"))
        ]
        if self._decoded or "targets" in self._primitive:
            return self._place
        return tuple((name, self._attributes.integer(name)) for name in sorted(names))

    def joints(self, count: int) -> tuple[NDArray[np.int64] | None, NDArray[np.float64] | None]:
        """Return (V, J) the joints that move each vertex, and their weights; None for a rigid primitive."""
        joints, weights = [], []
        for number in range(len(self._attributes.names())):
            joint, weight = (self.attribute(f"{name}_{number}", "VEC4") for name in ("JOINTS", "WEIGHTS"))
            if joint is None or weight is None:
                break
            if len(joint) != count or len(weight) != count or joint.dtype.kind == "f":
                raise MeshError(f"{self._attributes.place}: expected joints and weights of {count} vertices")
            joints.append(joint.astype(np.int64))
            weights.append(weight.astype(np.float64))
        if not joints:
            return None, None
        total = np.concatenate(weights, axis=1)
        sums = total.sum(axis=1, keepdims=True)
        return np.concatenate(joints, axis=1), np.divide(total, sums, out=np.zeros_like(total), where=sums != 0)

    def triangles(self, mode: int, count: int) -> NDArray[np.int64]:
        """Return (T, 3) the triangles among `count` vertices."""
        triangles = self._decoded_triangles
        if triangles is None:
            triangles = _assembled(self._order(count), mode, self._place)
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < count:
            raise MeshError(f"{self._place}: index {triangles.max()}, but its POSITION has {count} vertices")
        return triangles

    def _order(self, count: int) -> NDArray[np.int64]:
        if "indices" not in self._primitive:
            return np.arange(count)
        values = self._document.accessor(self._primitive.integer("indices"), f"{self._place}.indices", "SCALAR")[:, 0]
        if values.dtype.kind != "u":
            raise MeshError(f"{self._place}.indices: expected unsigned integers, got other numbers")
        restart = int(np.iinfo(values.dtype).max)
        if len(values) and values.max() == restart:
            raise MeshError(f"{self._place}.indices: {restart} restarts a primitive, which glTF does not allow")
        return values.astype(np.int64)

    def _has_plain_data(self) -> bool:
        indices = [self._attributes.integer("POSITION")] if "POSITION" in self._attributes else []
        indices += [self._primitive.integer("indices")] if "indices" in self._primitive else []
        accessors = [self._document.item("accessors", index, self._place) for index in indices]
        return bool(accessors) and all("bufferView" in accessor or "sparse" in accessor for accessor in accessors)


def _assembled(order: NDArray[np.int64], mode: int, place: str) -> NDArray[np.int64]:
    """Return the triangles of a list, strip or fan of vertices; a strip or fan repeats some only to go on elsewhere."""
    if mode == TRIANGLES:
        whole = len(order) - len(order) % 3
        if whole < len(order):
            _warn(f"{place}: ignored {count_text(len(order) - whole, 'corner')} after the last whole triangle")
        return np.reshape(order[:whole], (-1, 3))
    if len(order) < 3:
        _warn(f"{place}: ignored a strip or fan of {count_text(len(order), 'corner')}")
        return np.empty((0, 3), np.int64)
    first = np.arange(len(order) - 2)
    if mode == FAN:
        places = np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)
    else:
        places = np.stack([first, first + 1 + first % 2, first + 2 - first % 2], axis=1)
    triangles = order[places]
    return np.asarray(triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)])


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=3)
