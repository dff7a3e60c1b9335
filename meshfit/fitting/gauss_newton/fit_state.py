"""One surface on its way from a source to a target: its steps, and the changes of its connectivity between them."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Float64
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences, find_correspondences
from meshfit.fitting.gauss_newton.equations import Control, SparsityPattern, solve_step
from meshfit.fitting.gauss_newton.fairness import Fairness, membrane_tension
from meshfit.fitting.gauss_newton.sizing import lengths_for
from meshfit.fitting.gauss_newton.sphere_map import SphereMap
from meshfit.fitting.gauss_newton.step_limiting import limited_step, unsound_faces, untangled
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.loss.sparse import Sparse
from meshfit.mesh.topology import PolygonTopology
from meshfit.remeshing.remesh import remeshed
from meshfit.remeshing.state import RemeshState

_REMESH_ROUNDS = 3
# Lengths go down with curvature to this power where a connectivity is placed: the map gives way to part of it only.
_PLACED_POWER = 0.55
# What is asked of a remesh, of the most verts that it may have, until it has no more.
_SHARES = (0.96, 0.9, 0.82)
_MAP_STEPS, _LAST_MAP_STEPS = 4, 40
# Where a step was held back, the surface is made this much stiffer, which wears off.
_STIFFER, _STIFFEST, _WEARING = 4.0, 64.0, 0.8


@dataclass(frozen=True, eq=False)
class StepReport:
    """A step that was made.

    Attributes:
        surface: after it.
        pairs: before it.
        held: how many verts were held back.
    """

    surface: "FitState"
    pairs: Correspondences
    held: int


@dataclass(frozen=True, eq=False)
class ControlledSurface:
    """A surface that follows a control mesh.

    Attributes:
        pattern: of its connectivity.
        operator: takes the verts of the control mesh to its own.
        squares: the squared entries of that.
        polygons: whose fans its faces are, if they are any.
    """

    pattern: SparsityPattern
    operator: Sparse
    squares: Sparse
    polygons: PolygonTopology | None = None


@dataclass(frozen=True, eq=False)
class FitState:
    """A surface between two steps.

    Attributes:
        pattern: of its connectivity.
        verts: (V, 3) positions.
        stiffness: (V, 1) at least 1, factors of fairness.
        on_sphere: (V, 3) where its verts are on the sphere, if it has a map to it.
        controlled: if these are the verts of a control mesh, the surface that follows them.
        polygons: whose fans its faces are, if they are any.
    """

    pattern: SparsityPattern
    verts: Float[Tensor, "V 3"]
    stiffness: Float[Tensor, "V 1"]
    on_sphere: Float64[Tensor, "V 3"] | None = None
    controlled: ControlledSurface | None = None
    polygons: PolygonTopology | None = None

    @classmethod
    def of(
        cls,
        verts: Tensor,
        faces: Tensor,
        on_sphere: Tensor | None = None,
        polygons: PolygonTopology | None = None,
    ) -> "FitState":
        """A surface that nothing has held back."""
        pattern = SparsityPattern(Connectivity(faces, len(verts), verts.dtype))
        return cls(pattern, verts, torch.ones_like(verts[:, :1]), on_sphere, polygons=polygons)

    @classmethod
    def restored(cls, state: dict[str, Tensor | None], dtype: torch.dtype, device: torch.device) -> "FitState":
        """What `state` was taken of, without the controlled surface."""
        verts, faces, stiffness, on_sphere = (state[key] for key in ("verts", "faces", "stiffness", "on_sphere"))
        assert verts is not None and faces is not None and stiffness is not None  # noqa: S101, PT018  always there
        corners, sizes = state.get("corners"), state.get("sizes")
        polygons = None
        if corners is not None and sizes is not None:
            polygons = PolygonTopology(len(verts), corners.numpy(), sizes.numpy())
        places = None if on_sphere is None else on_sphere.to(device)
        surface = cls.of(verts.to(device, dtype), faces.to(device), places, polygons)
        return replace(surface, stiffness=stiffness.to(device, dtype))

    def state(self) -> dict[str, Tensor | None]:
        """What `restored` makes it from, on the CPU."""
        return {
            "verts": self.verts.cpu(),
            "faces": self.pattern.connectivity.faces.cpu(),
            "stiffness": self.stiffness.cpu(),
            "on_sphere": None if self.on_sphere is None else self.on_sphere.cpu(),
        } | self._state_of_polygons()

    def _state_of_polygons(self) -> dict[str, Tensor | None]:
        own = self.polygons
        followed = None if self.controlled is None else self.controlled.polygons
        return {
            "corners": None if own is None else torch.tensor(own.corners),
            "sizes": None if own is None else torch.tensor(own.sizes),
            "followed": None if followed is None else torch.tensor(followed.corners),
        }

    @property
    def shape(self) -> Shape:
        """Where its faces are, or those that follow them."""
        if self.controlled is not None:
            return Shape(self.controlled.pattern.connectivity, self.controlled.operator @ self.verts)
        return Shape(self.pattern.connectivity, self.verts)

    def step(self, target: TargetCloud, fairness: float, point_weight: float, generator: Generator) -> StepReport:
        """Take a Gauss–Newton step towards the target, as far as the surface stays sound."""
        shape, own, other = self.shape, self.pattern.connectivity, self.controlled
        pairs = find_correspondences(shape, target, generator)
        pull = membrane_tension(shape, pairs.membranes, fairness) if other is None else None
        smooth = Fairness(own, self.stiffness * (fairness / len(self.verts)), pull)
        pattern = self.pattern if other is None else other.pattern
        control = None if other is None else Control(self.verts, other.operator, other.squares)
        step, _ = solve_step(shape, pattern, pairs, smooth, point_weight, control)
        end = self.verts + step
        if not bool(end.isfinite().all()):
            return StepReport(replace(self, verts=end), pairs, 0)
        if other is None:
            verts, held = limited_step(own, self.verts, end)
        else:
            verts, held = limited_step(other.pattern.connectivity, self.verts, end, (own, other.operator))
        relaxed = (self.stiffness * _WEARING).clamp_min(1)
        stiffness = torch.where(held[:, None], (relaxed * _STIFFER).clamp_max(_STIFFEST), relaxed)
        return StepReport(replace(self, verts=verts, stiffness=stiffness), pairs, int(held.sum()))

    def untangled(self) -> "FitState":
        """The surface with unsound faces smoothed away, as far as that goes; as it is if it follows a control mesh."""
        if self.controlled is not None:
            return self
        return replace(self, verts=untangled(self.pattern.connectivity, self.verts)[0])

    def remeshed(self, num_verts: float, target: TargetCloud | None) -> "FitState":
        """The surface with at most so many verts, if not many fewer; as it is where that cannot be had soundly.

        Args:
            num_verts: the most.
            target: where curvature is to be taken from; None for edges of one length.
        """
        for share in _SHARES:
            other = self._remeshed_once(share * num_verts, target)
            if len(other.verts) <= num_verts:
                break
        unsound = int(unsound_faces(other.shape).sum())
        if len(other.verts) > num_verts or unsound > int(unsound_faces(self.shape).sum()):
            return self
        return other.with_better_map(_MAP_STEPS)

    def _remeshed_once(self, num_verts: float, target: TargetCloud | None) -> "FitState":
        connectivity = self.pattern.connectivity
        lengths = lengths_for(self.shape, num_verts, target)
        moving = remeshed(
            RemeshState(self.verts, connectivity.faces, lengths, on_sphere=self.on_sphere), _REMESH_ROUNDS
        )
        other = FitState.of(moving.verts, moving.faces, moving.on_sphere)
        return other.untangled()

    def with_better_map(self, steps: int, target: TargetCloud | None = None) -> "FitState":
        """The surface with less distortion in its map to the sphere, if it has one.

        Args:
            steps: how many to take at most.
            target: if given, more of the sphere goes to where this is curved.
        """
        if self.on_sphere is None:
            return self
        return replace(self, on_sphere=self._sphere(target).improved(self.on_sphere, steps))

    def carrying(
        self,
        faces: Tensor,
        on_sphere: Float64[Tensor, "N 3"],
        target: TargetCloud,
        polygons: PolygonTopology | None = None,
    ) -> "FitState":
        """Another connectivity put on the surface, by where its verts are on the sphere, densely where it is curved.

        Args:
            faces: (G, 3) of that connectivity.
            on_sphere: (N, 3) where its verts are.
            target: where curvature is taken from.
            polygons: whose fans the faces are, if they are any.
        """
        surface = self.with_better_map(_LAST_MAP_STEPS, target)
        assert surface.on_sphere is not None  # noqa: S101  only surfaces that have a map are asked
        here, weights = self._sphere(None).located(surface.on_sphere, on_sphere)
        corners = self.verts[self.pattern.connectivity.faces[here]]
        verts = (weights.to(corners)[:, :, None] * corners).sum(1)
        return FitState.of(verts, faces, polygons=polygons).untangled()

    def _sphere(self, target: TargetCloud | None) -> SphereMap:
        if target is None:
            return SphereMap(self.pattern, self.verts.double())
        lengths = lengths_for(self.shape, float(len(self.verts)), target, _PLACED_POWER)
        return SphereMap(self.pattern, self.verts.double(), lengths.double())
