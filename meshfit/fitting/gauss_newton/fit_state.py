"""The state of one fit: a surface, its Gauss–Newton steps, and the changes of its connectivity between them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Float64
from torch import Generator, Tensor

from meshfit.fitting.gauss_newton.correspondences import Correspondences, find_correspondences
from meshfit.fitting.gauss_newton.equations import ControlledSurface, SparsityPattern, solve_step
from meshfit.fitting.gauss_newton.fairness import Fairness, membrane_tension
from meshfit.fitting.gauss_newton.sizing import lengths_for
from meshfit.fitting.gauss_newton.sphere_map import SphereMap
from meshfit.fitting.gauss_newton.step_limiting import limit_step, unsound_faces, untangle
from meshfit.fitting.gauss_newton.surface import Connectivity, Shape
from meshfit.fitting.gauss_newton.target import TargetCloud
from meshfit.fitting.settings import Direction
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.topology import PolygonTopology
from meshfit.remeshing.decimate import decimate
from meshfit.remeshing.remesh import remesh_state
from meshfit.remeshing.state import RemeshState
from meshfit.remeshing.thin_faces import without_thin_faces

_REMESH_ROUNDS = 3
# Lengths fall with curvature to this power where a connectivity is placed; the sphere map follows in part only.
_PLACED_POWER = 0.55
# Shares of the largest number of vertices to aim for, in turn, until a remesh stays below it; with more than the second
# number times as many, no share will do.
_SHARES, _FAR_ABOVE = (0.96, 0.9, 0.82), 1.2
# Least number of vertices of a piece without boundary, and of one with a boundary; and of a closed surface, per unit of
# its Euler number below 0, as no vertex gets more than 9 edges.
_LEAST_CLOSED, _LEAST_OPEN, _PER_EULER = 4, 3, 2
_MAP_STEPS, _LAST_MAP_STEPS = 4, 40
# Where a step was held back, fairness is multiplied by this, up to the second number; the factor then decays.
_STIFFER, _STIFFEST, _DECAY = 4.0, 64.0, 0.8


@dataclass(frozen=True, eq=False)
class StepReport:
    """The outcome of a step.

    Attributes:
        state: state after the step.
        pairs: correspondences before the step.
        held: number of vertices that were held back.
    """

    state: "FitState"
    pairs: Correspondences
    held: int


@dataclass(frozen=True, eq=False)
class FitState:
    """A surface between two steps.

    Attributes:
        pattern: sparsity pattern of the mesh that is solved for.
        verts: (V, 3) its positions.
        stiffness: (V, 1) factors of fairness, at least 1.
        on_sphere: (V, 3) its positions on the sphere, if it has a sphere map.
        controlled: the surface, if the mesh that is solved for is its control mesh.
        polygons: the polygons that the mesh was triangulated from, if any.
        rest: (V, 3) its places on the source, if the source has attributes that have to be projected in the end.
        reference: (V, 3) positions from which displacements are kept smooth; None to keep the surface smooth.
    """

    pattern: SparsityPattern
    verts: Float[Tensor, "V 3"]
    stiffness: Float[Tensor, "V 1"]
    on_sphere: Float64[Tensor, "V 3"] | None = None
    controlled: ControlledSurface | None = None
    polygons: PolygonTopology | None = None
    rest: Float64[Tensor, "V 3"] | None = None
    reference: Float[Tensor, "V 3"] | None = None

    @classmethod
    def of(
        cls,
        verts: Tensor,
        faces: Tensor,
        on_sphere: Tensor | None = None,
        polygons: PolygonTopology | None = None,
        *,
        crossing: bool = False,
    ) -> "FitState":
        """Return a state of stiffness 1."""
        pattern = SparsityPattern(Connectivity(faces, len(verts), verts.dtype, crossing))
        return cls(pattern, verts, torch.ones_like(verts[:, :1]), on_sphere, polygons=polygons)

    @classmethod
    def restored(cls, saved: dict[str, Tensor | None], dtype: torch.dtype, device: torch.device) -> "FitState":
        """Return the state that `saved` returned, without its controlled surface."""
        verts, faces, stiffness, on_sphere = (saved[key] for key in ("verts", "faces", "stiffness", "on_sphere"))
        assert verts is not None and faces is not None and stiffness is not None  # noqa: S101, PT018  never None
        corners, sizes = saved.get("corners"), saved.get("sizes")
        polygons = None
        if corners is not None and sizes is not None:
            polygons = PolygonTopology(len(verts), corners.numpy(), sizes.numpy())
        on_sphere = None if on_sphere is None else on_sphere.to(device)
        crossing = saved.get("crossing") is not None
        state = cls.of(verts.to(device, dtype), faces.to(device), on_sphere, polygons, crossing=crossing)
        reference = saved.get("reference")
        reference = None if reference is None else reference.to(device, dtype)
        return replace(state, stiffness=stiffness.to(device, dtype), rest=saved.get("rest"), reference=reference)

    @property
    def crossing(self) -> bool:
        """Whether pieces may cross each other."""
        return self.pattern.connectivity.crossing

    def saved(self) -> dict[str, Tensor | None]:
        """Return the state as tensors on the CPU, for `restored`."""
        polygons, surface = self.polygons, self.controlled
        triangles = None if surface is None or surface.polygons is None else surface.pattern.connectivity.faces.cpu()
        return {
            "verts": self.verts.cpu(),
            "crossing": torch.ones(1) if self.crossing else None,
            "faces": self.pattern.connectivity.faces.cpu(),
            "stiffness": self.stiffness.cpu(),
            "on_sphere": None if self.on_sphere is None else self.on_sphere.cpu(),
            "corners": None if polygons is None else torch.tensor(polygons.corners),
            "sizes": None if polygons is None else torch.tensor(polygons.sizes),
            "triangles": triangles,
            "rest": self.rest,
            "reference": None if self.reference is None else self.reference.cpu(),
        }

    @property
    def least_verts(self) -> int:
        """Number of vertices below which no surface has these pieces, or these handles."""
        connectivity = self.pattern.connectivity
        if len(connectivity.edges.outer):
            return _LEAST_OPEN * connectivity.pieces[0]
        # Of a closed surface, 3 F = 2 E; with at most 9 edges at a vertex, V is at least twice E - F - V.
        euler = len(self.verts) - len(connectivity.faces) // 2
        return max(_LEAST_CLOSED * connectivity.pieces[0], -_PER_EULER * euler)

    @property
    def shape(self) -> Shape:
        """The current surface."""
        if self.controlled is not None:
            return self.controlled.shape(self.verts)
        return Shape(self.pattern.connectivity, self.verts)

    def step(
        self,
        target: TargetCloud,
        fairness: float,
        point_weight: float,
        generator: Generator,
        direction: Direction = "both",
        robust: float | None = None,
        adapted: Callable[[Correspondences, Shape], Correspondences] | None = None,
    ) -> StepReport:
        """Make a Gauss–Newton step towards the target, as far as the surface stays sound."""
        shape, connectivity, controlled = self.shape, self.pattern.connectivity, self.controlled
        pairs = find_correspondences(shape, target, generator, direction, robust)
        pairs = pairs if adapted is None else adapted(pairs, shape)
        tension = membrane_tension(shape, pairs.membranes, fairness) if controlled is None else None
        weights = self.stiffness * (fairness / len(self.verts))
        smoothness = Fairness(connectivity, weights, tension, self.reference)
        step, _ = solve_step(self.pattern, self.verts, pairs, smoothness, point_weight, controlled)
        end = self.verts + step
        if not bool(end.isfinite().all()):
            return StepReport(replace(self, verts=end), pairs, 0)
        verts, held = limit_step(connectivity, self.verts, end, controlled)
        decayed = (self.stiffness * _DECAY).clamp_min(1)
        stiffness = torch.where(held[:, None], (decayed * _STIFFER).clamp_max(_STIFFEST), decayed)
        return StepReport(replace(self, verts=verts, stiffness=stiffness), pairs, int(held.sum()))

    def untangled(self) -> "FitState":
        """Return the state with unsound faces smoothed away as far as possible; unchanged with a control mesh."""
        if self.controlled is not None:
            return self
        return replace(self, verts=untangle(self.pattern.connectivity, self.verts)[0])

    def without_thin_faces(self) -> "FitState":
        """Return the state without the angles below 1 degree that can be removed; only where faces may change."""
        connectivity = self.pattern.connectivity
        piece = connectivity.pieces[1] if self.crossing else None
        verts, faces = without_thin_faces(self.verts, connectivity.faces, piece)
        if faces is connectivity.faces:
            return self
        state = FitState.of(verts, faces, crossing=self.crossing)
        return state if self.rest is None else replace(state, rest=self._rest_at(verts))

    def is_as_sound_as(self, other: "FitState") -> bool:
        """Return whether the surface has no more unsound faces than another, which counts only if it has any."""
        count = int(unsound_faces(self.shape).sum())
        return not count or count <= int(unsound_faces(other.shape).sum())

    def remeshed(self, num_verts: float, target: TargetCloud | None) -> "FitState":
        """Return the surface with new connectivity; unchanged if it would have too many vertices or become unsound.

        Args:
            num_verts: largest number of vertices, which is nearly reached.
            target: shortens edges where it is curved; None for edges of one length.
        """
        if self.least_verts > num_verts:
            return self
        for share in _SHARES:
            state = self._remeshed_once(share * num_verts, target)
            if len(state.verts) <= num_verts or len(state.verts) > _FAR_ABOVE * num_verts:
                break
        if len(state.verts) > num_verts or not state.is_as_sound_as(self):
            return self
        return state.with_better_map(_MAP_STEPS)

    def decimated(self, num_verts: int) -> "FitState":
        """Return the surface reduced to a number of vertices by quadrics, with no more unsound faces than before."""
        if self.least_verts > num_verts:
            return self.untangled()
        faces, state = self.pattern.connectivity.faces, self
        for careful in (False, True):
            reduced = decimate(self.verts, faces, num_verts, without_crossings=careful)
            state = FitState.of(*reduced, crossing=self.crossing)
            if len(state.verts) <= num_verts and state.is_as_sound_as(self):
                return state
        # So tight a surface that not enough edges may collapse.
        if len(state.verts) > num_verts:
            state = FitState.of(*decimate(self.verts, faces, num_verts), crossing=self.crossing)
        return state.untangled()

    def _remeshed_once(self, num_verts: float, target: TargetCloud | None) -> "FitState":
        lengths, faces = lengths_for(self.shape, num_verts, target), self.pattern.connectivity.faces
        mesh = remesh_state(RemeshState(self.verts, faces, lengths, on_sphere=self.on_sphere), _REMESH_ROUNDS)
        state = FitState.of(mesh.verts, mesh.faces, mesh.on_sphere, crossing=self.crossing).untangled()
        return state if self.rest is None else replace(state, rest=self._rest_at(mesh.verts))

    def _rest_at(self, verts: Tensor) -> Tensor:
        """Return the places on the source of vertices on this surface."""
        from meshfit.mesh.projection import carried_places  # brings libigl

        assert self.rest is not None  # noqa: S101  the caller has checked it
        before = Mesh(self.verts.cpu().double().numpy(), self.pattern.connectivity.faces.cpu().numpy())
        return torch.tensor(carried_places(before, self.rest.numpy(), verts.cpu().double().numpy()))

    def with_better_map(self, steps: int, target: TargetCloud | None = None) -> "FitState":
        """Return the state with less distortion of its sphere map, if it has one.

        Args:
            steps: largest number of steps of the improvement.
            target: gets more of the sphere where it is curved, if given.
        """
        if self.on_sphere is None:
            return self
        return replace(self, on_sphere=self._sphere_map(target).improved(self.on_sphere, steps))

    def with_connectivity(
        self,
        faces: Tensor,
        on_sphere: Float64[Tensor, "N 3"],
        target: TargetCloud,
        polygons: PolygonTopology | None = None,
    ) -> "FitState":
        """Return the surface with other faces, transferred by the sphere map, densely where it is curved.

        Args:
            faces: (G, 3) the other faces.
            on_sphere: (N, 3) positions of their vertices on the sphere.
            target: the source of curvature.
            polygons: the polygons that the faces were triangulated from, if any.
        """
        state = self.with_better_map(_LAST_MAP_STEPS, target)
        assert state.on_sphere is not None  # noqa: S101  only called with a map
        face, weights = self._sphere_map(None).located(state.on_sphere, on_sphere)
        corners = self.verts[self.pattern.connectivity.faces[face]]
        verts = (weights.to(corners)[:, :, None] * corners).sum(1)
        return FitState.of(verts, faces, polygons=polygons, crossing=self.crossing).untangled()

    def _sphere_map(self, target: TargetCloud | None) -> SphereMap:
        if target is None:
            return SphereMap(self.pattern, self.verts.double())
        lengths = lengths_for(self.shape, float(len(self.verts)), target, _PLACED_POWER)
        return SphereMap(self.pattern, self.verts.double(), lengths.double())
