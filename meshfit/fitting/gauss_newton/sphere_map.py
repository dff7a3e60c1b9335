"""A map of a closed surface of genus 0 to the sphere, one to one, with as little distortion as can be.

It lets the source's connectivity be put on a surface that has been remeshed: where a vertex of the source is on the
sphere, there it is on the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import SparsityPattern, conjugate_gradients
from meshfit.fitting.gauss_newton.surface import Connectivity
from meshfit.mesh.geometry import face_areas
from meshfit.mesh.manifold import euler_number, is_watertight, num_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import Topology
from meshfit.remeshing.triangle_geometry import dot, turned_over, unit

_TOLERANCE, _MOST_ITERATIONS, _HALVINGS = 1e-3, 400, 24
_GAIN, _PATIENCE = 1e-3, 3
_BLOCK = 256
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class SphereMap:
    """Faces of a surface and of the sphere, side by side.

    The symmetric Dirichlet energy |J|² + |J⁻¹|² of the map's Jacobians, weighted by area on the surface, is lowered
    by reweighted least squares (Rabinovich, Poranne, Panozzo and Sorkine-Hornung, Scalable locally injective mappings,
    2017). It grows without bound before a face turns over, so that the map stays one to one.

    Attributes:
        pattern: of the surface's connectivity.
        verts: (V, 3) the surface, in float64.
        lengths: (V,) lengths in which the surface is measured there, if they differ: where they are short, more of the
            sphere goes.
        power: of the energy density in the sum that is lowered: above 1, faces far worse than others count for more.
    """

    pattern: SparsityPattern
    verts: Float64[Tensor, "V 3"]
    lengths: Float64[Tensor, " V"] | None = None
    power: float = 2.0

    @cached_property
    def _gradients(self) -> tuple[Tensor, Tensor]:
        """(F, 3, 2) the gradients of the corners' hat functions on faces scaled to the sphere's area; (F,) weights."""
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
        """The faces of the surface."""
        return self.pattern.connectivity.faces

    def energy(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """(F,) the energy density of each face, at least 4, and (F, 3, 2) the Jacobians.

        The map is taken to the plane that touches the sphere above the middle of the face, where a face has no area
        just when its corners lie on one great circle; that of the chords does not vanish there.
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
        """The mean energy density over the surface, 4 at least."""
        return float((self._gradients[1] * self.energy(places)[0]).sum())

    def improved(self, places: Float64[Tensor, "V 3"], most: int) -> Float64[Tensor, "V 3"]:
        """Lower the energy by some steps, fewer where it hardly falls any more.

        Args:
            places: (V, 3) on the unit sphere, no face of which is turned over.
            most: steps.
        """
        idle = 0
        for _ in range(most):
            density, jacobian = self.energy(places)
            before = float(self._total(density))
            places, energy = self._along(places, self._step(places, jacobian, density), before)
            idle = idle + 1 if energy > before * (1 - _GAIN) else 0
            if idle == _PATIENCE:
                break
        return places

    def _step(self, places: Tensor, jacobian: Tensor, density: Tensor) -> Tensor:
        """The step to the least of the reweighted quadratic energy, along the sphere.

        Its right side is the gradient of the energy itself, so that the energy falls along it: that of the quadratic
        one takes the planes that the map is seen in for fixed, which misleads where faces are nearly needles.
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
        halves = [torch.stack([matrix[:, i, j] for i, j in _UPPER], 1) for matrix in (shared, metric)]
        blocks = self.pattern.blocks(halves[0][:, :, None] * halves[1][:, None, :])
        return self._solved(places, blocks, -self._slope(places) / (2 * self.power * usual ** (self.power - 1)))

    def _slope(self, places: Tensor) -> Tensor:
        """(V, 3) the gradient of the energy."""
        with torch.enable_grad():
            at = places.detach().requires_grad_()
            (slope,) = torch.autograd.grad(self._total(self.energy(at)[0]), at)
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
        inverse = torch.linalg.inv(blocks[self.pattern.diagonal])
        return conjugate_gradients(
            self.pattern.times(blocks),
            (along @ pull[:, :, None])[:, :, 0],
            lambda r: (inverse @ r[:, :, None])[:, :, 0],
            _TOLERANCE,
            _MOST_ITERATIONS,
        )[0]

    def _along(self, places: Tensor, step: Tensor, before: float) -> tuple[Tensor, float]:
        """Where a step leads that is cut until no face turns over and the energy falls, and that energy."""
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
        """The face on which each point of the sphere lies, and the weights of its corners.

        Args:
            places: (V, 3) the verts on the sphere.
            points: (N, 3) on the sphere.
        """
        a, b, c = (places[self.faces[:, k]] for k in range(3))
        sides = [torch.linalg.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))]
        found = [_inside(block, sides) for block in torch.split(points, _BLOCK)]
        return torch.cat([face for face, _ in found]), torch.cat([weights for _, weights in found])


def _inside(points: Tensor, sides: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """The cone of three planes that each point is inside of, or least outside, and its weights there."""
    weights = torch.stack([points @ side for side in sides], 2)
    total = weights.sum(2)
    least = (weights.amin(2) / total.abs().clamp_min(1e-30)).masked_fill(total <= 0, -torch.inf)
    face = least.argmax(1)
    found = weights[torch.arange(len(points), device=face.device), face].clamp_min(0)
    return face, found / found.sum(1, keepdim=True)


# Of the plane's map, first with all faces alike, then with the worst counting for more.
_STEPS = 40
# The mean energy density above which a map is of no use; that of an isometry is 4.
_USEFUL = 100.0


def initial_sphere_map(mesh: Mesh) -> Float64[Tensor, "V 3"] | None:
    """Where the verts of a mesh are on the unit sphere, such that no face is turned over.

    They are where rays from their mean meet it, if that is one to one. Else the mesh, less a face near its middle, is
    laid out in a triangle with each vertex at the mean of its neighbours, where no face turns over (Tutte, How to draw
    a graph, 1963; Floater, Parametrization and smooth approximation of surface triangulations, 1997), taken to the
    sphere by stereographic projection, and bettered as `SphereMap` does, which takes seconds for thousands of verts.

    Args:
        mesh: a manifold.

    Returns:
        (V, 3), or None where the mesh is no closed surface of genus 0 in one piece, or no useful map is found.
    """
    topology = Topology.of(mesh)
    if not (is_watertight(topology) and num_components(topology) == 1 and euler_number(topology) == 2):
        return None
    verts, faces = torch.tensor(mesh.verts), torch.tensor(mesh.faces)
    found = unit(verts - verts.mean(0))
    if not bool(turned_over(found, faces).any()):
        return found
    found = _from_plane(torch.tensor(_laid_out(mesh, topology)))
    if bool(turned_over(found, faces).any()):
        return None
    pattern = SparsityPattern(Connectivity(faces, len(verts), verts.dtype))
    for power in (1.0, 2.0):
        sphere = SphereMap(pattern, verts, power=power)
        found = sphere.improved(found, _STEPS)
    return found if sphere.distortion(found) < _USEFUL else None


def _laid_out(mesh: Mesh, topology: Topology) -> Float64[np.ndarray, "V 2"]:
    """Places in the plane, the corners of a face near the middle outermost, the way round that suits `_from_plane`."""
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
    """Stereographic projection, of which half the verts go to either half of the sphere."""
    middle = places.quantile(0.5, dim=0)
    offset = places - middle
    offset = offset / offset.norm(dim=1).quantile(0.5)
    square = offset.square().sum(1, keepdim=True)
    found: Tensor = torch.cat([2 * offset, square - 1], 1) / (1 + square)
    return found
