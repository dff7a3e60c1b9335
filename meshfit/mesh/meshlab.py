"""MeshLab filters, from self-intersections to Poisson surfaces. The one module that imports pymeshlab.

MeshLab keeps the parameters of a filter's last call as its defaults within a process, so that every call spells out
all of them. It is imported at the first call, so that planning and writing do not wait for it.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from meshfit.errors import MeshError
from meshfit.library_output import native_output_discarded
from meshfit.mesh.mesh import Mesh, Verts

# Weight of the quadrics that keep triangles of flat parts well shaped: without it they become slivers; a larger one
# costs accuracy where the surface is curved, and from 0.1 on faces come to cross others.
_PLANAR_WEIGHT = 1e-4
# Edge length, relative to the size, of the triangle that stands for a point of a cloud.
_POINT_SIZE = 1e-6


def self_intersecting_faces(mesh: Mesh) -> Bool[np.ndarray, " F"]:
    """Return (F,) which faces cross another face of the same mesh."""
    meshes = _meshes_with(mesh)
    meshes.compute_selection_by_self_intersections_per_face()
    return np.asarray(meshes.current_mesh().face_selection_array(), dtype=bool)


def decimate(mesh: Mesh, num_faces: int, *, keep_rim: bool = True) -> Mesh:
    """Reduce a mesh to about `num_faces` faces by quadric edge collapse (Garland and Heckbert 1997); keep its topology.

    Args:
        mesh: the mesh.
        num_faces: about the number of faces of the result.
        keep_rim: keep every vertex on the boundary, however many there are.

    Raises:
        MeshError: the mesh has no faces, or no face is left.
    """
    if not mesh.num_faces:
        raise MeshError("a mesh without faces cannot be decimated")
    meshes = _meshes_with(mesh)
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=num_faces,
        targetperc=0.0,
        qualitythr=0.3,
        preserveboundary=keep_rim,
        boundaryweight=1.0,
        preservenormal=True,
        preservetopology=True,
        optimalplacement=True,
        planarquadric=True,
        planarweight=_PLANAR_WEIGHT,
        qualityweight=False,
        autoclean=True,
        selected=False,
    )
    reduced = meshes.current_mesh()
    if not reduced.face_number():
        raise MeshError(f"decimation to {num_faces} faces left nothing of a mesh of {mesh.num_faces} faces")
    return _from_meshlab(reduced)


def refine_long_edges(mesh: Mesh, length: float, rounds: int = 12) -> Mesh:
    """Halve edges that are longer than `length`, on the surface as it is."""
    from pymeshlab import PureValue

    meshes = _meshes_with(mesh)
    meshes.meshing_surface_subdivision_midpoint(iterations=rounds, threshold=PureValue(length), selected=False)
    return _from_meshlab(meshes.current_mesh())


def fill_holes(mesh: Mesh) -> Mesh:
    """Return the mesh with a patch of triangles across each of its boundary loops, without vertices of their own."""
    meshes = _meshes_with(mesh)
    meshes.meshing_close_holes(
        maxholesize=2 * mesh.num_faces + 3,
        selected=False,
        newfaceselected=False,
        selfintersection=False,
        refinehole=False,
    )
    return _from_meshlab(meshes.current_mesh())


def alpha_wrap(mesh: Mesh, alpha: float, offset: float) -> Mesh:
    """Return the closed manifold that encloses faces or points (Portaneri et al. 2022, Alpha wrapping with an offset).

    Args:
        mesh: faces of any kind; all vertices are taken as points if there are none.
        alpha: length below which gaps are closed.
        offset: distance of the surface from what it encloses.

    Raises:
        MeshError: no vertices, or lengths that are not above 0.
    """
    if not mesh.num_verts:
        raise MeshError("nothing to wrap: no faces and no points")
    if not (alpha > 0 and offset > 0):
        raise MeshError(f"expected an alpha and an offset above 0, got {alpha:g} and {offset:g}")
    from pymeshlab import PureValue

    # The filter crashes without faces.
    meshes = _meshes_with(mesh if mesh.num_faces else _tiny_triangles(mesh.verts))
    meshes.generate_alpha_wrap(alpha=PureValue(alpha), offset=PureValue(offset))
    return _from_meshlab(meshes.current_mesh())


def _tiny_triangles(points: Verts) -> Mesh:
    size = _POINT_SIZE * max(float(np.ptp(points, axis=0).max()), np.finfo(np.float64).tiny)
    corners = points[:, None] + size * np.array([[0, 0, 0], [1, 0, 0.5], [0, 1, 0.5]])
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3))


def _meshes_with(mesh: Mesh) -> Any:  # noqa: ANN401  a MeshSet, of a library without types
    with native_output_discarded():  # on each plugin that it cannot load
        import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.array(mesh.verts), np.array(mesh.faces)))
    return meshes


def _from_meshlab(mesh: Any) -> Mesh:  # noqa: ANN401
    return Mesh(mesh.vertex_matrix(), mesh.face_matrix().astype(np.int64))


def screened_poisson(
    points: Float64[np.ndarray, "N 3"], normals: Float64[np.ndarray, "N 3"], depth: int, point_weight: float
) -> Mesh:
    """Return the screened Poisson surface (Kazhdan and Hoppe 2013) through points with normals.

    Args:
        points: (N, 3) positions.
        normals: (N, 3) normals, outwards.
        depth: of the octree.
        point_weight: of interpolating the points.

    Raises:
        MeshError: it has no faces.
    """
    with native_output_discarded():  # on each plugin that it cannot load
        import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=np.array(points), v_normals_matrix=np.array(normals)))
    meshes.generate_surface_reconstruction_screened_poisson(
        visiblelayer=False,
        depth=depth,
        fulldepth=5,
        cgdepth=0,
        scale=1.1,
        samplespernode=1.5,
        pointweight=point_weight,
        iters=8,
        confidence=False,
        preclean=False,
        threads=1,
    )
    surface = _from_meshlab(meshes.current_mesh())
    if not surface.num_faces:
        raise MeshError("the screened Poisson surface has no faces")
    return surface
