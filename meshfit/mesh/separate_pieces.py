"""Separate pieces of a target: parts of a mesh or clusters of points with a gap between them, such as floaters."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from meshfit.mesh.cleaning_options import Keep
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh, SameContent
from meshfit.mesh.point_cloud import PointCloud, sampled_areas
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Indices, Topology
from meshfit.units import count_text

# Parts nearer to each other than this share of the extent are one piece; samples are half as far apart. The extent is
# that of the middle of the points, which floaters do not enlarge.
_GAP, _MIDDLE, _MOST_SAMPLES = 0.01, (0.05, 0.95), 400_000
# Points of a cloud are linked up to so many times the distance of this neighbour, where most of the area is.
_NEIGHBOURS, _LINK, _DRAWN = 6, 1.25, 2000
# A floater is smaller than this share of the largest piece, and farther from the larger ones than this share of the
# extent. Fewer points are outliers, which fits leave out themselves.
_SMALL, _FAR, _FEWEST = 0.05, 0.03, 10


@dataclass(frozen=True, eq=False)
class SeparatePieces:
    """Pieces of a target.

    Attributes:
        piece: (F,) the piece of each face of a mesh, or (V,) of each point of a cloud.
        sizes: area of each piece; of a cloud, the area that its points stand for.
        gaps: distance of each piece from the nearest one that is not small, relative to the extent; 0 for those.
    """

    piece: Indices
    sizes: Float64[np.ndarray, " P"]
    gaps: Float64[np.ndarray, " P"]

    def kept(self, keep: Keep) -> Bool[np.ndarray, " P"]:
        """Return (P,) which pieces are kept: all, the largest, or those of at least a share of its size."""
        if keep is None:
            return np.ones(len(self.sizes), dtype=bool)
        if keep == "largest":
            return np.asarray(np.arange(len(self.sizes)) == self.sizes.argmax())
        return np.asarray(self.sizes >= keep * self.sizes.max())


def separate_pieces(target: Mesh | PointCloud) -> SeparatePieces:
    """Return the pieces of a target: parts nearer to each other than 1 % of its extent are one."""
    if isinstance(target, PointCloud):
        return _pieces(SameContent(Mesh(target.verts, [])))
    return _pieces(SameContent(target))


def kept_pieces(target: Mesh | PointCloud, keep: Keep) -> Mesh | PointCloud:
    """Return a target with only some of its pieces.

    Args:
        target: a mesh, which loses its attributes if faces are dropped, or points.
        keep: `largest` for the piece of the largest area; a share from 0 to 1 for those of at least this share of it;
            None for all.
    """
    if keep is None:
        return target
    pieces = separate_pieces(target)
    kept = pieces.kept(keep)[pieces.piece]
    if kept.all():
        return target
    if isinstance(target, PointCloud):
        return target.subset(np.flatnonzero(kept))
    used, faces = np.unique(target.faces[kept], return_inverse=True)
    return Mesh(target.verts[used], faces.reshape(-1, 3))


def describe_floaters(target: Mesh | PointCloud) -> str:
    """Return how many small pieces are far off the others, in words; empty if there are none."""
    pieces = separate_pieces(target)
    floaters = pieces.gaps > _FAR
    if isinstance(target, PointCloud):
        floaters = floaters & (np.bincount(pieces.piece) >= _FEWEST)
    if not floaters.any():
        return ""
    share = 100 * float(pieces.sizes[floaters].sum() / pieces.sizes.sum())
    far = f"up to {pieces.gaps[floaters].max():.2g} of its extent away"
    return f"{count_text(int(floaters.sum()), 'small piece')} far off the others ({share:.2g} % of the area, {far})"


@lru_cache(maxsize=2)  # floaters are looked for and left out
def _pieces(content: SameContent) -> SeparatePieces:
    mesh = content.mesh
    if mesh.num_faces:
        topology = Topology.of(mesh)
        _, part_of_vert = graph_components(topology.edges[:, 0], topology.edges[:, 1], mesh.num_verts)
        areas = face_areas(mesh)
        parts, part = np.unique(part_of_vert[mesh.faces[:, 0]], return_inverse=True)
        if len(parts) == 1:
            return SeparatePieces(part, np.array([areas.sum()]), np.zeros(1))
        used = np.unique(mesh.faces)
        extent = _extent(sample_surface(mesh, _DRAWN, np.random.default_rng(0)).points)
        gap = max(_GAP * extent, 1e-300)
        wanted = int(min(_MOST_SAMPLES, 8 * areas.sum() / gap**2)) + 1
        samples = sample_surface(mesh, wanted, np.random.default_rng(0))
        points = np.concatenate([mesh.verts[used], samples.points])
        label = np.concatenate([np.searchsorted(parts, part_of_vert[used]), part[samples.faces]])
        weights = np.bincount(part, areas)
    else:
        points = mesh.verts
        if len(points) <= _FEWEST:
            return SeparatePieces(np.zeros(len(points), dtype=np.int64), np.ones(1), np.zeros(1))
        label = part = np.arange(len(points), dtype=np.int64)
        weights = sampled_areas(points)
        reach = np.asarray(cKDTree(points).query(points, k=_NEIGHBOURS + 1)[0])[:, -1]
        some = _by_area(weights)
        extent = _extent(points[some])
        gap = max(_GAP * extent, _LINK * float(np.quantile(reach[some], 0.9)))
    return _joined(part, weights, points, label, gap, extent)


def _joined(
    part: Indices,
    weights: Float64[np.ndarray, " M"],
    points: Float64[np.ndarray, "N 3"],
    label: Indices,
    gap: float,
    extent: float,
) -> SeparatePieces:
    """Join parts that come near each other.

    Args:
        part: (F,) or (V,) the part of each face or point.
        weights: area of each part.
        points: on the parts.
        label: the part of each.
        gap: largest distance of parts that are joined, above 0.
        extent: of the target.
    """
    cells = np.floor((points - points.min(axis=0)) / (gap / 2)).astype(np.int64)
    if len(weights) == len(points):  # points of a cloud: those of a cell are one part
        _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        cell = cell.reshape(-1)
        some, number = points[first], np.arange(len(first), dtype=np.int64)
        weights, part = np.asarray(np.bincount(cell, weights)), cell
    else:  # one point of a part in each cell
        _, first = np.unique(np.column_stack([label, cells]), axis=0, return_index=True)
        some, number = points[first], label[first]
    pairs = cKDTree(some).query_pairs(gap, output_type="ndarray")
    count, piece = graph_components(number[pairs[:, 0]], number[pairs[:, 1]], len(weights))
    sizes = np.bincount(piece, weights, count)
    small = sizes < _SMALL * sizes.max()
    gaps, of_point = np.zeros(count), piece[number]
    if small.any():
        near = small[of_point]
        distances = np.asarray(cKDTree(some[~near]).query(some[near])[0]) / extent
        gaps[small] = np.inf
        np.minimum.at(gaps, of_point[near], distances)
    return SeparatePieces(piece[part], sizes, gaps)


def _by_area(areas: Float64[np.ndarray, " N"]) -> Indices:
    """Return the numbers of some points, as many on equal areas."""
    total = areas.cumsum()
    at = (np.arange(_DRAWN) + 0.5) * (total[-1] / _DRAWN)
    return np.asarray(np.searchsorted(total, at).clip(max=len(areas) - 1), dtype=np.int64)


def _extent(points: Float64[np.ndarray, "N 3"]) -> float:
    low, high = np.quantile(points, _MIDDLE, axis=0)
    return float(np.linalg.norm(high - low))
