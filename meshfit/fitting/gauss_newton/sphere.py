"""A map of a closed surface of genus 0 to the sphere, one to one, with as little distortion as can be.

It lets the source's connectivity be put on a surface that has been remeshed: where a vertex of the source is on the
sphere, there it is on the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from meshfit.fitting.gauss_newton.equations import Pattern, conjugate_gradients
from meshfit.remeshing.shapes import dot, turned_over, unit

_TOLERANCE, _MOST_ITERATIONS, _HALVINGS = 1e-3, 400, 24
_GAIN, _PATIENCE = 1e-3, 3
# Shares of a full step below which the step is cut at the faces in its way, in place of everywhere.
_SHORT_STEP = 0.2
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
    """

    pattern: Pattern
    verts: Float64[Tensor, "V 3"]

    @cached_property
    def _gradients(self) -> tuple[Tensor, Tensor]:
        """(F, 3, 2) the gradients of the corners' hat functions on faces scaled to the sphere's area; (F,) weights."""
        a, b, c = (self.verts[self.faces[:, k]] for k in range(3))
        ab, ac = b - a, c - a
        across = torch.linalg.cross(ab, ac)
        double_area, side = across.norm(dim=1), ab.norm(dim=1)
        scale = (8 * torch.pi / double_area.sum()).sqrt()
        x = ab / side[:, None]
        flat = torch.zeros(len(ab), 2, 2, dtype=ab.dtype, device=ab.device)
        flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1] = side, dot(ac, x), double_area / side
        inverse = torch.linalg.inv(flat * scale)
        corners = torch.stack([-(inverse[:, 0] + inverse[:, 1]), inverse[:, 0], inverse[:, 1]], 1)
        return corners, double_area / double_area.sum()

    @property
    def faces(self) -> Int64[Tensor, "F 3"]:
        """The faces of the surface."""
        return self.pattern.connectivity.faces

    def energy(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """(F,) the energy density of each face, at least 4, and (F, 3, 2) the Jacobians."""
        jacobian = torch.einsum("fkc,fkx->fxc", self._gradients[0], places[self.faces])
        metric = jacobian.transpose(1, 2) @ jacobian
        trace = metric[:, 0, 0] + metric[:, 1, 1]
        determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1].square()
        return trace + trace / determinant.clamp_min(1e-30), jacobian

    def improved(self, places: Float64[Tensor, "V 3"], most: int) -> Float64[Tensor, "V 3"]:
        """Lower the energy by some steps, fewer where it hardly falls any more.

        Args:
            places: (V, 3) on the unit sphere, no face of which is turned over.
            most: steps.
        """
        weights, idle = self._gradients[1], 0
        for _ in range(most):
            places = self._eased(places)
            density, jacobian = self.energy(places)
            step = self._step(places, jacobian)
            before = float((weights * density).sum())
            after, energy, share = self._along(places, step, before, everywhere=True)
            if share < _SHORT_STEP:
                other, lower, _ = self._along(places, step, before, everywhere=False)
                after, energy = (other, lower) if lower < energy else (after, energy)
            places, idle = after, idle + 1 if energy > before * (1 - _GAIN) else 0
            if idle == _PATIENCE:
                break
        return places

    def _eased(self, places: Tensor) -> Tensor:
        """Move the verts of faces that are far worse than the rest towards their neighbours, where that mends them."""
        weights, connectivity = self._gradients[1], self.pattern.connectivity
        for _ in range(6):
            density = self.energy(places)[0]
            limit = 20 * (weights * density).sum().clamp_max(20)
            far = density > limit
            if not bool(far.any()):
                break
            middle = unit(connectivity.neighbour_mean(places))
            moved = torch.where(connectivity.verts_of(far)[:, None], unit(places + middle), places)
            for _ in range(8):
                worse = turned_over(moved, self.faces) | (self.energy(moved)[0] > density.clamp_min(20))
                if not bool(worse.any()):
                    break
                moved = torch.where(connectivity.verts_of(worse)[:, None], places, moved)
            else:
                return places
            places = moved
        return places

    def _step(self, places: Tensor, jacobian: Tensor) -> Tensor:
        """The step to the least of the reweighted quadratic energy, along the sphere."""
        corners, area = self._gradients
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
        pull = torch.einsum("fxy,fyc,fkc->fkx", metric, left @ right.transpose(1, 2) - jacobian, corners)
        return self._solved(places, blocks, pull * area[:, None, None])

    def _solved(self, places: Tensor, blocks: Tensor, pull: Tensor) -> Tensor:
        eye = torch.eye(3, dtype=places.dtype, device=places.device)
        outward = places[:, :, None] * places[:, None, :]
        along = eye - outward
        blocks = along[self.pattern.rows] @ blocks @ along[self.pattern.columns]
        size = blocks[self.pattern.diagonal].diagonal(dim1=1, dim2=2).sum(1) / 2
        blocks[self.pattern.diagonal] += size[:, None, None] * outward + 1e-9 * eye
        total = torch.zeros_like(places)
        for k in range(3):
            total.index_add_(0, self.faces[:, k], pull[:, k])
        inverse = torch.linalg.inv(blocks[self.pattern.diagonal])
        return conjugate_gradients(
            self.pattern.times(blocks),
            (along @ total[:, :, None])[:, :, 0],
            lambda r: (inverse @ r[:, :, None])[:, :, 0],
            _TOLERANCE,
            _MOST_ITERATIONS,
        )[0]

    def _along(self, places: Tensor, step: Tensor, before: float, *, everywhere: bool) -> tuple[Tensor, float, float]:
        """Where a step leads that is cut until no face turns over and the energy falls, that energy, and the cut."""
        connectivity, share = self.pattern.connectivity, torch.ones_like(places[:, :1])
        for attempt in range(_HALVINGS):
            moved = unit(places + share * step)
            over = turned_over(moved, self.faces)
            if bool(over.any()) and not everywhere:
                near = connectivity.verts_of(over)
                for _ in range(attempt // 4):
                    near = connectivity.grown(near)
                share = torch.where(near[:, None], share / 2, share)
                continue
            if not bool(over.any()):
                energy = float((self._gradients[1] * self.energy(moved)[0]).sum())
                if energy < before:
                    return moved, energy, float(share.mean())
            share = share / 2
        return places, before, 0.0

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
