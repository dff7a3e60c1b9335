"""A first map of a closed surface of genus 0 to the sphere, one to one: by rays, or else by way of the plane."""

import numpy as np
import torch
from jaxtyping import Float64
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import Pattern
from meshfit.fitting.gauss_newton.sphere import SphereMap
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import euler_number, is_watertight, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.remeshing.shapes import turned_over, unit

# Of the plane's map, first with all faces alike, then with the worst counting for more.
_STEPS = 40
# The mean energy density above which a map is of no use; that of an isometry is 4.
_USEFUL = 100.0


def on_sphere(mesh: Mesh) -> Float64[Tensor, "V 3"] | None:
    """Where the verts of a mesh are on the unit sphere, such that no face is turned over.

    They are where rays from their mean meet it, if that is one to one. Else the mesh, less a face near its middle, is
    laid out in a triangle with each vertex at the mean of its neighbours, where no face turns over (Tutte, How to draw
    a graph, 1963; Floater, Parametrization and smooth approximation of surface triangulations, 1997), taken to the
    sphere by stereographic projection, and bettered as `SphereMap` does, which takes seconds for thousands of verts.

    Args:
        mesh: a manifold.

    Returns:
        (V, 3), or None where the mesh is no closed surface of genus 0 in one piece, or no useful map is found.
    """
    topology = Topology.of(mesh)
    if not (is_watertight(topology) and num_components(topology) == 1 and euler_number(topology) == 2):
        return None
    verts, faces = torch.tensor(mesh.verts), torch.tensor(mesh.faces)
    found = unit(verts - verts.mean(0))
    if not bool(turned_over(found, faces).any()):
        return found
    found = _from_plane(torch.tensor(_laid_out(mesh, topology)))
    if bool(turned_over(found, faces).any()):
        return None
    pattern = Pattern(Connectivity(faces, len(verts), verts.dtype))
    for power in (1.0, 2.0):
        sphere = SphereMap(pattern, verts, power=power)
        found = sphere.improved(found, _STEPS)
    return found if sphere.distortion(found) < _USEFUL else None


def _laid_out(mesh: Mesh, topology: Topology) -> Float64[np.ndarray, "V 2"]:
    """Places in the plane, the corners of a face near the middle outermost, the way round that suits `_from_plane`."""
    area, middles = face_areas(mesh), mesh.verts[mesh.faces].mean(1)
    centre = np.average(middles, axis=0, weights=area)
    outer = mesh.faces[np.linalg.norm(middles - centre, axis=1).argmin()]
    count, (tail, head) = mesh.num_verts, topology.edges.T
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    adjacent = coo_array((np.ones(len(ends[0])), ends), shape=(count, count))
    matrix = (diags_array(adjacent.sum(axis=0)) - adjacent).tocsr()
    inner = np.setdiff1d(np.arange(count), outer)
    places = np.zeros((count, 2))
    angles = np.array([0.0, 2.0, 4.0]) * np.pi / 3
    places[outer] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    right = -(matrix[inner][:, outer] @ places[outer])
    places[inner] = spsolve(matrix[inner][:, inner].tocsc(), right)
    return places


def _from_plane(places: Float64[Tensor, "V 2"]) -> Float64[Tensor, "V 3"]:
    """Stereographic projection, of which half the verts go to either half of the sphere."""
    middle = places.quantile(0.5, dim=0)
    offset = places - middle
    offset = offset / offset.norm(dim=1).quantile(0.5)
    square = offset.square().sum(1, keepdim=True)
    found: Tensor = torch.cat([2 * offset, square - 1], 1) / (1 + square)
    return found
