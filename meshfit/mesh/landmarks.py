"""Landmarks: named places on a source, and where they belong on a target."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from meshfit.doors import no_type_check
from meshfit.errors import ConfigError, MeshError, MeshfitWarning
from meshfit.mesh.geometry import bounding_box_diagonal
from meshfit.mesh.mesh import Mesh, Verts
from meshfit.mesh.places import Numbering, Place
from meshfit.mesh.point_cloud import PointCloud
from meshfit.printable import described
from meshfit.specs import suggest
from meshfit.units import count_text

_LEAST = 3
# Distance from the surface beyond which a position is reported, relative to the diagonal of the mesh's box.
_FAR = 0.05
# The other reading of an anatomical file is taken if its median distance is at most this share of that of the first.
_MUCH_NEARER = 0.2
_NAMES_SHOWN = 4


@dataclass(frozen=True)
class Landmark:
    """A named place, and where it belongs.

    Attributes:
        name: by which places on several meshes are matched.
        place: on the source; or on the mesh that a file of one side is about.
        goal: on the target; None in a file of one side.
        used: whether a fit may use it; one that is held out is only measured.
    """

    name: str
    place: Place
    goal: Place | None = None
    used: bool = True


@dataclass(frozen=True)
class Landmarks:
    """Landmarks of a source, with or without their places on a target.

    Attributes:
        rows: the landmarks, in the order of their file.
        origin: name of their file in messages.

    Example:
        >>> import meshfit
        >>> corners = meshfit.Landmarks.of([0, 1, 2, 3], [[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]])
        >>> corners
        Landmarks(4 pairs: 1, 2, 3, 4)
        >>> corners.held_out(["4"]).used
        (True, True, True, False)
    """

    rows: tuple[Landmark, ...]
    origin: str = "landmarks"

    @classmethod
    @no_type_check
    def of(cls, places: ArrayLike, goals: ArrayLike, names: Sequence[str] | None = None) -> "Landmarks":
        """Return landmarks of arrays.

        Args:
            places: (L,) vertices of the source, or (L, 3) positions near its surface, in its coordinates.
            goals: (L,) vertices of the target, or (L, 3) positions, in its coordinates.
            names: of the landmarks; numbers from 1 on without them.

        Raises:
            MeshError: arrays of other shapes, or values that are not finite.
        """
        own, other = (_places_of(side, name) for side, name in ((places, "places"), (goals, "goals")))
        if len(own) != len(other):
            raise MeshError(f"landmarks: expected as many places as goals, got {len(own)} and {len(other)}")
        called = [str(number) for number in range(1, len(own) + 1)] if names is None else [str(name) for name in names]
        if len(called) != len(own) or len(set(called)) != len(called):
            raise MeshError(f"landmarks: expected {count_text(len(own), 'different name')}, got {called!r:.80}")
        return cls(tuple(Landmark(*row) for row in zip(called, own, other, strict=True)))

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.rows)

    def __iter__(self) -> Iterator[Landmark]:
        """Iterate over the landmarks."""
        return iter(self.rows)

    def __repr__(self) -> str:
        """Return their number and their first names."""
        noun = "pair" if self.has_goals else "place"
        return f"Landmarks({count_text(len(self), noun)}: {_listed(self.names)})"

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each landmark."""
        return tuple(row.name for row in self.rows)

    @property
    def used(self) -> tuple[bool, ...]:
        """Whether a fit may use each landmark."""
        return tuple(row.used for row in self.rows)

    @property
    def has_goals(self) -> bool:
        """Whether they are pairs."""
        return bool(self.rows) and all(row.goal is not None for row in self.rows)

    def with_goals(self, target: "Landmarks") -> "Landmarks":
        """Return the landmarks that a target has too, by name, with their places on it.

        One that either side holds out is held out.

        Args:
            target: places on the target.

        Raises:
            MeshError: one of the sides has pairs already, or too few names occur on both.

        Warns:
            MeshfitWarning: of names that only one side has.
        """
        for side in (self, target):
            if any(row.goal is not None for row in side.rows):
                raise MeshError(f"{side.origin}: has pairs already; give it alone, or a file of one side")
        goals = {row.name: row for row in target.rows}
        own, other = set(self.names), set(target.names)
        lacking = [
            f"{_listed([name for name in side.names if name not in names])} not in {elsewhere.origin}"
            for side, elsewhere, names in ((self, target, other), (target, self, own))
            if set(side.names) - names
        ]
        rows = tuple(
            replace(row, goal=goals[row.name].place, used=row.used and goals[row.name].used)
            for row in self.rows
            if row.name in goals
        )
        if len(rows) < _LEAST:
            count = "no name occurs" if not rows else f"only {count_text(len(rows), 'name')} occur"
            count = count.replace("name occur", "name occurs") if len(rows) == 1 else count
            raise MeshError(f"landmarks: {count} on both sides, of {_LEAST} or more: {'; '.join(lacking)}")
        if lacking:
            _warn(f"landmarks without a partner are left out: {'; '.join(lacking)}")
        return Landmarks(rows, self.origin)

    @no_type_check
    def held_out(self, chosen: float | Sequence[str]) -> "Landmarks":
        """Return the landmarks with some held out, which a fit does not use: their errors show what it has learnt.

        Args:
            chosen: names; or the share of all, from 0 to 1, that is drawn, always the same of the same names.

        Raises:
            ConfigError: a name that no landmark has.
        """
        if isinstance(chosen, int | float):
            order = np.random.default_rng(0).permutation(len(self))
            names = {self.names[index] for index in order[: round(float(chosen) * len(self))]}
        else:
            names = set(map(str, chosen))
        for name in sorted(names - set(self.names)):
            raise ConfigError(f"'{name}' is no landmark of {self.origin}: {suggest(name, self.names)}")
        rows = (replace(row, used=row.used and row.name not in names) for row in self.rows)
        return replace(self, rows=tuple(rows))

    def placed(self, mesh: Mesh, numbering: Numbering, goals: Verts) -> "PlacedLandmarks":
        """Return the landmarks on a source mesh.

        Args:
            mesh: the source, in the coordinates of its file.
            numbering: what numbers of vertices and faces refer to.
            goals: (L, 3) positions on the target, as `goal_positions` returns them.

        Raises:
            MeshError: a vertex or a face that the source does not have.

        Warns:
            MeshfitWarning: of positions far from the surface.
        """
        corners, shares = np.zeros((len(self), 3), dtype=np.int64), np.zeros((len(self), 3))
        free = [index for index, row in enumerate(self.rows) if row.place.kind == "position"]
        for index, row in enumerate(self.rows):
            if row.place.kind != "position":
                verts, weights = numbering.corners_and_weights(
                    row.place, f"{self.origin}: landmark '{row.name}'", "source"
                )
                kept = numbering.mesh_verts(verts)
                if kept is None:  # the mesh has other vertices than its file
                    free.append(index)
                else:
                    corners[index], shares[index] = kept, weights
        if free:
            from meshfit.mesh.projection import Places  # brings libigl

            points = self._positions([self.rows[index].place for index in free], numbering, mesh, free, "source")
            nearest = Places.nearest(mesh, points)
            corners[free], shares[free] = mesh.faces[nearest.face], nearest.weights
        return PlacedLandmarks(self.names, corners, shares, goals, np.array(self.used, dtype=bool))

    @property
    def goals_are_numbered(self) -> bool:
        """Whether some places on the target are vertices or faces, which the target has to have."""
        return any(row.goal is not None and row.goal.kind != "position" for row in self.rows)

    def goal_positions(self, target: Mesh | PointCloud, numbering: Numbering) -> Verts:
        """Return (L, 3) the positions on a target, in the coordinates of its file.

        Args:
            target: the target, in the coordinates of its file.
            numbering: what numbers of vertices and faces refer to.

        Raises:
            MeshError: there are no places on the target, or a vertex or a face that it does not have.

        Warns:
            MeshfitWarning: of positions far from the surface.
        """
        goals = [row.goal for row in self.rows if row.goal is not None]
        if len(goals) < len(self):
            raise MeshError(
                f"{self.origin}: has places on one side alone; give the target a file of its own with the same names"
            )
        return self._positions(goals, numbering, target, range(len(self)), "target")

    def _positions(
        self,
        places: Sequence[Place],
        numbering: Numbering,
        mesh: Mesh | PointCloud,
        rows: Sequence[int],
        role: str,
    ) -> Verts:
        """Return the positions of places; warn of those that are far from the surface."""
        names = [self.rows[index].name for index in rows]
        points = np.array(
            [
                numbering.position(place, f"{self.origin}: landmark '{name}'", role)
                for place, name in zip(places, names, strict=True)
            ]
        ).reshape(-1, 3)
        free = np.array([place.kind == "position" for place in places], dtype=bool)
        if not free.any():
            return points
        diagonal = bounding_box_diagonal(mesh.verts)
        distances = _distances(mesh, points[free])
        if all(place.anatomical for place in places if place.kind == "position"):
            turned = points[free] * [-1.0, -1.0, 1.0]
            others = _distances(mesh, turned)
            median, other = float(np.median(distances)), float(np.median(others))
            if median > _FAR * diagonal and other < _MUCH_NEARER * median and other < _FAR * diagonal:
                _warn(
                    f"{self.origin}: x and y were negated (LPS, RAS), as the landmarks are then on the {role} "
                    f"(median distance {other:.3g}, else {median:.3g})"
                )
                points[free], distances = turned, others
        far = np.flatnonzero(distances > _FAR * diagonal)
        if len(far):
            worst = far[distances[far].argmax()]
            name, rest = np.array(names)[free][worst], len(far) - 1
            more = f", and {rest} more" if rest else ""
            share = f"{100 * distances[worst] / diagonal:.2g} % of its diagonal"
            _warn(
                f"{self.origin}: landmark '{name}' is {distances[worst]:.3g} away from the {role} ({share}){more}; "
                "check its unit and its axes"
            )
        return points


