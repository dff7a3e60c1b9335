"""Shapes that are made of bones with round flesh, and posed by turning the bones: a figure, a horse, a hand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyvista
from scipy.spatial.transform import Rotation

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.pieces import manifold_pieces

Map = Callable[[np.ndarray], np.ndarray]
Position = tuple[float, float, float]
Bone = tuple[str | None, Position, Position, float, float]
"""Parent, start, end, radii at both."""
_SIDES = {"left": 1.0, "right": -1.0}


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones with flesh about them; y is up, and the shape looks towards +z.

    Attributes:
        bones: by name, parents first.
        poses: turns about the axes at the start of bones, in degrees, by name of the pose.
        low: lower corner of a box around it.
        high: upper corner.
        edges: lengths of the edges of a template and of a target.
        blend: width of the transition from the flesh of one bone to the next.
        skin: width of the transition from the motion of one bone to the next.
    """

    bones: Mapping[str, Bone]
    poses: Mapping[str, Mapping[str, Position]]
    low: Position
    high: Position
    edges: tuple[float, float] = (0.019, 0.017)
    blend: float = 0.03
    skin: float = 0.035

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points from the surface of each bone."""
        columns = []
        for _, start, end, first, last in self.bones.values():
            a, side = np.array(start), np.array(end) - np.array(start)
            share = np.clip((points - a) @ side / (side @ side), 0, 1)
            columns.append(np.linalg.norm(points - a - share[:, None] * side, axis=1) - first - share * (last - first))
        return np.stack(columns, axis=1)

    @lru_cache(maxsize=4)  # noqa: B019  a few for the whole process
    def surface(self, edge: float) -> Mesh:
        """Return the shape at rest, with edges of about this length."""
        low, high = np.array(self.low), np.array(self.high)
        counts = np.ceil((high - low) / edge).astype(int) + 1
        grid = pyvista.ImageData(dimensions=counts, spacing=[edge] * 3, origin=low)
        distances = self.distances(np.asarray(grid.points, dtype=np.float64))
        values = -self.blend * np.log(np.exp(-distances / self.blend).sum(axis=1))
        made = grid.contour([0.0], scalars=values, method="flying_edges").clean()
        faces = np.asarray(made.faces).reshape(-1, 4)[:, :0:-1].astype(np.int64)
        return manifold_pieces(Mesh(np.asarray(made.points, dtype=np.float64), faces))

    def posed(self, name: str) -> Map:
        """Return the map of a pose: each point follows the bones near it (linear blend skinning)."""
        turns = self.poses[name]
        placed: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for bone, (parent, start, *_) in self.bones.items():
            above, shift = placed[parent] if parent else (np.eye(3), np.zeros(3))
            turn = Rotation.from_euler("xyz", turns.get(bone, (0, 0, 0)), degrees=True).as_matrix()
            rotation, pivot = above @ turn, np.array(start)
            placed[bone] = rotation, above @ pivot + shift - rotation @ pivot

        def moved(points: np.ndarray) -> np.ndarray:
            distances = self.distances(points)
            weights = np.exp(-(distances - distances.min(axis=1, keepdims=True)) / self.skin)
            weights /= weights.sum(axis=1, keepdims=True)
            total = np.zeros_like(points)
            for weight, (rotation, shift) in zip(weights.T, placed.values(), strict=True):
                total += weight[:, None] * (points @ rotation.T + shift)
            return total

        return moved


def _both_sides(bones: Mapping[str, Bone]) -> dict[str, Bone]:
    """Return bones with those whose names begin with "left" on both sides."""
    result: dict[str, Bone] = {}
    for side, sign in _SIDES.items():
        for name, (parent, start, end, *radii) in bones.items():
            other = parent.replace("left", side) if parent else None
            ends = ((sign * x, y, z) for x, y, z in (start, end))
            result[name.replace("left", side)] = (other, *ends, *radii)  # type: ignore[assignment]
    return result


FIGURE = Skeleton(
    bones={
        "hips": (None, (0.0, 0.92, 0.0), (0.0, 1.02, 0.0), 0.14, 0.13),
        "chest": ("hips", (0.0, 1.05, 0.0), (0.0, 1.38, 0.0), 0.13, 0.15),
        "head": ("chest", (0.0, 1.52, 0.0), (0.0, 1.72, 0.03), 0.06, 0.11),
        "upper arm left": ("chest", (0.20, 1.40, 0.0), (0.36, 1.14, 0.0), 0.055, 0.05),
        "lower arm left": ("upper arm left", (0.36, 1.14, 0.0), (0.48, 0.90, 0.03), 0.048, 0.04),
        "upper arm right": ("chest", (-0.20, 1.40, 0.0), (-0.36, 1.14, 0.0), 0.055, 0.05),
        "lower arm right": ("upper arm right", (-0.36, 1.14, 0.0), (-0.48, 0.90, 0.03), 0.048, 0.04),
        "thigh left": ("hips", (0.11, 0.90, 0.0), (0.14, 0.50, 0.0), 0.09, 0.065),
        "shin left": ("thigh left", (0.14, 0.50, 0.0), (0.15, 0.10, -0.02), 0.06, 0.045),
        "foot left": ("shin left", (0.15, 0.06, 0.0), (0.16, 0.05, 0.14), 0.05, 0.04),
        "thigh right": ("hips", (-0.11, 0.90, 0.0), (-0.14, 0.50, 0.0), 0.09, 0.065),
        "shin right": ("thigh right", (-0.14, 0.50, 0.0), (-0.15, 0.10, -0.02), 0.06, 0.045),
        "foot right": ("shin right", (-0.15, 0.06, 0.0), (-0.16, 0.05, 0.14), 0.05, 0.04),
    },
    poses={
        "walk": {
            "upper arm left": (35, 0, 0),
            "lower arm left": (-30, 0, 0),
            "upper arm right": (-35, 0, 0),
            "lower arm right": (-40, 0, 0),
            "thigh left": (-35, 0, 0),
            "shin left": (25, 0, 0),
            "thigh right": (25, 0, 0),
            "shin right": (30, 0, 0),
            "chest": (5, 8, 0),
        },
        "arms raised": {"upper arm left": (0, 0, 75), "upper arm right": (0, 0, -75)},
        "arms forward": {"upper arm left": (-80, 0, 0), "upper arm right": (-80, 0, 0)},
        "squat": {
            "upper arm left": (-80, 0, -20),
            "upper arm right": (-80, 0, 20),
            "thigh left": (-85, 0, 10),
            "thigh right": (-85, 0, -10),
            "shin left": (95, 0, 0),
            "shin right": (95, 0, 0),
            "hips": (15, 0, 0),
        },
        "kick": {
            "chest": (-10, 20, 0),
            "upper arm left": (30, 0, 30),
            "upper arm right": (-50, 0, -20),
            "lower arm right": (-40, 0, 0),
            "thigh left": (-75, 0, 0),
            "shin left": (20, 0, 0),
            "thigh right": (10, 0, -5),
        },
        "bow": {
            "chest": (60, 0, 0),
            "head": (15, 0, 0),
            "upper arm left": (-40, 0, 0),
            "upper arm right": (-40, 0, 0),
            "thigh left": (-10, 0, 0),
            "thigh right": (-10, 0, 0),
        },
    },
    low=(-0.75, -0.1, -0.4),
    high=(0.75, 2.0, 0.4),
)

HORSE = Skeleton(
    bones={
        "body": (None, (0.0, 1.1, -0.5), (0.0, 1.1, 0.4), 0.2, 0.19),
        "neck": ("body", (0.0, 1.22, 0.5), (0.0, 1.62, 0.78), 0.12, 0.08),
        "head": ("neck", (0.0, 1.66, 0.82), (0.0, 1.48, 1.12), 0.085, 0.05),
        "tail": ("body", (0.0, 1.15, -0.7), (0.0, 0.68, -0.88), 0.045, 0.035),
        **_both_sides(
            {
                "fore thigh left": ("body", (0.13, 0.95, 0.38), (0.13, 0.55, 0.38), 0.08, 0.055),
                "fore shin left": ("fore thigh left", (0.13, 0.55, 0.38), (0.13, 0.08, 0.38), 0.05, 0.045),
                "hind thigh left": ("body", (0.13, 0.95, -0.45), (0.13, 0.55, -0.52), 0.1, 0.06),
                "hind shin left": ("hind thigh left", (0.13, 0.55, -0.52), (0.13, 0.08, -0.45), 0.055, 0.045),
            }
        ),
    },
    poses={
        "gallop": {
            "neck": (20, 0, 0),
            "tail": (40, 0, 0),
            "fore thigh left": (-55, 0, 0),
            "fore shin left": (30, 0, 0),
            "fore thigh right": (-25, 0, 0),
            "fore shin right": (60, 0, 0),
            "hind thigh left": (45, 0, 0),
            "hind thigh right": (25, 0, 0),
            "hind shin right": (15, 0, 0),
        },
        "graze": {
            "neck": (80, 0, 0),
            "head": (-25, 0, 0),
            "tail": (0, 0, 15),
            "fore thigh left": (-20, 0, 0),
            "fore thigh right": (15, 0, 0),
            "hind thigh left": (10, 0, 0),
        },
    },
    low=(-0.4, -0.05, -1.05),
    high=(0.4, 1.85, 1.25),
)

_FINGERS = {"little": -0.45, "ring": -0.15, "middle": 0.15, "index": 0.45}
HAND = Skeleton(
    bones={
        "wrist": (None, (0.0, -0.45, 0.0), (0.0, -0.1, 0.0), 0.21, 0.21),
        **{f"palm {name}": ("wrist", (0.5 * x, 0.0, 0.0), (x, 0.9, 0.0), 0.16, 0.14) for name, x in _FINGERS.items()},
        **{
            f"{name} near": (f"palm {name}", (x, 0.98, 0.0), (1.15 * x, 1.35, 0.0), 0.11, 0.1)
            for name, x in _FINGERS.items()
        },
        **{
            f"{name} far": (f"{name} near", (1.15 * x, 1.38, 0.0), (1.3 * x, 1.75, 0.0), 0.1, 0.085)
            for name, x in _FINGERS.items()
        },
        "thumb near": ("palm index", (0.45, 0.3, 0.05), (0.8, 0.62, 0.1), 0.13, 0.11),
        "thumb far": ("thumb near", (0.83, 0.65, 0.1), (1.05, 0.95, 0.1), 0.1, 0.09),
    },
    poses={
        "grasp": {
            **{f"{name} near": (40.0, 0.0, 0.0) for name in _FINGERS},
            **{f"{name} far": (45.0, 0.0, 0.0) for name in _FINGERS},
            "thumb near": (0.0, -35.0, 0.0),
            "thumb far": (0.0, -20.0, 15.0),
        },
    },
    low=(-0.85, -0.8, -0.4),
    high=(1.35, 2.0, 0.4),
    edges=(0.031, 0.028),
    blend=0.025,
)
