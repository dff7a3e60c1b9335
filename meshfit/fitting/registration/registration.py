"""Registration of a template: poses, deformation graphs from coarse to fine, unfolding, and a fit of all vertices."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from meshfit.fitting.gauss_newton.correspondences import Direction
from meshfit.fitting.registration.deformation_graph import DeformationGraph
from meshfit.fitting.registration.graph_fit import LEVELS, GraphFit, Level
from meshfit.fitting.registration.oriented_points import OrientedPoints
from meshfit.fitting.registration.poses import Pose, candidate_poses
from meshfit.fitting.registration.template import Template
from meshfit.fitting.registration.unfolding import Unfolding
from meshfit.fitting.registration.vertex_fit import STEPS, VertexFit
from meshfit.mesh.mesh import Mesh, Verts

_POSES = 3
_REMOTENESS = (0.5, 0.0)
_GOOD = 0.025
# Points of each side by which a start is judged, the largest distance that counts, and the weight of stretch.
_SAMPLES, _CAP, _NORMALS, _STRETCH = 1500, 0.1, 0.1, 2.0


@dataclass(frozen=True, eq=False)
class Registered:
    """The outcome of a registration.

    Attributes:
        verts: (V, 3) the vertices of the template, on the target.
        pose: the pose that it started from.
        crossing: number of pairs of faces that cross and did not at rest.
        matched: share of the pairs of the last step that counted.
    """

    verts: Verts
    pose: Pose
    crossing: int
    matched: float


def register(
    source: Mesh,
    target: OrientedPoints,
    *,
    direction: Direction = "both",
    similarity: bool = False,
    seed: int = 0,
    levels: tuple[Level, ...] = LEVELS,
    log: Callable[[str], None] = lambda _: None,
) -> Registered:
    """Carry a template to a target.

    Args:
        source: the template.
        target: points of the target.
        direction: of the pairs.
        similarity: whether the template's size is to be found, too.
        seed: of the samples.
        levels: of the deformation graphs.
        log: gets lines about the course.
    """
    diagonal = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    at_rest = Template(source).points_at(source.verts)
    best: tuple[float, Template, DeformationGraph, Pose] | None = None
    for number, pose in enumerate(candidate_poses(at_rest, target, similarity=similarity, most=_POSES, seed=seed)):
        template = Template(source.with_verts(pose.applied(source.verts)))
        for remoteness in _REMOTENESS:
            fit = GraphFit(template, target, direction, diagonal, remoteness)
            graph = _through(fit, DeformationGraph.of(template, levels[0].nodes), levels[0], seed)
            value = _judged(template, target, graph.positions(), direction, diagonal)
            log(f"pose {np.degrees(pose.angle_to(Pose.identity())):.0f} deg remote {remoteness} scale {pose.scale:.3g}: {value:.4f}")
            if best is None or value < best[0]:
                best = value, template, graph, pose
        if number == 0 and best[0] < _GOOD:
            break
    assert best is not None
    _, template, graph, pose = best
    fit = GraphFit(template, target, direction, diagonal)
    for level in levels[1:]:
        graph = DeformationGraph.of(template, level.nodes).fitted_to(graph.positions())
        graph = _through(fit, graph, level, seed)
    unfolding = Unfolding.of(template)
    verts, crossing = unfolding.unfolded(graph.positions(), lambda n: log(f"crossing {n}"))
    fine, matched = VertexFit(template, target, verts, direction, diagonal), 0.0
    for number in range(STEPS):
        verts, pairs = fine.step(verts, number)
        matched = pairs.matched
    if crossing:
        verts, crossing = unfolding.unfolded(verts, lambda n: log(f"crossing {n}"))
    return Registered(verts, pose, crossing, matched)


def _through(fit: GraphFit, graph: DeformationGraph, level: Level, seed: int) -> DeformationGraph:
    generator = np.random.default_rng([seed, level.nodes])
    for number in range(level.steps):
        graph, _ = fit.step(graph, level, number, generator)
    return graph


def _judged(template: Template, target: OrientedPoints, verts: Verts, direction: Direction, diagonal: float) -> float:
    """Return how badly a start serves: capped distances in positions and normals, times one and the stretch of edges."""
    generator = np.random.default_rng(0)
    moved = template.points_at(verts)
    own, other = (side.subset(_some(len(side), generator)) for side in (moved, target))
    length, cap, total = _NORMALS * diagonal, _CAP * diagonal, 0.0
    if direction != "to-source":
        total += float((np.minimum(target.nearest(own, length)[0], cap) ** 2).mean())
    if direction != "to-target":
        total += float((np.minimum(moved.nearest(other, length)[0], cap) ** 2).mean())
    ratios = np.log(np.maximum(template.lengths_at(verts), 1e-12) / np.maximum(template.rest_lengths, 1e-12))
    stretch = float(np.sqrt((np.minimum(np.abs(ratios), 1) ** 2).mean()))
    return float(np.sqrt(total)) / diagonal * (1 + _STRETCH * stretch)


def _some(count: int, generator: np.random.Generator) -> np.ndarray:
    return generator.choice(count, min(count, _SAMPLES), replace=False)