@dataclass(frozen=True, eq=False)
class PlacedLandmarks:
    """Landmarks on a mesh, and positions where they belong, in one frame.

    Attributes:
        names: L names.
        corners: (L, 3) vertices of the mesh.
        shares: (L, 3) weights of these, with a sum of 1.
        goals: (L, 3) positions on the target.
        used: (L,) which of them a fit uses; the others are held out.
    """

    names: tuple[str, ...]
    corners: Int64[np.ndarray, "L 3"]
    shares: Float64[np.ndarray, "L 3"]
    goals: Float64[np.ndarray, "L 3"]
    used: Bool[np.ndarray, " L"]

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.goals)

    def points(self, verts: Verts) -> Float64[np.ndarray, "L 3"]:
        """Return where the landmarks are, for some positions of the vertices."""
        return self.points_between(verts[self.corners])

    def points_between(self, corners: Float64[np.ndarray, "L 3 3"]) -> Float64[np.ndarray, "L 3"]:
        """Return where the landmarks are, given the positions of their corners."""
        return np.asarray((corners * self.shares[:, :, None]).sum(axis=1))

    def errors(self, verts: Verts) -> Float64[np.ndarray, " L"]:
        """Return the distance of each landmark from where it belongs, for some positions of the vertices."""
        return np.asarray(np.linalg.norm(self.points(verts) - self.goals, axis=1))

    def subset(self, rows: Bool[np.ndarray, " L"]) -> "PlacedLandmarks":
        """Return some of the landmarks."""
        names = tuple(name for name, chosen in zip(self.names, rows, strict=True) if chosen)
        return PlacedLandmarks(names, self.corners[rows], self.shares[rows], self.goals[rows], self.used[rows])

    def moved_to(self, surface: Mesh, points: Verts) -> "PlacedLandmarks":
        """Return the landmarks at the points of another surface that are nearest to these (L, 3) points."""
        from meshfit.mesh.projection import Places  # brings libigl

        nearest = Places.nearest(surface, points)
        return replace(self, corners=surface.faces[nearest.face], shares=nearest.weights)

    def in_frame(self, centre: Sequence[float], scale: float) -> "PlacedLandmarks":
        """Return the landmarks with their goals in a frame, x ↦ (x - centre) / scale."""
        return replace(self, goals=(self.goals - np.asarray(centre)) / scale)

    def require_enough(self) -> None:
        """Refuse fewer landmarks than a pose needs.

        Raises:
            MeshError: fewer than three are used.
        """
        used = int(self.used.sum())
        if used < _LEAST:
            held = f" ({len(self) - used} held out)" if used < len(self) else ""
            raise MeshError(f"landmarks: expected {_LEAST} or more, got {used}{held}")


