"""Pairs of a template and a target with known correspondence: bent, twisted and posed, noisy, cut, clouds.

python -m tests.benchmarks.registration_pairs FOLDER    # writes one pair as template.ply and scan.ply
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyvista
from scipy.spatial.transform import Rotation

from meshfit.mesh.geometry import bounding_box_diagonal, unit_vectors, vert_area_vectors
from meshfit.mesh.io.files import save_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.pieces import manifold_pieces
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide

Map = Callable[[np.ndarray], np.ndarray]

# Bones of the figure: parent, start, end, radii at both. y is up, the figure looks towards +z.
_BONES: dict[str, tuple[str | None, tuple[float, float, float], tuple[float, float, float], float, float]] = {
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
}
_BLEND, _SKIN = 0.03, 0.035
# Turns about the axes at the start of bones, in degrees.
POSES: dict[str, dict[str, tuple[float, float, float]]] = {
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
}


@dataclass(frozen=True, eq=False)
class Pair:
    """A template, a target, and where the vertices of the template belong.

    Attributes:
        name: in tables.
        source: the template.
        target: to register it to.
        truth: (V, 3) where its vertices belong.
    """

    name: str
    source: Mesh
    target: Mesh | PointCloud
    truth: np.ndarray

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of the truth."""
        return bounding_box_diagonal(self.truth)

    def error(self, verts: np.ndarray) -> float:
        """Return the root mean square distance of vertices from where they belong, as a share of the diagonal."""
        return float(np.sqrt(((verts - self.truth) ** 2).sum(axis=1).mean())) / self.diagonal


def bend(degrees: float, axis: int = 2, towards: int = 1) -> Callable[[np.ndarray], Map]:
    """Return a bend along an axis, for a shape: its length stays on the middle plane."""

    def of(shape: np.ndarray) -> Map:
        low, high = shape.min(axis=0), shape.max(axis=0)
        middle, length = (low + high) / 2, float(high[axis] - low[axis])
        angle = np.radians(degrees)
        radius = length / angle

        def bent(points: np.ndarray) -> np.ndarray:
            along, up = points[:, axis] - middle[axis], points[:, towards] - middle[towards]
            turn = along / radius
            result = points.copy()
            result[:, axis] = middle[axis] + (radius - up) * np.sin(turn)
            result[:, towards] = middle[towards] + radius - (radius - up) * np.cos(turn)
            return result

        return bent

    return of


def twist(degrees: float, axis: int = 1) -> Callable[[np.ndarray], Map]:
    """Return a twist about an axis, for a shape."""

    def of(shape: np.ndarray) -> Map:
        low, high = shape.min(axis=0), shape.max(axis=0)
        middle = (low + high) / 2

        def twisted(points: np.ndarray) -> np.ndarray:
            share = (points[:, axis] - middle[axis]) / (high[axis] - low[axis])
            vectors = np.zeros_like(points)
            vectors[:, axis] = np.radians(degrees) * share
            pivot = np.where(np.arange(3) == axis, points, middle)
            return Rotation.from_rotvec(vectors).apply(np.array(points - pivot)) + pivot

        return twisted

    return of


def _bone_distances(points: np.ndarray) -> np.ndarray:
    """Return the distances of points from the surface of each bone."""
    columns = []
    for _, start, end, first, last in _BONES.values():
        a, side = np.array(start), np.array(end) - np.array(start)
        share = np.clip((points - a) @ side / (side @ side), 0, 1)
        columns.append(np.linalg.norm(points - a - share[:, None] * side, axis=1) - (first + share * (last - first)))
    return np.stack(columns, axis=1)


@lru_cache(maxsize=4)
def figure(edge: float) -> Mesh:
    """Return the figure at rest, with edges of about this length."""

    low, high = np.array([-0.75, -0.1, -0.4]), np.array([0.75, 2.0, 0.4])
    counts = np.ceil((high - low) / edge).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=[edge] * 3, origin=low)
    distances = _bone_distances(np.asarray(grid.points, dtype=np.float64))
    values = -_BLEND * np.log(np.exp(-distances / _BLEND).sum(axis=1))
    made = grid.contour([0.0], scalars=values, method="flying_edges").clean()
    faces = np.asarray(made.faces).reshape(-1, 4)[:, :0:-1].astype(np.int64)
    return manifold_pieces(Mesh(np.asarray(made.points, dtype=np.float64), faces))


