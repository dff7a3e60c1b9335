"""The target of a step: points with normals, on a mesh or of a scan, and its boundary as points with tangents."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import cKDTree
from torch import Generator, Tensor

from meshfit.fitting.nearest_neighbours import nearest_neighbour_search
from meshfit.mesh.denoised_cloud import denoised_cloud
from meshfit.mesh.geometry import face_areas, face_normals, unit_vectors, vert_area_vectors
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.noise import NEIGHBOURHOOD, noise_of_mesh, noise_of_points, smoothed_normals
from meshfit.mesh.outliers import spikes, stray_points
from meshfit.mesh.point_cloud import PointCloud, rim_of, sampled_areas
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import dot, length_of, unit

_POINTS = 200_000
_BOUNDARY_POINTS = 5000
# Points of a mesh within this many mean distances of samples from its boundary are on the rim.
_RIM = 2.0
# Points are beyond the rim if they are aside of its points by more than this many mean distances of points.
_BEYOND = 2.0
# Normals of a mesh are smoothed over a disc of this many standard deviations of its noise, by at most so many rounds.
_MOST_SMOOTHINGS = 30
# Fairness that noise asks for: 3 at 10,000 vertices, for 28,000 points with noise of 0.1 % of the diagonal.
_NOISE_FAIRNESS = 3.0 / ((1e-6 / 28_000) ** 0.4 * 1e8)
_MOST_FAIRNESS = 32.0


@dataclass(frozen=True, eq=False)
class TargetBoundary:
    """The boundary of a target.

    Attributes:
        points: (N, 3) evenly spaced points along it.
        tangents: (N, 3) unit tangents.
    """

    points: Float[Tensor, "N 3"]
    tangents: Float[Tensor, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, dtype: torch.dtype, device: torch.device) -> "TargetBoundary | None":
        """Return the boundary of a mesh; None if it has none."""
        topology = Topology.of(mesh)
        edges = topology.edges[topology.faces_per_edge == 1]
        if not len(edges):
            return None
        start, side = mesh.verts[edges[:, 0]], mesh.verts[edges[:, 1]] - mesh.verts[edges[:, 0]]
        length = np.linalg.norm(side, axis=1)
        total = length.cumsum()
        arc = (np.arange(_BOUNDARY_POINTS) + 0.5) * (total[-1] / _BOUNDARY_POINTS)
        edge = np.searchsorted(total, arc).clip(max=len(edges) - 1)
        along = 1 - (total[edge] - arc) / np.maximum(length[edge], np.finfo(float).tiny)
        points = torch.tensor(start[edge] + along[:, None] * side[edge], dtype=dtype, device=device)
        return cls(points, unit(torch.tensor(side[edge], dtype=dtype, device=device)))


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Points on a target: samples of its faces, uniform by area, then its vertices; or the points of a scan.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit normals; at vertices, the area-weighted mean of the face normals.
        rim: (N,) which points are at a boundary, beyond which the target is not known; None if there is none.
        areas: (M,) cumulative area that the first M points stand for, which are drawn; None if it is the same for all.
        num_drawn: M.
        boundary: the target's boundary, if it is a mesh that has one.
        spacing: mean distance of neighbouring points.
        noise: standard deviation of its points across the surface; 0 if there is none to speak of.
        num_independent: number of its points whose noise is independent.
        num_outliers: number of vertices or points that were left out.
        faces: (N,) a face of the target at each point; None for a scan.
        nearest: maps (M, 3) points to the (M,) indices of the nearest points of the cloud.
    """

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]
    rim: Bool[Tensor, " N"] | None
    areas: Float64[Tensor, " M"] | None
    num_drawn: int
    boundary: TargetBoundary | None
    spacing: float
    noise: float
    num_independent: int
    num_outliers: int
    faces: Int64[np.ndarray, " N"] | None
    nearest: Callable[[Tensor], Tensor]

    def lifted(self, offset: float) -> "TargetCloud":
        """Return the points moved along their normals, outwards if the offset is above 0; without the boundary."""
        points = self.points + offset * self.normals
        nearest = nearest_neighbour_search(points, scattered=True)
        return replace(self, points=points, boundary=None, nearest=nearest)

    @classmethod
    def of(
        cls,
        target: Mesh | PointCloud,
        dtype: torch.dtype,
        device: torch.device,
        noise: float | None = None,
        *,
        robust: bool = True,
    ) -> "TargetCloud":
        """Return the points of a target, always the same.

        Args:
            target: mesh or scan.
            dtype: of the points.
            device: of the points.
            noise: standard deviation of the target's vertices or points across its surface; None to estimate it.
            robust: whether to leave out outliers: stray points of a scan, and spikes of a mesh that has noise.
        """
        if isinstance(target, PointCloud):
            return cls._of_points(target, dtype, device, noise, robust=robust)
        return cls._of_mesh(target, dtype, device, noise, robust=robust)

    @classmethod
    def _of_mesh(
        cls, mesh: Mesh, dtype: torch.dtype, device: torch.device, noise: float | None, *, robust: bool
    ) -> "TargetCloud":
        """Return one random point per stratum of equal area, and all vertices."""
        noise = noise_of_mesh(mesh) if noise is None else noise
        boundary, outliers, kept = TargetBoundary.of(mesh, dtype, device), 0, np.arange(mesh.num_faces)
        if noise and robust:
            spiky = spikes(mesh, noise)
            outliers = int(spiky.sum())
            # The holes that spikes leave are no boundary: what is around them closes them.
            kept = np.flatnonzero(~spiky[mesh.faces].any(axis=1))
            mesh = mesh if not outliers else Mesh(mesh.verts, mesh.faces[kept])
        samples = sample_surface(mesh, _POINTS, np.random.default_rng(0))
        normals = vert_area_vectors(mesh)
        used = normals.any(axis=1)
        of_faces = face_normals(mesh)
        if noise:
            normals = smoothed_normals(mesh, normals, _smoothing_rounds(mesh, noise))
            of_faces = unit_vectors(normals[mesh.faces].sum(axis=1))
        points = np.concatenate([samples.points, mesh.verts[used]])
        face_at = np.zeros(mesh.num_verts, dtype=np.int64)
        face_at[mesh.faces] = np.arange(mesh.num_faces)[:, None]
        normals = np.concatenate([of_faces[samples.faces], unit_vectors(normals[used])])
        cloud = torch.tensor(points, dtype=dtype, device=device)
        spacing = math.sqrt(float(face_areas(mesh).sum()) / _POINTS)
        rim = None
        if boundary is not None:
            nearest = boundary.points[nearest_neighbour_search(boundary.points)(cloud)]
            rim = (cloud - nearest).norm(dim=1) < _RIM * spacing
        return cls(
            points=cloud,
            normals=torch.tensor(normals, dtype=dtype, device=device),
            rim=rim,
            areas=None,
            num_drawn=_POINTS,
            boundary=boundary,
            spacing=spacing,
            noise=noise,
            num_independent=int(used.sum()),
            num_outliers=outliers,
            faces=kept[np.concatenate([samples.faces, face_at[used]])],
            nearest=nearest_neighbour_search(cloud, scattered=True),
        )

    @classmethod
    def _of_points(
        cls, scan: PointCloud, dtype: torch.dtype, device: torch.device, noise: float | None, *, robust: bool
    ) -> "TargetCloud":
        scan = scan.thinned()
        stray = stray_points(scan.verts) if robust else np.zeros(scan.num_verts, dtype=bool)
        scan = scan.subset(np.flatnonzero(~stray))
        noise = noise_of_points(scan.verts) if noise is None else noise
        scan = denoised_cloud(scan, noise)
        areas = sampled_areas(scan.verts)
        order = cKDTree(scan.verts).indices  # neighbours are close in memory, which makes queries fast
        cloud = torch.tensor(scan.verts[order], dtype=dtype, device=device)
        assert scan.normals is not None  # noqa: S101  oriented
        return cls(
            points=cloud,
            normals=torch.tensor(scan.normals[order], dtype=dtype, device=device),
            rim=torch.tensor(rim_of(scan)[order], device=device),
            areas=torch.tensor(areas[order].cumsum(), device=device),
            num_drawn=len(cloud),
            boundary=None,
            spacing=float(np.sqrt(np.median(areas))),
            noise=noise,
            num_independent=len(cloud),
            num_outliers=int(stray.sum()),
            faces=None,
            nearest=nearest_neighbour_search(cloud, scattered=True),
        )

    def draw(self, count: int, generator: Generator) -> Int64[Tensor, " C"]:
        """Draw some points, uniformly by area, in an order that makes queries fast."""
        uniform = torch.rand(count, generator=generator, dtype=torch.float64, device=generator.device)
        if self.areas is None:
            rows = (uniform * self.num_drawn).long()
        else:
            areas = self.areas.to(uniform.device)
            rows = torch.searchsorted(areas, uniform * areas[-1])
        return rows.clamp_max(self.num_drawn - 1).sort().values.to(self.points.device)

    def is_beyond(self, points: Float[Tensor, "M 3"], nearest: Int64[Tensor, " M"]) -> Bool[Tensor, " M"]:
        """Return which points lie beyond the rim: nearest to a point of it, but not above or below it.

        Args:
            points: (M, 3) any points.
            nearest: (M,) their nearest points of the cloud.
        """
        if self.rim is None:
            return torch.zeros_like(nearest, dtype=torch.bool)
        away, normals = points - self.points[nearest], self.normals[nearest]
        aside = away - dot(away, normals)[:, None] * normals
        return self.rim[nearest] & (length_of(aside) > _BEYOND * self.spacing)

    def least_fairness(self, num_verts: int) -> float:
        """Return the fairness below which a surface of some vertices would follow the noise; 0 without noise.

        A thin plate of fairness λ on V vertices averages noise over a disc whose radius grows with (λ / V²)^(1/4). The
        radius of least error grows with (σ² / N)^(1/10) for N points of noise σ, as the error by noise falls with its
        square and that by smoothing grows with its fourth power. The factor was fitted to scans with noise of 0.1 % to
        1 % of the diagonal.
        """
        if not self.noise:
            return 0.0
        size = float((self.points.amax(0) - self.points.amin(0)).norm())
        variance = (self.noise / size) ** 2 / self.num_independent
        return float(min(_NOISE_FAIRNESS * variance**0.4 * num_verts**2, _MOST_FAIRNESS))


def _smoothing_rounds(mesh: Mesh, noise: float) -> int:
    """Return the number of rounds that smooth normals over discs that reach beyond the noise."""
    tail, head = Topology.of(mesh).edges.T
    edge = float(np.median(np.linalg.norm(mesh.verts[tail] - mesh.verts[head], axis=1)))
    rounds = math.ceil((NEIGHBOURHOOD * noise / max(edge, np.finfo(float).tiny)) ** 2)
    return min(rounds, _MOST_SMOOTHINGS)