def _places_of(side: Any, name: str) -> list[Place]:  # noqa: ANN401  anything that callers may give
    try:
        values = np.asarray(side, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeshError(f"landmarks: {name}: expected vertices or rows of three, got {described(side)}") from None
    if values.ndim not in (1, 2) or (values.ndim == 2 and values.shape[1] != 3):
        raise MeshError(f"landmarks: {name}: expected vertices or rows of three, got shape {values.shape}")
    if not np.isfinite(values).all():
        raise MeshError(f"landmarks: {name}: expected finite numbers")
    if values.ndim == 2:
        return [Place(position=(x, y, z)) for x, y, z in values.tolist()]
    whole = values == np.floor(values)
    if not whole.all():
        raise MeshError(f"landmarks: {name}: expected numbers of vertices, got {values[~whole][0]:g}")
    return [Place(vertex=int(value)) for value in values]


def _distances(mesh: Mesh | PointCloud, points: Verts) -> Float64[np.ndarray, " N"]:
    if isinstance(mesh, PointCloud):
        return np.asarray(cKDTree(mesh.verts).query(points)[0])
    from meshfit.mesh.proximity import nearest_on_surface  # brings libigl

    return nearest_on_surface(mesh, points).distances


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_NAMES_SHOWN])
    return shown if len(names) <= _NAMES_SHOWN else f"{shown} and {len(names) - _NAMES_SHOWN} more"


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=3)
