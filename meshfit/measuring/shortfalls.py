"""Shortfalls of a result: parts of the target that it does not reach, and pieces, openings and handles it lacks."""

import numpy as np

from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.units import count_text

# A part of the target is unreached if it is farther than this share of the diagonal from the result; it is named if it
# is more than this share of the target's area.
_FAR, _PART = 0.02, 0.005
_POINTS = 5000


def shortfalls(result: Mesh, target: Mesh) -> list[str]:
    """Return what a result lacks of its target, in words, each of which names the finding and its size."""
    return [*_of_topology(result, target), *_of_reach(result, target)]


def _of_topology(result: Mesh, target: Mesh) -> list[str]:
    counts, wanted = (TopologyCounts.of(Topology.of(mesh)) for mesh in (result, target))
    differing = [
        (noun, have, want)
        for noun, have, want in zip(("piece", "opening", "handle"), counts, wanted, strict=True)
        if have is not None and want is not None and have != want
    ]
    if not differing:
        return []
    texts = [f"{count_text(want, noun)} ({have} in the result)" for noun, have, want in differing]
    return [f"topology not matched: the target has {', '.join(texts)}"]


def _of_reach(result: Mesh, target: Mesh) -> list[str]:
    points = sample_surface(target, _POINTS, np.random.default_rng(0)).points
    far = point_distances(result, points) > _FAR * bounding_box_diagonal(target.verts)
    share = float(far.mean())
    if share <= _PART:
        return []
    return [f"not reached: {share:.1%} of the target's area is farther than {_FAR:.0%} of its diagonal from the result"]
