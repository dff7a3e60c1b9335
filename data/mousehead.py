"""Make the target mesh ``mousehead``: a mouse's head as one closed genus-0 triangle mesh.

The head is the zero set of a smooth blend of a few primitives.  It is extracted from a grid, remeshed
isotropically, relaxed along the surface, and projected back onto the zero set.  y is up and the
mouse looks towards +z.  Run ``python data/mousehead.py [OUT]``; by default, the file is written next to this script.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymeshlab
import trimesh
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Vec = tuple[float, float, float]
TINY = 1e-24


def lengths(vectors: Floats) -> Floats:
    """Return the lengths, (N,) float64, of ``vectors``, (N, 3) float64, never quite zero."""
    norms: Floats = np.sqrt(np.sum(vectors**2, axis=1) + TINY)
    return norms


@dataclass(frozen=True)
class Ellipsoid:
    """An axis-aligned ellipsoid."""

    centre: Vec
    radii: Vec

    def __call__(self, points: Floats) -> Floats:
        """Return the approximate signed distance, (N,) float64, of ``points``, (N, 3) float64."""
        scaled = (points - self.centre) / self.radii
        size = lengths(scaled)
        return size * (size - 1.0) / lengths(scaled / self.radii)


@dataclass(frozen=True)
class Cone:
    """A rounded cone: balls of linearly changing radius along a segment."""

    start: Vec
    end: Vec
    radii: tuple[float, float]

    def __call__(self, points: Floats) -> Floats:
        """Return the approximate signed distance, (N,) float64, of ``points``, (N, 3) float64."""
        axis: Floats = np.subtract(self.end, self.start)
        along: Floats = np.clip((points - self.start) @ axis / (axis @ axis), 0.0, 1.0)
        away = lengths(points - self.start - along[:, None] * axis)
        return away - self.radii[0] - (self.radii[1] - self.radii[0]) * along


@dataclass(frozen=True)
class Bowl:
    """A cap of a thick spherical shell with a rounded rim; it rests at ``bottom`` and opens towards ``facing``."""

    bottom: Vec
    facing: Vec
    radius: float
    depth: float
    half_thickness: float

    def __call__(self, points: Floats) -> Floats:
        """Return the signed distance, (N,) float64, of ``points``, (N, 3) float64."""
        normal = np.asarray(self.facing) / np.linalg.norm(self.facing)
        sphere = (self.radius**2 + self.depth**2) / (2.0 * self.depth)
        offset = points - self.bottom - sphere * normal
        down = -(offset @ normal)
        out = lengths(offset + down[:, None] * normal)
        rim = sphere - self.depth
        to_cap = np.abs(lengths(offset) - sphere)
        to_rim = np.hypot(out - self.radius, down - rim)
        return np.where(out * rim < down * self.radius, to_cap, to_rim) - self.half_thickness


@dataclass(frozen=True)
class Part:
    """A primitive, the width over which it melts into the parts before it, and whether it comes in a pair."""

    shape: Callable[[Floats], Floats]
    blend: float
    paired: bool = False


PARTS = (
    Part(Ellipsoid((0.0, 0.05, -0.12), (0.50, 0.46, 0.55)), 0.10),  # skull
    Part(Cone((0.0, -0.08, -0.25), (0.0, -0.25, -0.54), (0.41, 0.37)), 0.30),  # neck
    Part(Cone((0.0, -0.06, 0.18), (0.0, -0.13, 0.76), (0.36, 0.125)), 0.24),  # snout
    Part(Ellipsoid((0.29, -0.14, 0.12), (0.24, 0.22, 0.29)), 0.22, True),  # cheeks
    Part(Ellipsoid((0.0, -0.25, 0.44), (0.13, 0.08, 0.24)), 0.12),  # jaw
    Part(Ellipsoid((0.080, -0.16, 0.76), (0.095, 0.090, 0.13)), 0.08, True),  # whisker pads
    Part(Ellipsoid((0.18, 0.24, 0.22), (0.18, 0.10, 0.16)), 0.20, True),  # brow
    Part(Ellipsoid((0.0, -0.075, 0.875), (0.100, 0.080, 0.080)), 0.05),  # nose
    Part(Ellipsoid((0.272, 0.125, 0.375), (0.105, 0.120, 0.100)), 0.04, True),  # eyes
    Part(Bowl((0.54, 0.62, -0.20), (0.35, 0.08, 1.0), 0.38, 0.15, 0.068), 0.14, True),  # ears
)
LOW: Vec = (-1.2, -0.9, -1.3)
HIGH: Vec = (1.2, 1.3, 1.3)
GRID_STEP = 0.025
EDGE_LENGTH = 0.037
START_STEPS = 3
RELAX_STEPS = 60
RELAX_RATE = 0.5
FINAL_STEPS = 5
GRADIENT_STEP = 1e-5
MIN_ANGLE = 25.0
MAX_RESIDUAL = 1e-12


def smooth_min(a: Floats, b: Floats, width: float) -> Floats:
    """Return the minimum of two (N,) float64 arrays, rounded off where they differ by less than ``width``."""
    overlap = np.maximum(width - np.abs(a - b), 0.0)
    return np.minimum(a, b) - overlap**3 / (6.0 * width**2)


def head(points: Floats) -> Floats:
    """Return the implicit function of the head, (N,) float64, negative inside, at ``points``, (N, 3) float64."""
    value = np.full(len(points), np.inf)
    for part in PARTS:
        near = part.shape(points)
        if part.paired:
            near = smooth_min(near, part.shape(points * (-1.0, 1.0, 1.0)), part.blend)
        value = smooth_min(value, near, part.blend)
    return value


def gradient(points: Floats) -> Floats:
    """Return the gradient of ``head``, (N, 3) float64, by central differences."""
    steps = GRADIENT_STEP * np.eye(3)
    return np.stack([head(points + s) - head(points - s) for s in steps], axis=1) / (2.0 * GRADIENT_STEP)


def project(points: Floats, steps: int) -> Floats:
    """Return ``points``, (N, 3) float64, after that many Newton steps towards the zero set."""
    for _ in range(steps):
        slope = gradient(points)
        points = points - slope * (head(points) / np.sum(slope**2, axis=1))[:, None]
    return points


def cut_out() -> tuple[Floats, Ints]:
    """Return a dual mesh of the grid, (V, 3) float64 and (F, 3) int32: one vertex in each cell that is cut."""
    axes = [np.arange(low, high, GRID_STEP) for low, high in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = (head(grid.reshape(-1, 3)).reshape(grid.shape[:3]) < 0.0).astype(np.int8)
    faces = []
    for axis in range(3):
        across = np.roll(np.eye(3, dtype=np.int64), -axis - 1, axis=0)[:2]
        # A grid edge that leaves the head gets a quad of the four cells around it; one that enters, the same turned.
        for change, (e, f) in ((-1, across), (1, across[::-1])):
            edges = np.argwhere(np.diff(inside, axis=axis) == change)
            ring = np.stack([edges, edges - e, edges - e - f, edges - f])
            cells = np.ravel_multi_index(tuple(np.moveaxis(ring, -1, 0)), inside.shape)
            faces += [cells[[0, 1, 2]].T, cells[[0, 2, 3]].T]
    used, corners = np.unique(np.concatenate(faces), return_inverse=True)
    points = grid.reshape(-1, 3)[used] + 0.5 * GRID_STEP
    return project(points, START_STEPS), corners.reshape(-1, 3).astype(np.int32)


def mesh_set(points: Floats, faces: Ints) -> pymeshlab.MeshSet:
    """Return the mesh, (V, 3) float64 and (F, 3) int32, as pymeshlab works on it."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, faces))
    return meshes


