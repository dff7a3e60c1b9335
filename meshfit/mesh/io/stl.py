"""STL files, text or binary."""

from meshfit.mesh.io.trimesh_formats import read_with_trimesh, write_with_trimesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup


def read_stl(content: bytes) -> PolygonSoup:
    """Read the triangles of an STL file, text or binary."""
    return read_with_trimesh(content, "stl")


def write_stl(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of a binary STL file."""
    return write_with_trimesh(mesh, "stl")
