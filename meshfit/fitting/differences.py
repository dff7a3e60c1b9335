"""Differences of source and target that a fit cannot make up for, looked for before its first step."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

from meshfit.errors import MeshfitWarning
from meshfit.fitting.external.tools import works_from_target
from meshfit.fitting.settings import ExternalSettings, FitSettings, GaussNewtonSettings
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.control_mesh import unseen_of_open_cloud
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.manifold import TopologyCounts, describe_topology
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.mismatch import boxes_are_disjoint
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.topology import Topology
from meshfit.units import count_text

# A source whose box has this many times the diagonal of the target's is reported.
_MUCH_LARGER = 2.5
# A target that is so many times as large as the source is reported.
_MUCH_SMALLER = 10.0


@dataclass(frozen=True)
class Remedies:
    """What to do about each difference, in the words of a config or of keywords.

    Attributes:
        apart: boxes that do not overlap.
        too_large: a source much larger than the target.
        too_small: one that is much smaller.
        open_surface: a closed source for an open mesh.
        open_points: a closed source for points of an open surface.
    """

    apart: str
    too_large: str
    too_small: str
    open_surface: str
    open_points: str


IN_CONFIG = Remedies(
    "set source.align, source.centre or source.frame",
    "set a smaller source.radius, or source.align: pca",
    "set a larger source.radius, or source.align: pca",
    "source.mesh: target (or auto) starts from an open surface",
    "source.mesh: open (or auto) starts from an open surface",
)
BY_KEYWORD = Remedies(
    "set align",
    "give a smaller source, or set align='pca'",
    "give a larger source, or set align='pca'",
    "the source 'target' (or 'auto') starts from an open surface",
    "the source 'open' (or 'auto') starts from an open surface",
)


def warn_of_differences(
    source: Mesh,
    target: Mesh | PointCloud,
    fit: FitSettings,
    surface: Surface,
    *,
    fills: bool,
    remedies: Remedies,
    stacklevel: int = 2,
) -> None:
    """Warn of a source that the fit cannot bring onto the target; a tool may start from the target, or cut and glue.

    Args:
        source: in its place.
        target: in the same frame.
        fit: the settings of the fit.
        surface: the part of the target that counts.
        fills: whether the source fills the holes of the target, as set, so that it differs from it on purpose.
        remedies: what to do, in the caller's words.
        stacklevel: of the warnings, as of `warnings.warn` in the caller.

    Warns:
        MeshfitWarning: one is open and the other closed, or they differ in topology, lie apart, or differ much in size.
    """
    for text in _differences(source, target, fit, surface, remedies, fills=fills):
        warnings.warn(text, MeshfitWarning, stacklevel=stacklevel + 1)


def _differences(
    source: Mesh, target: Mesh | PointCloud, fit: FitSettings, surface: Surface, remedies: Remedies, *, fills: bool
) -> Iterator[str]:
    tool = fit.tool if isinstance(fit, ExternalSettings) else None
    if works_from_target(tool):
        return
    if not fills and surface == "all":
        yield from _openings(source, target, remedies)
    of_source = describe_topology(Topology.of(source))
    of_target = of_source
    if isinstance(target, Mesh) and (surface == "all" or Topology.of(target).is_watertight):  # skins close others
        of_target = describe_topology(Topology.of(target))
    if not fills and of_source != of_target and (tool is not None or not isinstance(fit, ExternalSettings)):
        yield f"source and target differ in topology ({of_source}; {of_target}); the fit keeps that of the source"
    if isinstance(fit, GaussNewtonSettings) and fit.prior is not None:
        return  # its place and its size are found
    if boxes_are_disjoint(source, target):
        yield f"the bounding boxes of source and target do not overlap; {remedies.apart}"
    sizes = [bounding_box_diagonal(mesh.verts) for mesh in (source, target)]
    if sizes[0] > _MUCH_LARGER * sizes[1]:
        yield (
            f"the source is {sizes[0] / sizes[1]:.3g} times as large as the target (diagonals {sizes[0]:.3g} and "
            f"{sizes[1]:.3g} in the normalised frame); {remedies.too_large}"
        )
    elif sizes[1] > _MUCH_SMALLER * sizes[0] > 0:
        yield (
            f"the target is {sizes[1] / sizes[0]:.3g} times as large as the source (diagonals {sizes[1]:.3g} and "
            f"{sizes[0]:.3g} in the normalised frame); {remedies.too_small}"
        )


def _openings(source: Mesh, target: Mesh | PointCloud, remedies: Remedies) -> Iterator[str]:
    """Yield that a source is closed and its target open, and which source keeps the openings."""
    if not Topology.of(source).is_watertight:
        return
    covers = "and the source is closed, so it will cover what is open"
    if isinstance(target, PointCloud):
        if unseen := unseen_of_open_cloud(target):
            shows = f"it shows {1 - unseen:.0%} of a closed surface around it"
            yield f"the points show an open surface ({shows}), {covers}; {remedies.open_points}"
        return
    openings = int(Topology.of(target).boundary_edges.sum()) and TopologyCounts.of(Topology.of(target)).openings
    if openings:
        yield f"the target is open ({count_text(openings, 'opening')}), {covers}; {remedies.open_surface}"
