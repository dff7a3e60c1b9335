"""Subdivision of the state of a fit: by one level, or as the control mesh of several."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Int64
from scipy.sparse import coo_array
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import ControlledSurface, SparsityPattern
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.step_limiting import limit_step
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.loss.sparse import Sparse
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.limit import loop_limit, loop_limit_tangents
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import PolygonRefinement, Refinement, linear_scheme, refine
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.subdivision.triangles.scheme import TriangleScheme


def with_control_mesh(
    state: FitState,
    scheme: str | Scheme,
    levels: int,
    *,
    limit: bool,
    triangles: Int64[Tensor, "T 3"] | None = None,
) -> FitState:
    """Make the mesh of a state the control mesh of its subdivision.

    Args:
        state: the state of the control mesh.
        scheme: the subdivision scheme.
        levels: number of levels.
        limit: project the vertices of the last level onto the Loop limit surface.
        triangles: (T, 3) the triangles of the last level's polygons, if they have been chosen already.
    """
    masks = resolve(scheme)
    refinement = refine(topology_for(state, masks), masks, levels)
    matrix = refinement.matrix
    faces, polygons = _finest_triangles(refinement, matrix @ _positions(state))
    if triangles is not None:
        faces = triangles.numpy()
    dtype, device, tangents = state.verts.dtype, state.verts.device, None
    if limit:
        assert isinstance(masks, TriangleScheme)  # noqa: S101  the engine has checked it
        topology = Topology(matrix.shape[0], faces)
        found = loop_limit_tangents(topology, masks)
        sectors = np.arange(len(found.vert))  # one at each vertex, as there are no creases
        at_verts = coo_array((np.ones(len(sectors)), (found.vert, sectors)), shape=(matrix.shape[0], len(sectors)))
        along, across = (Sparse.of(at_verts @ way @ matrix, dtype, device) for way in (found.along, found.across))
        tangents = (along, across)
        matrix = loop_limit(topology, masks) @ matrix
    surface = ControlledSurface(
        SparsityPattern(Connectivity(torch.tensor(faces, device=device), matrix.shape[0], dtype, state.crossing)),
        Sparse.of(matrix, dtype, device),
        Sparse.of(matrix.power(2), dtype, device),
        polygons,
        tangents,
    )
    return replace(state, on_sphere=None, controlled=surface)


def control_mesh(state: FitState, scheme: str | Scheme) -> Mesh | PolygonMesh:
    """Return the mesh that a scheme refines: of polygons where the scheme is on polygons and the state has any."""
    topology, verts = topology_for(state, resolve(scheme)), _positions(state)
    if isinstance(topology, Topology):
        return Mesh(verts, topology.faces)
    return PolygonMesh(verts, topology.corners, topology.sizes)


def refine_state(state: FitState, scheme: str | Scheme, *, untangle: bool = True) -> FitState:
    """Refine by one level of a scheme; where that is unsound, vertices stay nearer to the unrefined state.

    A scheme that splits triangles in four always has such positions, as its linear refinement is the surface itself;
    for others they nearly always exist. A scheme on polygons continues from those of the last level.

    Args:
        state: the state.
        scheme: the scheme.
        untangle: whether to smooth faces that are unsound nevertheless.
    """
    masks, device = resolve(scheme), state.verts.device
    topology = topology_for(state, masks)
    refinement, verts = refine(topology, masks), _positions(state)
    fine = refinement(verts)
    faces, polygons = _finest_triangles(refinement, fine)
    finer = FitState.of(
        torch.as_tensor(fine).to(state.verts),
        torch.tensor(faces, device=device),
        polygons=polygons,
        crossing=state.crossing,
    )
    linear = linear_scheme(masks)
    if state.rest is not None:
        flat = refinement if linear is None else refine(topology, linear)
        finer = replace(finer, rest=flat(state.rest))
    if linear is None:
        return finer.untangled() if untangle else finer
    between = refine(topology, linear)
    start = torch.as_tensor(between(verts)).to(state.verts)
    stiffness = torch.as_tensor(between(state.stiffness.cpu().double().numpy())).to(state.verts)
    end, _ = limit_step(finer.pattern.connectivity, start, finer.verts)
    finer = replace(finer, verts=end, stiffness=stiffness)
    return finer.untangled() if untangle else finer


def linearly_refined(state: FitState, scheme: str | Scheme) -> FitState | None:
    """Refine by one level in the way of a scheme, with the surface as it is; None if the scheme moves edges."""
    masks = resolve(scheme)
    linear = linear_scheme(masks)
    if linear is None:
        return None
    refinement = refine(topology_for(state, masks), linear)
    fine = refinement(_positions(state))
    faces, polygons = _finest_triangles(refinement, fine)
    verts, device = torch.as_tensor(fine).to(state.verts), state.verts.device
    triangles = torch.tensor(faces, device=device)
    return FitState.of(verts, triangles, polygons=polygons, crossing=state.crossing)


def _finest_triangles(
    refinement: Refinement | PolygonRefinement, verts: Verts
) -> tuple[Int64[np.ndarray, "G 3"], PolygonTopology | None]:
    """Return the finest faces as triangles, with their vertices at these positions, and their polygons, if any."""
    if isinstance(refinement, Refinement):
        return refinement.faces, None
    return refinement.mesh(verts).triangulated().faces, refinement.finest


def _positions(state: FitState) -> Verts:
    return np.asarray(state.verts.cpu().double().numpy())


def topology_for(state: FitState, scheme: Scheme) -> Topology | PolygonTopology:
    """Return the connectivity that a scheme refines: polygons where it is on polygons and the state has any."""
    if state.polygons is not None and isinstance(scheme, PolygonScheme):
        return state.polygons
    return Topology(len(state.verts), state.pattern.connectivity.faces.cpu().numpy())
