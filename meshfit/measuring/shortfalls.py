"""Shortfalls of a result: parts that it does not reach or plugs, and pieces, openings and handles that it lacks."""

import numpy as np

from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.units import count_text

# Points farther than this share of the diagonal from the other surface count as unreached or off the target; they are
# reported above this share of the area.
_FAR, _PART = 0.02, 0.005
_POINTS = 5000


def shortfalls(result: Mesh, target: Mesh) -> list[str]:
    """Return what a result lacks of its target, in words, each of which names the finding and its size."""
    far = _FAR * bounding_box_diagonal(target.verts)
    unreached, beyond = _share_beyond(far, target, result), _share_beyond(far, result, target)
    texts = _of_topology(result, target)
    distance = f"farther than {_FAR:.0%} of the target's diagonal from the"
    if unreached > _PART:
        texts.append(f"not reached: {unreached:.1%} of the target's area is {distance} result")
    if beyond > _PART:
        texts.append(f"off the target: {beyond:.1%} of the result's area is {distance} target")
    return texts


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


def _share_beyond(distance: float, mesh: Mesh, surface: Mesh) -> float:
    """Return the share of a mesh's area that is farther than a distance from a surface."""
    points = sample_surface(mesh, _POINTS, np.random.default_rng(0)).points
    return float((point_distances(surface, points) > distance).mean())
