"""Surfaces on their way, refined by a scheme: once and for all, or to follow a control mesh."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import SparsityPattern
from meshfit.fitting.gauss_newton.fit_state import ControlledSurface, FitState
from meshfit.fitting.gauss_newton.step_limiting import limited_step
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.loss.sparse import Sparse
from meshfit.mesh.mesh import Verts
from meshfit.mesh.polygons import fan_triangles
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.limit import loop_limit
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import linear_scheme, refine
from meshfit.subdivision.refinement import finest_triangles
from meshfit.subdivision.registry import Scheme, resolve
from meshfit.subdivision.triangles.scheme import TriangleScheme


def with_control_mesh(
    surface: FitState,
    scheme: str | Scheme,
    levels: int,
    *,
    limit: bool,
    corners: Int64[Tensor, " C"] | None = None,
) -> FitState:
    """A surface as a control mesh, followed by some levels of a scheme.

    Args:
        surface: the control mesh.
        scheme: the scheme.
        levels: how many.
        limit: put the verts of the last level where Loop subdivision would put them in the end.
        corners: (C,) of the polygons of the last level, if it is known already where each of them begins.
    """
    masks = resolve(scheme)
    refinement = refine(_topology_for(surface, masks), masks, levels)
    matrix = refinement.matrix
    faces, polygons = finest_triangles(refinement, matrix @ _places(surface))
    if corners is not None and polygons is not None:
        polygons = replace(polygons, corners=corners.numpy())
        faces = fan_triangles(polygons.corners, polygons.sizes)
    if limit:
        assert isinstance(masks, TriangleScheme)  # noqa: S101  only Loop's have a limit that is known
        matrix = loop_limit(Topology(matrix.shape[0], faces), masks) @ matrix
    dtype, device = surface.verts.dtype, surface.verts.device
    controlled = ControlledSurface(
        SparsityPattern(Connectivity(torch.tensor(faces, device=device), matrix.shape[0], dtype)),
        Sparse.of(matrix, dtype, device),
        Sparse.of(matrix.power(2), dtype, device),
        polygons,
    )
    return replace(surface, on_sphere=None, controlled=controlled)


def refined(surface: FitState, scheme: str | Scheme) -> FitState:
    """One level of a scheme, as far as it leaves the surface sound: elsewhere verts stay nearer to its faces.

    Where triangles are cut in four, there is always such a place, since the surface itself is one; where the scheme
    has other ways of keeping old verts, there nearly is one. A scheme on polygons goes on from those of the last.
    """
    masks, device = resolve(scheme), surface.verts.device
    topology = _topology_for(surface, masks)
    refinement, verts = refine(topology, masks), _places(surface)
    fine = refinement(verts)
    faces, polygons = finest_triangles(refinement, fine)
    place = torch.as_tensor(fine).to(surface.verts)
    finer = FitState.of(place, torch.tensor(faces, device=device), polygons=polygons)
    linear = linear_scheme(masks)
    if linear is None:
        return finer.untangled()
    between = refine(topology, linear)
    start = torch.as_tensor(between(verts)).to(surface.verts)
    stiffness = torch.as_tensor(between(surface.stiffness.cpu().double().numpy())).to(surface.verts)
    held, _ = limited_step(finer.pattern.connectivity, start, finer.verts)
    return replace(finer, verts=held, stiffness=stiffness).untangled()


def _places(surface: FitState) -> Verts:
    return np.asarray(surface.verts.cpu().double().numpy())


def _topology_for(surface: FitState, scheme: Scheme) -> Topology | PolygonTopology:
    if surface.polygons is not None and isinstance(scheme, PolygonScheme):
        return surface.polygons
    return Topology(len(surface.verts), surface.pattern.connectivity.faces.cpu().numpy())