def remesh(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the isotropic remeshing, (V, 3) float64 and (F, 3) int32, to edges of about ``EDGE_LENGTH``."""
    meshes = mesh_set(points, faces)
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=10,
        adaptive=False,
        selectedonly=False,
        targetlen=pymeshlab.PureValue(EDGE_LENGTH),
        featuredeg=180.0,
        checksurfdist=True,
        maxsurfdist=pymeshlab.PureValue(EDGE_LENGTH),
        splitflag=True,
        collapseflag=True,
        swapflag=True,
        smoothflag=True,
        reprojectflag=True,
    )
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix().astype(np.int32)


def relax(points: Floats, faces: Ints) -> Floats:
    """Return ``points``, (V, 3) float64, relaxed along the surface and projected onto the zero set."""
    source, target = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    valence = np.bincount(source, minlength=len(points))[:, None]
    for _ in range(RELAX_STEPS):
        sums = [np.bincount(source, weights=points[target, k], minlength=len(points)) for k in range(3)]
        points = project(points + RELAX_RATE * (np.stack(sums, axis=1) / valence - points), 1)
    return project(points, FINAL_STEPS)


def check(points: Floats, faces: Ints) -> None:
    """Raise ValueError unless the mesh, (V, 3) float64 and (F, 3) int32, has every promised property."""
    mesh = trimesh.Trimesh(points, faces, process=False)
    meshes = mesh_set(points, faces)
    meshes.compute_selection_by_self_intersections_per_face()
    promises = {
        "has 5,000 to 20,000 faces": 5_000 <= len(faces) <= 20_000,
        "uses every vertex": bool(np.array_equal(np.unique(faces), np.arange(len(points)))),
        "is closed and edge-manifold": mesh.is_watertight,
        "is oriented outward": mesh.is_winding_consistent and mesh.volume > 0.0,
        "has Euler number 2": mesh.euler_number == 2,
        "is one component": mesh.body_count == 1,
        "does not cut itself": meshes.current_mesh().selected_face_number() == 0,
        f"has angles of {MIN_ANGLE} degrees or more": float(np.degrees(mesh.face_angles.min())) >= MIN_ANGLE,
        "lies on the zero set": float(np.abs(head(points)).max()) <= MAX_RESIDUAL,
    }
    broken = [promise for promise, kept in promises.items() if not kept]
    if broken:
        raise ValueError(f"mousehead breaks the promise that it: {'; '.join(broken)}")


def write_ply(path: Path, points: Floats, faces: Ints) -> None:
    """Write the mesh, (V, 3) float64 and (F, 3) int32, as binary little-endian PLY with double coordinates."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    path.write_bytes(header.encode("ascii") + points.astype("<f8").tobytes() + records.tobytes())


def main() -> None:
    """Make the head, check it, write it to the given path or next to this script, and print its size."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("mousehead.ply")
    points, faces = remesh(*cut_out())
    points = relax(points, faces)
    check(points, faces)
    write_ply(path, points, faces)
    print(f"{path}: {len(points)} vertices, {len(faces)} faces")


if __name__ == "__main__":
    main()
