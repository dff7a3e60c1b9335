"""Shortfalls of a result: parts that it misses, plugs or bridges, and pieces, openings and handles that it lacks."""

import numpy as np

from meshfit.mesh.bridges import LEAST_SHARE, farthest_bridge, is_filling
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.outer_surface import outer_surface
from meshfit.mesh.point_cloud import PointCloud, is_at_rim, local_areas
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.units import count_text

FAR = 0.02
"""Share of the target's diagonal from which a point counts as far from the other surface."""
FAR_ON_AVERAGE = 0.1
"""That of fits which minimise a mean distance: ears that they cut short are their numbers, not parts they miss."""
_PART = 0.005  # parts of less area are not reported
_POINTS = 5000
_CLOUD_POINTS = 100_000
_SPACINGS = 2.0
# A target of more pieces than these, with fewer faces each on average, is a soup: its pieces are nothing to match.
_FEWEST_FACES = 12


def shortfalls(
    result: Mesh,
    target: Mesh | PointCloud,
    far: float = FAR,
    *,
    surface: Surface = "all",
    filled: Mesh | None = None,
) -> list[str]:
    """Return what a result lacks of its target, in words, each of which names the finding and its size.

    Pieces, openings and handles of a cloud are not known. Where a result goes on beyond the rim of a cloud, or over a
    gap in it, the cloud shows nothing that it could be off. Nor are those of an outer surface to be matched where it is
    open, by cuts or gaps that one skin closes.

    Little area may be far off: webs and tubes between parts are named by their distance, of at least 1 % of the
    diagonal and 0.8 mean edges (see `farthest_bridge`), or of `far` where that is the share of fits that minimise a
    mean distance, whose largest distances reach 9 %.

    Args:
        result: the surface of the result.
        target: the surface or the points that it was fitted to.
        far: share of the target's diagonal from which a point is not reached, or off the target.
        surface: `outer` compares what can be seen of both from outside.
        filled: the target with its holes filled, if the result is to fill them: openings are nothing to match then, and
            what fills them is not off the target.
    """
    if isinstance(target, PointCloud):
        return _of_cloud(result, target, far)
    if surface == "outer":
        result, target = outer_surface(result), outer_surface(target)
    length = far * bounding_box_diagonal(target.verts)
    unreached, beyond = _share_beyond(length, target, result), _share_beyond(length, result, target, filled)
    one_skin = surface == "outer" and not Topology.of(target).is_watertight
    texts = [] if one_skin else _of_topology(result, target, openings=filled is None)
    distance = f"farther than {100 * far:g} % of the target's diagonal from the"
    if unreached > _PART:
        texts.append(f"not reached: {100 * unreached:.1f} % of the target's area is {distance} result")
    if beyond > _PART:
        texts.append(f"off the target: {100 * beyond:.1f} % of the result's area is {distance} target")
    return texts if beyond > _PART else texts + _bridges(result, target, far, filled)


def _of_cloud(result: Mesh, cloud: PointCloud, least: float) -> list[str]:
    diagonal = bounding_box_diagonal(cloud.verts)
    cloud = cloud.thinned(_CLOUD_POINTS)
    areas = local_areas(cloud.verts)
    areas = areas if areas.sum() > 0 else np.ones_like(areas)
    # Between points that are far apart, a surface is no farther from them than that.
    share = max(least, _SPACINGS * float(np.sqrt(np.median(areas))) / diagonal)
    far = share * diagonal
    unreached = float(np.average(point_distances(result, cloud.verts) > far, weights=areas))
    texts = []
    distance = f"farther than {100 * share:.2g} % of the target's diagonal from"
    if unreached > _PART:
        texts.append(f"not reached: {100 * unreached:.1f} % of the target's points are {distance} the result")
    points = sample_surface(result, _POINTS, np.random.default_rng(0)).points
    nearest = nearest_point_query(cloud.verts)(points)
    is_far = np.linalg.norm(points - cloud.verts[nearest], axis=1) > far
    off = is_far.copy()
    off[is_far] = ~is_at_rim(cloud.verts, nearest[is_far])
    beyond = float(off.mean())
    if beyond > _PART:
        texts.append(
            f"off the target: {100 * beyond:.1f} % of the result's area is {distance} all points, and not beyond a rim"
        )
    return texts if beyond > _PART else texts + _bridges(result, cloud, least)


def _bridges(result: Mesh, target: Mesh | PointCloud, far: float, filled: Mesh | None = None) -> list[str]:
    found = farthest_bridge(result, target, LEAST_SHARE if far < FAR_ON_AVERAGE else far, filled)
    if found is None:
        return []
    length = f"{100 * found.share:.1f} % of the target's diagonal, or {found.edges:.1f} mean edges"
    return [f"off the target at one place: by {length}; a web or tube between parts, or a gap that it spans"]


def _of_topology(result: Mesh, target: Mesh, *, openings: bool) -> list[str]:
    counts, wanted = (TopologyCounts.of(Topology.of(mesh)) for mesh in (result, target))
    if wanted.pieces > _FEWEST_FACES and target.num_faces < _FEWEST_FACES * wanted.pieces:
        return []
    differing = [
        (noun, have, want)
        for noun, have, want in zip(("piece", "opening", "handle"), counts, wanted, strict=True)
        if have is not None and want is not None and have != want and (openings or noun != "opening")
    ]
    if not differing:
        return []
    texts = [f"{count_text(want, noun)} ({have} in the result)" for noun, have, want in differing]
    return [f"topology not matched: the target has {', '.join(texts)}"]


def _share_beyond(distance: float, mesh: Mesh, surface: Mesh, filled: Mesh | None = None) -> float:
    """Return the share of a mesh's area that is farther than a distance from a surface, and does not fill its holes."""
    points = sample_surface(mesh, _POINTS, np.random.default_rng(0)).points
    beyond = point_distances(surface, points) > distance
    if filled is not None and beyond.any():
        beyond[beyond] = ~is_filling(points[beyond], surface, filled, distance)
    return float(beyond.mean())
