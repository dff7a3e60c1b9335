"""Small glTF files, put together from arrays."""

import json
import struct
from pathlib import Path

import numpy as np

CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], "<f4")
CUBE_FACES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2],
     [1, 3, 7], [1, 7, 5]], "<u2"
)  # fmt: skip
_COMPONENT_TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """The JSON of a file, which tests may change at will, and its one buffer."""

    def __init__(self):
        self.binary = b""
        self.json = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 0}], "bufferViews": [], "accessors": []}
        self.json |= {"meshes": [], "nodes": []}

    def view(self, content, **members):
        """Append a buffer view."""
        self.binary += bytes(-len(self.binary) % 4)
        self.json["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)} | members
        )
        self.binary += content
        self.json["buffers"][0]["byteLength"] = len(self.binary)
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values, view=None, **members):
        """Append an accessor of an array; a view that is given holds it already."""
        values = np.asarray(values)
        columns = 1 if values.ndim == 1 else values.shape[1]
        members = {"count": len(values), "type": _TYPES[columns]} | members
        members = {"componentType": _COMPONENT_TYPES[values.dtype.str[1:]]} | members
        view = self.view(values.tobytes()) if view is None else view
        self.json["accessors"].append({"bufferView": view} | members)
        return len(self.json["accessors"]) - 1

    def mesh(self, *primitives):
        """Append a mesh."""
        self.json["meshes"].append({"primitives": list(primitives)})
        return len(self.json["meshes"]) - 1

    def primitive(self, verts, corners=None, **members):
        """Return a primitive, and append its accessors."""
        primitive = {"attributes": {"POSITION": self.accessor(verts)}} | members
        return primitive if corners is None else {"indices": self.accessor(np.ravel(corners))} | primitive

    def node(self, **members):
        """Append a node."""
        self.json["nodes"].append(members)
        return len(self.json["nodes"]) - 1

    @classmethod
    def of_cube(cls, **node):
        """Return a file with one node that holds the unit cube."""
        file = cls()
        file.node(mesh=file.mesh(file.primitive(CUBE, CUBE_FACES)), **node)
        return file

    def glb(self):
        """Return the bytes of a binary file."""
        return glb(self.json, self.binary)

    def write(self, folder: Path, name="a.glb"):
        """Write the file, text or binary by its suffix, and return its path."""
        path = folder / name
        if name.endswith(".glb"):
            path.write_bytes(self.glb())
        else:
            (folder / "a.bin").write_bytes(self.binary)
            self.json["buffers"][0].setdefault("uri", "a.bin")
            path.write_text(json.dumps(self.json))
        return path


def glb(document, binary=None, version=2):
    """Return the bytes of a binary file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text
    if binary is not None:
        binary += bytes(-len(binary) % 4)
        body += struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", version, 12 + len(body)) + body
