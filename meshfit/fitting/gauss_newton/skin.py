"""Skins of thin targets: surfaces around them whose two sides stay apart, so that a closed source can cover both.

The two sides of a plank are nearer to each other than a step is long, and those of a sheet coincide. A closed surface
that is pulled onto them would pass through itself, so its steps are refused and it stays where it is.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from meshfit.fitting.gauss_newton.schedule import Stage
from meshfit.fitting.gauss_newton.target import TargetBoundary, TargetCloud
from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.fitting.problem import Problem
from meshfit.fitting.settings import GaussNewtonSettings
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas, face_normals, signed_volume
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import piece_of_face
from meshfit.mesh.proximity import nearest_on_surface, point_distances, winding_numbers
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import NONE, Topology
from meshfit.remeshing.triangle_geometry import dot, unit

# Half the thickness of a skin, as a share of the diagonal: on the rough shape, on the levels, and in the last steps.
_ROUGH, _LEVELS, _LAST = 0.01, 0.005, 0.001
# A target is thin if its thickness is below this share of the diagonal on more than the second share of its area.
_THIN, _LEAST_SHARE = 0.01, 0.25
# Both sides of an open piece are covered if the mean of the winding numbers on the two is less than this: it is 0 for a
# sheet, 0.3 for half a sphere and 0.5 for a closed surface.
_ENCLOSES = 0.4
# Samples that tell so, and their distance from the surface in diagonals.
_SAMPLES, _OFF = 4000, 0.002
# Points of the target that the opposite side is looked for among.
_OPPOSITE = 20_000
# A source with volume that is nearer to the target than this share of the diagonal is a template: the target shows a
# part of it. It has volume if its mean thickness is more than that share.
_TEMPLATE = 0.05
# Consecutive multiples of it are evenly spread modulo 1.
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class Rim:
    """The rim of open pieces, along which the two sides of a skin meet.

    Attributes:
        points: (N, 3) evenly spaced points along it.
        across: (N, 3) unit normals of the target there.
        outward: (N, 3) unit vectors that point away from the target, in its surface.
        length: of the whole rim.
    """

    points: Float[Tensor, "N 3"]
    across: Float[Tensor, "N 3"]
    outward: Float[Tensor, "N 3"]
    length: float

    @classmethod
    def of(cls, pieces: Mesh, cloud: TargetCloud) -> "Rim":
        """Return the rim of open pieces of the target of a cloud."""
        boundary = TargetBoundary.of(pieces, cloud.points.dtype, cloud.points.device)
        assert boundary is not None  # noqa: S101  every piece is open
        topology = Topology.of(pieces)
        tail, head = topology.edges[topology.faces_per_edge == 1].T
        faces = nearest_on_surface(pieces, boundary.points.cpu().double().numpy()).faces
        across = boundary.points.new_tensor(face_normals(pieces)[faces])
        outward = unit(torch.linalg.cross(boundary.tangents, across))
        inside = boundary.points.new_tensor(pieces.verts[pieces.faces[faces]].mean(axis=1))
        inwards = dot(outward, inside - boundary.points) > 0
        outward = torch.where(inwards[:, None], -outward, outward)
        length = float(np.linalg.norm(pieces.verts[tail] - pieces.verts[head], axis=1).sum())
        return cls(boundary.points, across, outward, length)

    def strip(self, half: float, spacing: float) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "M 3"]]:
        """Return points of a strip along the rim, and their normals.

        Args:
            half: half the width of the strip.
            spacing: mean distance of neighbouring points.
        """
        count = int(min(self.length * 2 * half / spacing**2, 20 * len(self.points)))
        number = torch.arange(count, device=self.points.device)
        rows = number * len(self.points) // max(count, 1)
        height = half * (2 * (number * _GOLDEN % 1) - 1).to(self.points)
        return self.points[rows] + height[:, None] * self.across[rows], self.outward[rows]


@dataclass(frozen=True, eq=False)
class Skin:
    """A thin target as a closed surface around it.

    Attributes:
        cloud: points of the target.
        rows: (N,) point of the target that each point of the skin belongs to: two on the sides of an open piece.
        normals: (N, 3) their unit normals.
        gaps: (N,) their distances from the middle between both sides of the target.
        num_drawn: number of points that are drawn; they come first.
        rim: of open pieces, if there are any.
        diagonal: of the target's bounding box.
    """

    cloud: TargetCloud
    rows: Int64[Tensor, " N"]
    normals: Float[Tensor, "N 3"]
    gaps: Float[Tensor, " N"]
    num_drawn: int
    rim: Rim | None
    diagonal: float
    _clouds: dict[float, TargetCloud] = field(default_factory=dict)

    @property
    def note(self) -> str:
        """Note on a fit to it, for the verdict."""
        what = "thin" if self.rim is None else "open"
        apart = f"at least {200 * _LAST:.1g} % of the diagonal apart"
        return f"the target is {what}: the result, which is closed, covers both of its sides, {apart}"

    def at(self, stage: Stage) -> TargetCloud:
        """Return the points of the skin at a stage; it is thick first, as long as steps and edges are."""
        half = _ROUGH if stage.attempt is not None else _LAST if stage.is_last else _LEVELS
        if half not in self._clouds:
            self._clouds[half] = self.of_thickness(half * self.diagonal)
        return self._clouds[half]

    def of_thickness(self, half: float) -> TargetCloud:
        """Return its points, no nearer to the middle between both sides than half the thickness."""
        lift = (half - self.gaps).clamp_min(0)
        points, normals = self.cloud.points[self.rows] + lift[:, None] * self.normals, self.normals
        count = self.num_drawn
        if self.rim is not None:
            of_rim = self.rim.strip(half, self.cloud.spacing)
            points, normals = (
                torch.cat([values[:count], more, values[count:]])
                for values, more in zip((points, normals), of_rim, strict=True)
            )
            count += len(of_rim[0])
        return replace(
            self.cloud,
            points=points,
            normals=normals,
            rim=None,
            boundary=None,
            num_drawn=count,
            faces=None,
            nearest=nearest_neighbour_search(points, scattered=True),
        )


def needs_skin(problem: Problem, target: Mesh, settings: GaussNewtonSettings) -> bool:
    """Return whether a fit from a source that is far from its target is to a skin of it, if that is thin.

    Those are fits from closed sources, pulled both ways; not of templates, which the target may show a part of.
    """
    registered = settings.register != "off" and (settings.register != "auto" or problem.own)
    if registered or settings.direction != "both" or settings.offset or problem.images is not None:
        return False
    if not Topology.of(problem.source).is_watertight:
        return False
    away = _TEMPLATE * bounding_box_diagonal(target.verts)
    thickness = 2 * abs(signed_volume(problem.source)) / float(face_areas(problem.source).sum())
    points = sample_surface(target, _SAMPLES, np.random.default_rng(0)).points
    return thickness < away or float(point_distances(problem.source, points).mean()) > away


def skin_of(target: Mesh, cloud: TargetCloud) -> Skin | None:
    """Return the skin of a target; None if hardly any of it is thin.

    Args:
        target: the target.
        cloud: its points.
    """
    assert cloud.faces is not None  # noqa: S101  those of a mesh
    diagonal = bounding_box_diagonal(target.verts)
    two_sided = _two_sided(target, diagonal)
    few = np.arange(0, cloud.num_drawn, max(1, cloud.num_drawn // _SAMPLES))
    thin = two_sided[cloud.faces[few]] | (_gaps(cloud, diagonal, few) < _THIN / 2 * diagonal)
    if thin.mean() < _LEAST_SHARE:
        return None
    rows = np.arange(len(cloud.faces))
    double, drawn = two_sided[cloud.faces], rows < cloud.num_drawn
    gaps = np.zeros(len(rows))
    gaps[~double] = _gaps(cloud, diagonal, rows[~double])
    parts = [rows[drawn], rows[double & drawn], rows[~drawn], rows[double & ~drawn]]
    side = np.repeat([1.0, -1.0, 1.0, -1.0], [len(part) for part in parts])
    of_skin = torch.tensor(np.concatenate(parts), device=cloud.points.device)
    return Skin(
        cloud=cloud,
        rows=of_skin,
        normals=cloud.normals[of_skin] * torch.tensor(side).to(cloud.normals)[:, None],
        gaps=torch.tensor(gaps).to(cloud.points)[of_skin],
        num_drawn=len(parts[0]) + len(parts[1]),
        rim=Rim.of(Mesh(target.verts, target.faces[two_sided]), cloud) if two_sided.any() else None,
        diagonal=diagonal,
    )


def _gaps(cloud: TargetCloud, diagonal: float, rows: Int64[np.ndarray, " M"]) -> Float64[np.ndarray, " M"]:
    """Return half the thickness of the target at some of its points; infinity where it is much more than thin."""
    points, normals = (values.cpu().double().numpy() for values in (cloud.points, cloud.normals))
    step = max(1, cloud.num_drawn // _OPPOSITE)
    reach = max(2 * _THIN * diagonal, 2 * cloud.spacing * step**0.5)
    opposite, gaps = np.arange(0, cloud.num_drawn, step), np.full(len(rows), np.inf)
    tree = cKDTree(np.hstack([points[opposite], reach * normals[opposite]]))
    mirrored = np.hstack([points[rows], -reach * normals[rows]])
    found = np.asarray(tree.query(mirrored, distance_upper_bound=1.5 * reach)[1])
    hit = np.flatnonzero(found < len(opposite))
    away = points[opposite[found[hit]]] - points[rows[hit]]
    depth = -(away * normals[rows[hit]]).sum(axis=1)
    inwards = depth > -np.finfo(np.float32).eps * diagonal
    gaps[hit[inwards]] = depth[inwards].clip(0) / 2
    return gaps


def _two_sided(target: Mesh, diagonal: float) -> Bool[np.ndarray, " F"]:
    """Return which faces are of open pieces that enclose so little that both of their sides are outside."""
    count, piece = piece_of_face(target)
    at_rim = (Topology.of(target).twin.reshape(-1, 3) == NONE).any(axis=1)
    is_open = np.bincount(piece, weights=at_rim, minlength=count) > 0
    if not is_open.any():
        return np.zeros(target.num_faces, dtype=bool)
    samples = sample_surface(target, _SAMPLES, np.random.default_rng(0))
    off = _OFF * diagonal * face_normals(target)[samples.faces]
    sides = np.concatenate([samples.points + off, samples.points - off])
    mean = np.abs(winding_numbers(target, sides).reshape(2, -1).mean(axis=0))
    of_samples = piece[samples.faces]
    number = np.bincount(of_samples, minlength=count)
    enclosed = np.bincount(of_samples, weights=mean, minlength=count) / np.maximum(number, 1)
    return np.asarray((is_open & (enclosed < _ENCLOSES))[piece])
