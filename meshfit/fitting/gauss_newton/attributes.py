"""Attributes of the surface that a fit ends with: those of its source, refined or projected."""

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.refinement import topology_for
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.attributes import Attributes
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.topology import PolygonTopology, Topology
from meshfit.subdivision.limit import on_loop_limit
from meshfit.subdivision.polygons.scheme import PolygonScheme
from meshfit.subdivision.refine import linear_scheme, refine, refined_mesh
from meshfit.subdivision.registry import resolve


def initial_rest(problem: Problem, settings: GaussNewtonSettings) -> Float64[Tensor, "V 3"] | None:
    """Return the places on the source that a fit carries along; None if it has no use for them."""
    if settings.connectivity == "fixed" or not problem.source.attributes:
        return None
    return torch.tensor(problem.source.verts)


def carried_attributes(
    surface: Mesh | PolygonMesh, problem: Problem, settings: GaussNewtonSettings, state: FitState, *, levels: int
) -> Attributes:
    """Return the attributes of a surface at the end of a fit.

    With the source's own faces, they are those of the source, refined by the scheme. Else they are projected, by the
    place on the source that each vertex has carried along.

    Args:
        surface: the surface, or its control mesh.
        problem: the problem, whose source has attributes.
        settings: of the fit.
        state: at its end.
        levels: number of levels between the mesh that is solved for, or the source, and the surface.
    """
    if settings.connectivity == "fixed":
        return _refined(surface, problem, settings, levels)
    assert state.rest is not None  # noqa: S101  `initial_rest` has begun it
    rest = np.asarray(state.rest.cpu().numpy())
    if state.controlled is not None and levels:
        masks = resolve(problem.scheme)
        topology = topology_for(state, masks)
        rest = refine(topology, linear_scheme(masks) or masks, levels)(rest)
    from meshfit.mesh.projection import projected_attributes  # brings libigl

    return projected_attributes(surface, rest, problem.source)


def _refined(surface: Mesh | PolygonMesh, problem: Problem, settings: GaussNewtonSettings, levels: int) -> Attributes:
    scheme, polygons = resolve(problem.scheme), problem.polygons
    source: Mesh | PolygonMesh = problem.source
    if polygons is not None and (isinstance(scheme, PolygonScheme) if levels else isinstance(surface, PolygonMesh)):
        source = polygons
    topology = Topology.of(source) if isinstance(source, Mesh) else PolygonTopology.of(source)
    fine = refined_mesh(source, scheme, refine(topology, scheme, levels))
    if settings.limit and levels and isinstance(fine, Mesh):
        fine = on_loop_limit(fine, scheme)
    return fine.attributes
