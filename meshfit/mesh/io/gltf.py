"""glTF files."""

from meshfit.mesh.io.trimesh_formats import read_with_trimesh, write_with_trimesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup


def read_glb(content: bytes) -> PolygonSoup:
    """Read the triangles of a GLB file, all parts where their nodes put them."""
    return read_with_trimesh(content, "glb")


def write_glb(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of a GLB file."""
    return write_with_trimesh(mesh, "glb")
