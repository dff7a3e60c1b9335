"""Second fits, where the first bridges parts of its target: what to start them from, and which of the two to keep."""

from dataclasses import replace

from meshfit.fitting.gauss_newton.closeness import Closeness
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.bridges import Bridge, farthest_bridge
from meshfit.mesh.control_mesh import control_mesh_of
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import crossing_faces
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.topology import Topology
from meshfit.subdivision.growth import growth
from meshfit.subdivision.registry import resolve

# Share of matched points from which on nothing is bridged.
_MATCHED = 0.9995
# The result of a second fit is kept if its largest distance is below this share of the first one's.
_NEARER = 0.9
# Seeds of second fits differ from those of first fits.
_OTHER_SEED = 1 << 20


def bridge_of(result: Mesh, problem: Problem, matched: float) -> Bridge | None:
    """Return the place at which the result of a fit bridges parts of its target, if another fit may do without.

    A source of other pieces, openings or handles than the target has to bridge something.

    Args:
        result: of the fit.
        problem: its source and target.
        matched: its share of matched points.
    """
    if isinstance(problem.target, PointCloud) or matched >= _MATCHED:
        return None
    counts = [TopologyCounts.of(Topology.of(mesh)) for mesh in (problem.source, problem.target)]
    return farthest_bridge(result, problem.target) if counts[0] == counts[1] else None


def second_problem(problem: Problem, settings: GaussNewtonSettings) -> tuple[Problem, GaussNewtonSettings, str]:
    """Return the problem and the settings of a second fit, and what it starts from, in words.

    A surface that is remeshed keeps nothing of its source but the topology, so that the target's own surface with few
    faces serves as well. Else the fit starts from its source again: by other random points, or with twice the vertices
    on the rough shape, which keep thin parts apart.
    """
    alone = replace(problem, on_step=None, resume=None, save=None, on_snapshot=None)
    if settings.connectivity == "remeshed" and not problem.source.attributes:
        assert isinstance(problem.target, Mesh)  # noqa: S101  as in `bridge_of`
        verts = max(4, int(settings.verts / growth(resolve(problem.scheme), settings.levels)))
        own = control_mesh_of(problem.target, "target", verts=verts).mesh
        counts = [TopologyCounts.of(Topology.of(mesh)) for mesh in (problem.source, own)]
        if counts[0] == counts[1] and not crossing_faces(own)[1].any():
            return replace(alone, source=own, polygons=None), settings, "the target's own surface, with few faces"
    if settings.connectivity == "remeshed":
        return replace(alone, seed=problem.seed + _OTHER_SEED), settings, "the source, by other random points"
    verts = 2 * max(settings.verts, 4 * problem.source.num_verts)
    denser = settings.model_copy(update={"register": "off", "verts": verts})
    return alone, denser, "the source, with more vertices on the rough shape"


def is_better(second: Mesh, first: Mesh, target: Mesh | PointCloud) -> bool:
    """Return whether the result of a second fit is much nearer to the target at its farthest place."""
    assert isinstance(target, Mesh)  # noqa: S101  as in `bridge_of`
    return Closeness.of(second, target).worst < _NEARER * Closeness.of(first, target).worst
