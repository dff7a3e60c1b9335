"""Meshes that carry attributes, for the tests of files."""

import struct
import zlib

import numpy as np

from meshfit.mesh.attributes import Attributes, Image, Material
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.solids import quad_cube


def png(colour=(200, 30, 40), size=4):
    """The bytes of an image of one colour."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = (b"\0" + bytes(colour) * size) * size
    header = struct.pack(">IIBBBBB", size, size, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def unwrapped_cube(*, triangles=False):
    """A cube whose faces each have a part of the texture, two materials, and three groups; so every edge is a seam."""
    mesh = quad_cube()
    face = np.repeat(np.arange(6), 4)
    uv = np.stack([face + [0, 1, 1, 0] * 6, np.array([0, 0, 1, 1] * 6)], axis=1) / [6, 1]
    materials = (
        Material("painted", (0.5, 0.25, 1.0, 1.0), Image("paint.png", png())),
        Material("glass", (0.0, 0.5, 1.0, 0.25)),
    )
    attributes = Attributes(
        vertex={"color": np.arange(24.0).reshape(8, 3) / 24},
        face={"material": np.array([0, 0, 1, 1, 0, 1]), "group": np.array([0, 0, 1, 2, 2, 2])},
        corner={"uv": uv},
        materials=materials,
        groups=("top", "low", "middle"),
    )
    whole = mesh.with_attributes(attributes)
    return PolygonMesh.of(whole.triangulated()) if triangles else whole


def require_same(found, expected, names=None):
    """Check that a mesh has the shape of another, and its attributes, or those of some names."""
    one, other = PolygonMesh.of(found), PolygonMesh.of(expected)
    assert np.array_equal(one.verts, other.verts)
    assert np.array_equal(one.corners, other.corners)
    assert np.array_equal(one.sizes, other.sizes)
    for kind in ("vertex", "face", "corner"):
        has, wanted = getattr(one.attributes, kind), getattr(other.attributes, kind)
        wanted = {name: values for name, values in wanted.items() if names is None or name in names}
        assert has.keys() == wanted.keys(), kind
        for name, values in wanted.items():
            np.testing.assert_array_equal(has[name], values, err_msg=name)