def posed(name: str) -> Map:
    """Return the map of a pose: each point follows the bones near it (linear blend skinning)."""
    turns = POSES[name]
    placed: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for bone, (parent, start, *_) in _BONES.items():
        above, shift = placed[parent] if parent else (np.eye(3), np.zeros(3))
        turn = Rotation.from_euler("xyz", turns.get(bone, (0, 0, 0)), degrees=True).as_matrix()
        rotation, pivot = above @ turn, np.array(start)
        placed[bone] = rotation, above @ pivot + shift - rotation @ pivot

    def moved(points: np.ndarray) -> np.ndarray:
        distances = _bone_distances(points)
        weights = np.exp(-(distances - distances.min(axis=1, keepdims=True)) / _SKIN)
        weights /= weights.sum(axis=1, keepdims=True)
        total = np.zeros_like(points)
        for weight, (rotation, shift) in zip(weights.T, placed.values(), strict=True):
            total += weight[:, None] * (points @ rotation.T + shift)
        return total

    return moved


def animal(name: str, faces: int) -> Mesh:
    """Return a bundled animal with fewer faces."""
    mesh = load_target(name)
    while mesh.num_faces < 1.5 * faces:
        mesh = subdivide(mesh, "midpoint")
    return manifold_pieces(decimate(mesh, faces))


def _pair(name: str, source: Mesh, other: Mesh, change: Map) -> Pair:
    return Pair(name, source, other.with_verts(change(other.verts)), change(source.verts))


def turned(pair: Pair, degrees: float) -> Pair:
    """Return the pair with the source turned."""
    vector = np.radians(degrees) * unit_vectors(np.array([[1.0, 2.0, 0.5]]))[0]
    verts = Rotation.from_rotvec(vector).apply(pair.source.verts.copy())
    return replace(pair, name=f"{pair.name}, turned by {degrees:.0f}°", source=pair.source.with_verts(verts))


def noisy(pair: Pair, share: float) -> Pair:
    """Return the pair with noise along the normals of the target, as a share of the diagonal."""
    assert isinstance(pair.target, Mesh)
    offset = np.random.default_rng(0).normal(size=pair.target.num_verts) * share * pair.diagonal
    normals = unit_vectors(vert_area_vectors(pair.target))
    target = pair.target.with_verts(pair.target.verts + offset[:, None] * normals)
    return replace(pair, name=f"{pair.name}, noise of {share:.1%}", target=target)


def cut(pair: Pair, axis: int, share: float) -> Pair:
    """Return the pair with the part of the target beyond a plane cut off."""
    assert isinstance(pair.target, Mesh)
    verts, faces = pair.target.verts, pair.target.faces
    low, high = verts.min(axis=0)[axis], verts.max(axis=0)[axis]
    kept = faces[(verts[faces][:, :, axis].mean(axis=1) - low) < (1 - share) * (high - low)]
    used, inverse = np.unique(kept, return_inverse=True)
    return replace(pair, name=f"{pair.name}, {share:.0%} cut off", target=Mesh(verts[used], inverse.reshape(-1, 3)))


def as_cloud(pair: Pair, count: int = 10_000) -> Pair:
    """Return the pair with points in place of the target's faces."""
    assert isinstance(pair.target, Mesh)
    points = sample_surface(pair.target, count, np.random.default_rng(1)).points
    return replace(pair, name=f"{pair.name}, {count:,} points", target=PointCloud(points))


def pairs() -> list[Callable[[], Pair]]:
    """Return the makers of all pairs."""
    made: list[Callable[[], Pair]] = [
        lambda pose=pose: _pair(pose, figure(0.019), figure(0.017), posed(pose)) for pose in POSES
    ]
    cow, bunny = lambda n: animal("cow", n), lambda n: animal("bunny", n)
    for name, shape, change in (
        ("cow bent by 90°", cow, bend(90, 2, 0)),
        ("cow bent by 150°", cow, bend(150, 2, 0)),
        ("cow twisted by 90°", cow, twist(90, 2)),
        ("bunny bent by 90°", bunny, bend(90, 1, 0)),
        ("bunny twisted by 120°", bunny, twist(120, 1)),
    ):

        def make(name=name, shape=shape, change=change) -> Pair:
            source, other = shape(16_000), shape(24_000)
            return _pair(name, source, other, change(source.verts))

        made.append(make)
    walk = made[0]
    made += [
        lambda: turned(walk(), 130),
        lambda: noisy(walk(), 0.003),
        lambda: cut(walk(), 1, 0.25),
        lambda: as_cloud(walk()),
    ]
    return made


def _write(folder: Path) -> None:
    """Write the template and the target of the squatting figure, for the picture of the documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    pair = next(made for make in pairs() if (made := make()).name == "squat")
    assert isinstance(pair.target, Mesh)
    save_mesh(pair.source, folder / "template.ply")
    save_mesh(pair.target, folder / "scan.ply")


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
