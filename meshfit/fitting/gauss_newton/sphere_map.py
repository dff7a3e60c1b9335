"""Sphere maps: one-to-one maps from closed surfaces of genus 0 to the unit sphere, with low distortion.

They transfer the source's connectivity to a surface that has been remeshed: corresponding vertices have the same place
on the sphere.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import UPPER, SparsityPattern, conjugate_gradients
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import euler_number, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import dot, turned_over, unit

_TOLERANCE, _MOST_ITERATIONS, _HALVINGS = 1e-3, 400, 24
_GAIN, _PATIENCE = 1e-3, 3
# Points that are located at once.
_BLOCK = 256
# Steps that improve the initial map, for each power of the energy.
_INITIAL_STEPS = 40
# Mean energy density above which a map is useless; that of an isometry is 4.
_USEFUL = 100.0


def initial_sphere_map(mesh: Mesh) -> Float64[Tensor, "V 3"] | None:
    """Map the vertices of a mesh to the unit sphere such that no face is turned over.

    The map is the central projection from the mean of the vertices, if that is one to one. Otherwise, the mesh without
    a face near its middle is laid out in a triangle with each vertex at the mean of its neighbours, which turns no face
    over (Tutte, How to draw a graph, 1963; Floater, Parametrization and smooth approximation of surface triangulations,
    1997), taken to the sphere by stereographic projection, and improved as a `SphereMap`, in seconds for thousands of
    vertices.

    Args:
        mesh: a manifold.

    Returns:
        (V, 3), or None if the mesh is not a connected closed surface of genus 0, or no useful map is found.
    """
    topology = Topology.of(mesh)
    if not (topology.is_watertight and num_components(topology) == 1 and euler_number(topology) == 2):
        return None
    verts, faces = torch.tensor(mesh.verts), torch.tensor(mesh.faces)
    places = unit(verts - verts.mean(0))
    if not bool(turned_over(places, faces).any()):
        return places
    places = _from_plane(torch.tensor(_tutte_embedding(mesh, topology)))
    if bool(turned_over(places, faces).any()):
        return None
    pattern = SparsityPattern(Connectivity(faces, len(verts), verts.dtype))
    for power in (1.0, 2.0):
        sphere = SphereMap(pattern, verts, power=power)
        places = sphere.improved(places, _INITIAL_STEPS)
    return places if sphere.distortion(places) < _USEFUL else None


def _tutte_embedding(mesh: Mesh, topology: Topology) -> Float64[np.ndarray, "V 2"]:
    """Return a planar layout whose outer triangle is a face near the middle, oriented as `_from_plane` requires."""
    area, middles = face_areas(mesh), mesh.verts[mesh.faces].mean(1)
    centre = np.average(middles, axis=0, weights=area)
    outer = mesh.faces[np.linalg.norm(middles - centre, axis=1).argmin()]
    count, (tail, head) = mesh.num_verts, topology.edges.T
    ends = np.concatenate([tail, head]), np.concatenate([head, tail])
    adjacent = coo_array((np.ones(len(ends[0])), ends), shape=(count, count))
    matrix = (diags_array(adjacent.sum(axis=0)) - adjacent).tocsr()
    inner = np.setdiff1d(np.arange(count), outer)
    places = np.zeros((count, 2))
    angles = np.array([0.0, 2.0, 4.0]) * np.pi / 3
    places[outer] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    right = -(matrix[inner][:, outer] @ places[outer])
    places[inner] = spsolve(matrix[inner][:, inner].tocsc(), right)
    return places


def _from_plane(places: Float64[Tensor, "V 2"]) -> Float64[Tensor, "V 3"]:
    """Project stereographically such that half of the vertices go to each hemisphere."""
    middle = places.quantile(0.5, dim=0)
    offset = places - middle
    offset = offset / offset.norm(dim=1).quantile(0.5)
    square = offset.square().sum(1, keepdim=True)
    on_sphere: Tensor = torch.cat([2 * offset, square - 1], 1) / (1 + square)
    return on_sphere


@dataclass(frozen=True, eq=False)
class SphereMap:
    """The distortion of maps from a surface to the sphere, and its minimisation.

    Distortion is the symmetric Dirichlet energy |J|² + |J⁻¹|² of the map's Jacobians, weighted by area on the surface.
    It is minimised by reweighted least squares (Rabinovich, Poranne, Panozzo and Sorkine-Hornung, Scalable locally
    injective mappings, 2017). It tends to infinity before a face turns over, so the map stays one to one.

    Attributes:
        pattern: sparsity pattern of the surface.
        verts: (V, 3) its positions, in float64.
        lengths: (V,) local unit of length on the surface, if it varies; where it is short, the surface gets more of the
            sphere.
        power: power of the energy density in the minimised sum; above 1, the worst faces count for more.
    """

    pattern: SparsityPattern
    verts: Float64[Tensor, "V 3"]
    lengths: Float64[Tensor, " V"] | None = None
    power: float = 2.0

    @cached_property
    def _gradients(self) -> tuple[Tensor, Tensor]:
        """(F, 3, 2) gradients of hat functions, with the surface scaled to the sphere's area; (F,) weights."""
        a, b, c = (self.verts[self.faces[:, k]] for k in range(3))
        ab, ac = b - a, c - a
        across = torch.linalg.cross(ab, ac)
        double_area, side = across.norm(dim=1), ab.norm(dim=1)
        x = ab / side[:, None]
        flat = torch.zeros(len(ab), 2, 2, dtype=ab.dtype, device=ab.device)
        flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1] = side, dot(ac, x), double_area / side
        if self.lengths is not None:
            lengths = self.lengths[self.faces].mean(1)
            flat, double_area = flat / lengths[:, None, None], double_area / lengths.square()
        scale = (8 * torch.pi / double_area.sum()).sqrt()
        inverse = torch.linalg.inv(flat * scale)
        corners = torch.stack([-(inverse[:, 0] + inverse[:, 1]), inverse[:, 0], inverse[:, 1]], 1)
        return corners, double_area / double_area.sum()

    @property
    def faces(self) -> Int64[Tensor, "F 3"]:
        """Faces of the surface."""
        return self.pattern.connectivity.faces

    def energy(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """Return the (F,) energy density of each face, at least 4, and the (F, 3, 2) Jacobians.

        Faces are projected to the plane that touches the sphere above their middle. There, unlike in the plane of
        their chords, a face has no area exactly if its corners lie on one great circle.
        """
        corners = places[self.faces]
        outward = unit(corners.sum(1))
        jacobian = torch.einsum("fkc,fkx->fxc", self._gradients[0], corners)
        jacobian = jacobian - outward[:, :, None] * (outward[:, None, :] @ jacobian)
        metric = jacobian.transpose(1, 2) @ jacobian
        trace = metric[:, 0, 0] + metric[:, 1, 1]
        determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1].square()
        return trace + trace / determinant.clamp_min(1e-300), jacobian

    def distortion(self, places: Float64[Tensor, "V 3"]) -> float:
        """Return the mean energy density over the surface, at least 4."""
        return float((self._gradients[1] * self.energy(places)[0]).sum())

    def improved(self, places: Float64[Tensor, "V 3"], most: int) -> Float64[Tensor, "V 3"]:
        """Lower the energy by some steps; stop early once it hardly falls.

        Args:
            places: (V, 3) places on the unit sphere, with no face turned over.
            most: largest number of steps.
        """
        idle = 0
        for _ in range(most):
            density, jacobian = self.energy(places)
            before = float(self._total(density))
            places, energy = self._line_search(places, self._step(places, jacobian, density), before)
            idle = idle + 1 if energy > before * (1 - _GAIN) else 0
            if idle == _PATIENCE:
                break
        return places

    def _step(self, places: Tensor, jacobian: Tensor, density: Tensor) -> Tensor:
        """Return the step to the minimum of the reweighted quadratic energy, along the sphere.

        The right side is the gradient of the energy itself, so that the energy falls along the step. The gradient of
        the quadratic energy takes the projection planes for fixed, which misleads where faces are nearly needles.
        """
        corners, area = self._gradients
        usual = density.median()
        area = area * (density / usual) ** (self.power - 1)
        squares, right = torch.linalg.eigh(jacobian.transpose(1, 2) @ jacobian)
        stretch = squares.clamp_min(1e-16).sqrt()
        left = (jacobian @ right) / stretch[:, None, :]
        away = torch.where((stretch - 1).abs() < 1e-4, 1 + 1e-3, stretch)
        slopes = ((away - away**-3) / (away - 1)).clamp(1e-6, 1e8)
        normal = torch.linalg.cross(left[:, :, 0], left[:, :, 1])
        metric = torch.einsum("fxs,fs,fys->fxy", left, slopes, left)
        metric = metric + slopes.amin(1)[:, None, None] * normal[:, :, None] * normal[:, None, :]
        shared = torch.einsum("fkc,flc->fkl", corners, corners) * area[:, None, None]
        halves = [torch.stack([matrix[:, i, j] for i, j in UPPER], 1) for matrix in (shared, metric)]
        blocks = self.pattern.blocks(halves[0][:, :, None] * halves[1][:, None, :])
        return self._solved(places, blocks, -self._slope(places) / (2 * self.power * usual ** (self.power - 1)))

    def _slope(self, places: Tensor) -> Tensor:
        """Return the (V, 3) gradient of the energy."""
        with torch.enable_grad():
            variable = places.detach().requires_grad_()
            (slope,) = torch.autograd.grad(self._total(self.energy(variable)[0]), variable)
        return slope

    def _total(self, density: Tensor) -> Tensor:
        return (self._gradients[1] * density**self.power).sum()

    def _solved(self, places: Tensor, blocks: Tensor, pull: Tensor) -> Tensor:
        eye = torch.eye(3, dtype=places.dtype, device=places.device)
        outward = places[:, :, None] * places[:, None, :]
        along = eye - outward
        blocks = along[self.pattern.rows] @ blocks @ along[self.pattern.columns]
        size = blocks[self.pattern.diagonal].diagonal(dim1=1, dim2=2).sum(1) / 2
        blocks[self.pattern.diagonal] += size[:, None, None] * outward + 1e-9 * eye
        times, right = self.pattern.times(blocks), (along @ pull[:, :, None])[:, :, 0]
        return conjugate_gradients(times, right, blocks[self.pattern.diagonal], _TOLERANCE, _MOST_ITERATIONS)[0]

    def _line_search(self, places: Tensor, step: Tensor, before: float) -> tuple[Tensor, float]:
        """Halve a step until no face turns over and the energy falls; return the places and the energy."""
        share = 1.0
        for _ in range(_HALVINGS):
            moved = unit(places + share * step)
            if not bool(turned_over(moved, self.faces).any()):
                energy = float(self._total(self.energy(moved)[0]))
                if energy < before:
                    return moved, energy
            share /= 2
        return places, before

    def located(
        self, places: Float64[Tensor, "V 3"], points: Float64[Tensor, "N 3"]
    ) -> tuple[Int64[Tensor, " N"], Float64[Tensor, "N 3"]]:
        """Return the face on which each point of the sphere lies, and its barycentric coordinates.

        Args:
            places: (V, 3) vertices on the sphere.
            points: (N, 3) points on the sphere.
        """
        from meshfit.mesh.proximity import nearest_on_surface  # brings libigl

        a, b, c = (places[self.faces[:, k]] for k in range(3))
        sides = torch.stack([torch.linalg.cross(p, q) for p, q in ((b, c), (c, a), (a, b))])
        # The face with the nearest point is nearly always the one that is looked for; for others, all are tried.
        flat = Mesh(places.cpu().numpy(), self.faces.cpu().numpy())
        face = torch.from_numpy(nearest_on_surface(flat, points.cpu().numpy()).faces).to(points.device)
        weights = torch.stack([dot(points, side[face]) for side in sides], 1)
        missed = (weights.amin(1) < 0).nonzero()[:, 0]
        for rows in torch.split(missed, _BLOCK):
            face[rows], weights[rows] = _inside(points[rows], sides)
        return face, weights / weights.sum(1, keepdim=True)


def _inside(points: Tensor, sides: Float64[Tensor, "3 F 3"]) -> tuple[Tensor, Tensor]:
    """Return the cone of three planes that each point is inside, or least outside, and its weights there, at least 0.

    Args:
        points: (N, 3).
        sides: (3, F, 3) normals of the planes of each cone, inwards.
    """
    weights = torch.stack([points @ side.T for side in sides], 2)
    total = weights.sum(2)
    least = (weights.amin(2) / total.abs().clamp_min(1e-30)).masked_fill(total <= 0, -torch.inf)
    face = least.argmax(1)
    return face, weights[torch.arange(len(points), device=face.device), face].clamp_min(0)
