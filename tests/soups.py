"""Meshes of several parts, some of which hide others: closed, open, wound in any way."""

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.solids import cube
from meshfit.subdivision.refine import subdivide
from meshfit.subdivision.sphere import icosphere


def joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(mesh.num_verts for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([mesh.verts for mesh in meshes]), np.concatenate(faces))


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.verts, mesh.faces[:, ::-1])


def ball(centre=(0.0, 0.0, 0.0), radius: float = 1.0, level: int = 3) -> Mesh:
    sphere = icosphere(level)
    return sphere.with_verts(radius * sphere.verts + np.array(centre))


def two_balls(level: int = 3) -> Mesh:
    """Unit balls whose centres are sqrt(1.25) apart."""
    return joined(ball(level=level), ball((1.1, 0.2, 0.0), level=level))


def box(low, high, levels: int = 0) -> Mesh:
    corners = cube().verts
    corners = (np.sign(corners) + 1) / 2 * (np.array(high) - np.array(low)) + np.array(low)
    return subdivide(cube().with_verts(corners), "midpoint", levels)


def room() -> Mesh:
    """Six slabs that cross each other round a hollow of side 1.8, with a ball in it."""
    slabs = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            # No two slabs have faces in one plane.
            low, high = np.full(3, -1.05 - 0.01 * axis), np.full(3, 1.05 + 0.01 * axis)
            low[axis], high[axis] = sorted((0.9 * side, side))
            slabs.append(box(low, high, 1))
    return joined(*slabs, ball(radius=0.4, level=2))


def grid(centre, first, second, count: int = 6) -> Mesh:
    """Return a flat sheet: the parallelogram of two vectors from its centre to the middles of two sides."""
    i, j = (part.reshape(-1) for part in np.meshgrid(*2 * [np.arange(count + 1)], indexing="ij"))
    steps = 2 * np.stack([i, j], axis=1) / count - 1
    at = (i * (count + 1) + j)[(i < count) & (j < count)]
    right, up = at + count + 1, at + 1
    faces = np.concatenate([np.stack([at, right, right + 1], 1), np.stack([at, right + 1, up], 1)])
    return Mesh(np.array(centre) + steps @ np.array([first, second]), faces)


def tube(path, radii, around: int = 24) -> Mesh:
    """Return an open tube about a path in the plane y = 0, or a surface of revolution if it is straight."""
    path = np.asarray(path, dtype=float)
    along = np.gradient(path, axis=0)
    aside = np.cross(along, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    angle = 2 * np.pi * np.arange(around) / around
    spokes = aside[:, None] * np.cos(angle)[:, None] + np.array([0.0, 1.0, 0.0]) * np.sin(angle)[:, None]
    verts = path[:, None] + np.asarray(radii)[:, None, None] * spokes
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(len(path) - 1), np.arange(around), indexing="ij"))
    here, there = i * around + j, i * around + (j + 1) % around
    faces = [np.stack([here, there + around, there], 1), np.stack([here, here + around, there + around], 1)]
    return Mesh(verts.reshape(-1, 3), np.concatenate(faces))


def teapot(fine: int = 1) -> Mesh:
    """A body, a bottom, and a lid with a gap below it, all open; spout and handle are open tubes that end inside."""

    def revolved(radii, heights):
        return tube(np.stack([0 * heights, 0 * heights, heights], axis=1), radii, 32 * fine)

    height = np.linspace(-0.8, 0.7, 16 * fine)
    body = revolved(np.sqrt(1 - (0.95 * height) ** 2), height)
    rim = np.linspace(0, 0.97, 8 * fine)
    lid = revolved(0.76 * (1 - rim), 0.715 + 0.25 * (1 - (1 - rim) ** 2))
    bottom = revolved(0.65 * (0.03 + rim), -0.8 - 1e-6 * (1 - rim))
    step = np.linspace(0, 1, 12 * fine)
    spout = tube(np.stack([0.6 + 1.1 * step, 0 * step, -0.3 + 0.9 * step**1.5], axis=1), 0.28 - 0.16 * step)
    turn = np.linspace(-0.45, 0.45, 16 * fine) * np.pi
    handle = tube(np.stack([-0.7 - 0.7 * np.cos(turn), 0 * turn, 0.55 * np.sin(turn)], axis=1), 0.09 + 0 * turn)
    return joined(body, lid, bottom, spout, handle)


def car(*, glazed: bool = True) -> tuple[Mesh, Mesh]:
    """Return the panels of a car, with gaps between them and wound at random, and four seats inside."""
    length, width, height = 2.0, 0.9, 0.35
    x, y, z = np.eye(3)
    top = height + 0.3
    panels = [
        ((0, 0, -height), length * x, width * y),
        ((0, width, 0), length * x, height * z),
        ((0, -width, 0), length * x, height * z),
        ((length, 0, 0), width * y, height * z),
        ((-length, 0, 0), width * y, height * z),
        ((1.5, 0, height), 0.5 * x, width * y),
        ((-1.5, 0, height), 0.5 * x, width * y),
        ((0, 0, height + 0.6), x, width * y),
    ]
    panes = [((0, width, top), x, 0.3 * z), ((0, -width, top), x, 0.3 * z)]
    panes += [((1, 0, top), width * y, 0.3 * z), ((-1, 0, top), width * y, 0.3 * z)]
    generator = np.random.default_rng(0)
    sheets = [grid(centre, 0.98 * u, 0.98 * v) for centre, u, v in panels + (panes if glazed else [])]
    sheets = [turned(sheet) if generator.random() < 0.5 else sheet for sheet in sheets]
    seats = [
        seat
        for x_at in (-0.5, 0.4)
        for y_at in (-0.4, 0.4)
        for seat in (
            grid((x_at, y_at, 0.0), 0.25 * x, 0.25 * y),
            grid((x_at - 0.25, y_at, 0.35), 0.25 * y, 0.35 * z),
            box((x_at - 0.2, y_at - 0.2, -0.25), (x_at + 0.2, y_at + 0.2, -0.05)),
        )
    ]
    return joined(*sheets), joined(*seats)


def figure(parts: int = 40, level: int = 3, seed: int = 0) -> Mesh:
    """A body of ellipsoids that run through each other, each near an earlier one."""
    generator = np.random.default_rng(seed)
    sphere, centres, bodies = icosphere(level), [np.zeros(3)], []
    for _ in range(parts):
        near = centres[generator.integers(len(centres))]
        axes = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        axes *= np.sign(np.linalg.det(axes))
        away = generator.normal(size=3)
        centres.append(near + 0.45 * away / np.linalg.norm(away))
        bodies.append(sphere.with_verts((generator.uniform(0.15, 0.5, 3) * sphere.verts) @ axes.T + centres[-1]))
    return joined(*bodies)
