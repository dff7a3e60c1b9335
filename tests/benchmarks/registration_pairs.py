"""Pairs of a template and a target with known correspondence: bent, twisted and posed, noisy, cut, clouds.

python -m tests.benchmarks.registration_pairs FOLDER    # writes one pair as template.ply and scan.ply
"""

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
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
from tests.benchmarks.skeletons import FIGURE, HAND, HORSE, Map, Skeleton


@dataclass(frozen=True, eq=False)
class Pair:
    """A template, a target, and where the vertices of the template belong.

    Attributes:
        name: in tables.
        source: the template.
        target: to register it to.
        truth: (V, 3) where its vertices belong.
        seen: whether it was looked at while settings were chosen.
    """

    name: str
    source: Mesh
    target: Mesh | PointCloud
    truth: np.ndarray
    seen: bool = True

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


def animal(name: str, faces: int) -> Mesh:
    """Return a bundled animal with fewer faces."""
    mesh = load_target(name)
    while mesh.num_faces < 1.5 * faces:
        mesh = subdivide(mesh, "midpoint")
    return manifold_pieces(decimate(mesh, faces))


_SEEN_POSES = ("walk", "arms raised", "arms forward", "squat")
_UNSEEN_POSES = (
    (FIGURE, "kick", "kick"),
    (FIGURE, "bow", "bow"),
    (HORSE, "gallop", "galloping horse"),
    (HORSE, "graze", "grazing horse"),
    (HAND, "grasp", "grasping hand"),
)
_BENDS = (
    ("cow bent by 90°", "cow", bend(90, 2, 0)),
    ("cow bent by 150°", "cow", bend(150, 2, 0)),
    ("cow twisted by 90°", "cow", twist(90, 2)),
    ("bunny bent by 90°", "bunny", bend(90, 1, 0)),
    ("bunny twisted by 120°", "bunny", twist(120, 1)),
)


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


def pairs(sizes: tuple[int, int] | None = None) -> list[Callable[[], Pair]]:
    """Return the makers of all pairs.

    Args:
        sizes: numbers of faces of template and target; about 16,000 and 20,000 to 24,000 without.
    """
    made: list[Callable[[], Pair]] = [partial(posed, FIGURE, pose, pose, sizes) for pose in _SEEN_POSES]
    made += [partial(_bent, *each, sizes) for each in _BENDS]
    walk = made[0]
    made += [
        lambda: turned(walk(), 130),
        lambda: noisy(walk(), 0.003),
        lambda: cut(walk(), 1, 0.25),
        lambda: as_cloud(walk()),
    ]
    unseen = [partial(posed, *each, sizes) for each in _UNSEEN_POSES]
    unseen.append(partial(_bent, "mousehead bent by 60°", "mousehead", bend(60, 2, 1), sizes))
    return made + [lambda make=make: replace(make(), seen=False) for make in unseen]


def posed(skeleton: Skeleton, pose: str, name: str, sizes: tuple[int, int] | None = None) -> Pair:
    """Return the pair of a shape at rest and in a pose."""
    source, other = (skeleton.surface(edge) for edge in skeleton.edges)
    if sizes is not None:
        source, other = (decimate(mesh, count) for mesh, count in zip((source, other), sizes, strict=True))
    return _pair(name, source, other, skeleton.posed(pose))


def _bent(name: str, shape: str, change: Callable[[np.ndarray], Map], sizes: tuple[int, int] | None) -> Pair:
    source, other = (animal(shape, count) for count in sizes or (16_000, 24_000))
    return _pair(name, source, other, change(source.verts))


def slug(name: str) -> str:
    """Return the name of a pair for files."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _write(folder: Path) -> None:
    """Write the template and the target of the squatting figure, for the picture of the documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    pair = next(made for make in pairs() if (made := make()).name == "squat")
    assert isinstance(pair.target, Mesh)
    save_mesh(pair.source, folder / "template.ply")
    save_mesh(pair.target, folder / "scan.ply")


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
