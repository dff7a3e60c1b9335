"""Sizes of refined meshes, known before they are made: faces, vertices and memory."""

from meshfit.memory import require_memory
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.polygons.scheme import PolygonScheme, PolygonSplit
from meshfit.subdivision.registry import Scheme
from meshfit.subdivision.triangles.scheme import Split, TriangleScheme
from meshfit.units import count_text

# Vertices for each old one on a large closed triangle mesh, which has three edges and two faces for each vertex: after
# the first level, and after each later one, on the polygons that the first leaves.
_GROWTH_ON_TRIANGLES: dict[PolygonSplit, tuple[float, float]] = {
    PolygonSplit.QUADS: (6.0, 4.0),
    PolygonSplit.SQRT2: (3.0, 2.0),
    PolygonSplit.TERNARY: (13.0, 9.0),
    PolygonSplit.DUAL: (6.0, 4.0),
}


# The peak while refining is at least so much; measured on a million faces and more, 220 to 360 and 510 to 540.
_LEAST_BYTES_PER_TRIANGLE, _LEAST_BYTES_PER_POLYGON = 200, 500


def num_faces_after(mesh: Mesh | PolygonMesh | Topology | PolygonTopology, scheme: Scheme, levels: int) -> int:
    """Return the number of faces after some levels: exact on closed meshes for most splits, else within a few percent.

    Args:
        mesh: triangles for a scheme on triangles, polygons for a scheme on polygons.
        scheme: a scheme on surfaces.
        levels: 0 or more.
    """
    if levels == 0:
        return mesh.num_faces
    if isinstance(mesh, Mesh | Topology) or not isinstance(scheme, PolygonScheme):
        per_level = 4 if isinstance(scheme, TriangleScheme) and scheme.split is Split.QUADRISECT else 3
        return int(mesh.num_faces * per_level**levels)
    corners = len(mesh.corners)
    first, later = {
        PolygonSplit.QUADS: (corners, 4),
        PolygonSplit.DUAL: (corners, 4),
        PolygonSplit.SQRT2: (corners // 2, 2),
        PolygonSplit.TERNARY: (2 * corners + mesh.num_faces, 9),
    }[scheme.split]
    return int(first * later ** (levels - 1))


def growth(scheme: Scheme, levels: int) -> float:
    """Return about how many vertices replace each one after some levels on triangles.

    For schemes on triangles it is 4 for each level, an upper bound for √3.
    """
    if not isinstance(scheme, PolygonScheme):
        return 4.0**levels
    first, later = _GROWTH_ON_TRIANGLES[scheme.split]
    return first * later ** (levels - 1) if levels else 1.0


def require_memory_for_levels(
    mesh: Mesh | PolygonMesh | Topology | PolygonTopology, scheme: Scheme, levels: int
) -> None:
    """Refuse levels that surely need more memory than is available.

    Args:
        mesh: triangles for a scheme on triangles, polygons for a scheme on polygons.
        scheme: a scheme on surfaces.
        levels: 0 or more.

    Raises:
        MeshError: with the number of faces that they make.
    """
    count = num_faces_after(mesh, scheme, levels)
    each = _LEAST_BYTES_PER_POLYGON if isinstance(scheme, PolygonScheme) else _LEAST_BYTES_PER_TRIANGLE
    makes = "1 level makes" if levels == 1 else f"{levels} levels make"
    require_memory(each * count, f"{makes} about {count_text(count, 'face')}", "take fewer levels")
