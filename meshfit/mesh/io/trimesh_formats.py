"""File formats that trimesh reads. The one module that imports it."""

import io
import warnings

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup


def read_with_trimesh(content: bytes, file_type: str) -> PolygonSoup:
    """Read a file; a damaged one makes trimesh raise any exception."""
    import trimesh  # takes as long to import as all the rest, and most files are of other formats

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=file_type, process=False, validate=False, skip_materials=True
        )
    verts, faces, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        points = np.reshape(getattr(part, "vertices", []), (-1, 3))
        verts.append(points if np.array_equal(transform, np.eye(4)) else trimesh.transform_points(points, transform))
        faces.append(np.reshape(getattr(part, "faces", []), (-1, 3)) + count)
        count += len(points)
    return PolygonSoup.of_triangles(np.concatenate(verts), np.concatenate(faces).astype(np.int64))


def write_with_trimesh(mesh: Mesh | PolygonMesh, file_type: str) -> bytes:
    """Return the bytes of a file."""
    import trimesh

    triangles = PolygonMesh.of(mesh).triangulated()
    content = trimesh.Trimesh(triangles.verts, triangles.faces, process=False).export(file_type=file_type)
    return content if isinstance(content, bytes) else str(content).encode()
