"""Small triangle meshes for tests, each built from scratch, with a seed where it is random."""

from functools import cache

import numpy as np

from meshfit.mesh.mesh import Mesh
from meshfit.mesh.meshlab import decimate
from meshfit.mesh.solids import SOLIDS, icosahedron, octahedron, tetrahedron
from meshfit.mesh.targets import load_target
from meshfit.subdivision.refine import subdivide


def grid_faces(columns: int, rows: int) -> np.ndarray:
    """Faces of the regular lattice on a torus: vertex (i, j) is i + columns * j, diagonals join (1, 0) and (0, 1)."""
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))

    def at(di, dj):
        return (i + di) % columns + columns * ((j + dj) % rows)

    lower = np.stack([at(0, 0), at(1, 0), at(0, 1)], axis=1)
    upper = np.stack([at(1, 0), at(1, 1), at(0, 1)], axis=1)
    return np.concatenate([lower, upper])


@cache
def torus(columns: int = 9, rows: int = 8) -> Mesh:
    """A closed mesh whose verts all have valence 6."""
    i, j = np.arange(columns * rows) % columns, np.arange(columns * rows) // columns
    around, about = 2 * np.pi * i / columns, 2 * np.pi * j / rows
    radius = 2 + np.cos(about)
    verts = np.stack([radius * np.cos(around), radius * np.sin(around), np.sin(about)], axis=1)
    return Mesh(verts, grid_faces(columns, rows))


@cache
def patch(columns: int = 9, rows: int = 8) -> Mesh:
    """A flat open piece of the regular lattice; x and y are the lattice coordinates."""
    i, j = np.arange(columns * rows) % columns, np.arange(columns * rows) // columns
    faces = grid_faces(columns, rows)
    inside = ~((np.ptp(faces % columns, axis=1) > 1) | (np.ptp(faces // columns, axis=1) > 1))
    return Mesh(np.stack([i, j, 0 * i], axis=1).astype(np.float64), faces[inside])


@cache
def wheel(valence: int, rings: int = 3) -> Mesh:
    """A flat disk about one vertex, number 0, of any valence; all other inner verts have valence 6."""
    return _sectors(valence, rings, closed=True)


@cache
def fan(neighbours: int, rings: int = 3) -> Mesh:
    """A flat half-disk about one boundary vertex, number 0, with that many neighbours; inside it is regular."""
    return _sectors(neighbours - 1, rings, closed=False)


def _sectors(sectors: int, rings: int, *, closed: bool) -> Mesh:
    turn = 2 * np.pi / sectors if closed else np.pi / sectors
    spokes = [np.array([np.cos(turn * s), np.sin(turn * s), 0.0]) for s in range(sectors + 1)]
    index, verts = {(0, 0): 0}, [np.zeros(3)]
    length = {ring: sectors * ring + (not closed) for ring in range(1, rings + 1)}
    for ring in range(1, rings + 1):
        for place in range(length[ring]):
            sector, part = divmod(place, ring)
            ahead = spokes[min(sector + 1, sectors)]
            index[ring, place] = len(verts)
            verts.append((ring - part) * spokes[sector] + part * ahead)

    def at(ring, sector, part):
        place = sector * ring + part
        return index[ring, place % length[ring] if closed and ring else place]

    faces = []
    for sector in range(sectors):
        for ring in range(1, rings + 1):
            inner = [(at(ring - 1, sector, p) if ring > 1 else 0) for p in range(ring)]
            outer = [at(ring, sector, p) for p in range(ring + 1)]
            faces += [(inner[p], outer[p], outer[p + 1]) for p in range(ring)]
            faces += [(inner[p], outer[p + 1], inner[p + 1]) for p in range(ring - 1)]
    return Mesh(np.array(verts), np.array(faces))


@cache
def mixed_closed(seed: int = 3, inserted: int = 22) -> Mesh:
    """A closed mesh of widely mixed valence: verts put into random faces of an icosahedron, all moved a little."""
    generator = np.random.default_rng(seed)
    solid = icosahedron()
    verts, faces = list(solid.verts), [tuple(face) for face in solid.faces]
    for _ in range(inserted):
        a, b, c = faces.pop(int(generator.integers(len(faces))))
        new = len(verts)
        verts.append(1.05 * (verts[a] + verts[b] + verts[c]) / 3)
        faces += [(a, b, new), (b, c, new), (c, a, new)]
    moved = np.array(verts) + 0.05 * generator.standard_normal((len(verts), 3))
    return Mesh(moved, np.array(faces))


def without_faces(mesh: Mesh, dropped: np.ndarray) -> Mesh:
    """The mesh without those faces and without the verts that only they used."""
    faces = np.delete(mesh.faces, dropped, axis=0)
    used = np.unique(faces)
    return Mesh(mesh.verts[used], np.searchsorted(used, faces))


def opened(mesh: Mesh, *centres: int) -> Mesh:
    """The mesh without the faces around the given verts: one hole each, where they lie apart."""
    return without_faces(mesh, np.flatnonzero(np.isin(mesh.faces, centres).any(axis=1)))


@cache
def mixed_open(seed: int = 3) -> Mesh:
    """An open mesh of mixed valence: two holes, one of a single face, and inner edges that join boundary verts."""
    mesh = opened(mixed_closed(seed), 0)
    far = int(np.argmax(np.linalg.norm(mesh.verts[mesh.faces].mean(axis=1) - mixed_closed(seed).verts[0], axis=1)))
    return without_faces(mesh, np.array([far]))


@cache
def real(name: str, num_faces: int) -> Mesh:
    """A scanned or modelled shape, reduced to about that many faces."""
    return decimate(load_target(name), num_faces)


def permuted(mesh: Mesh, order: np.ndarray) -> Mesh:
    """The same mesh with vertex v renumbered as order[v]."""
    verts = np.empty_like(mesh.verts)
    verts[order] = mesh.verts
    return Mesh(verts, order[mesh.faces])


CLOSED = {
    **SOLIDS,
    "torus": lambda: torus(6, 5),
    "mixed": mixed_closed,
}
OPEN = {
    "triangle": lambda: Mesh(tetrahedron().verts[:3], np.array([[0, 1, 2]])),
    "two triangles": lambda: Mesh(tetrahedron().verts, np.array([[0, 1, 2], [2, 1, 3]])),
    "patch": lambda: patch(5, 4),
    "wheel of 7": lambda: wheel(7, 2),
    "fan of 5": lambda: fan(5, 2),
    "octahedron without a face": lambda: without_faces(octahedron(), np.array([0])),
    "mixed with holes": mixed_open,
}
ALL = CLOSED | OPEN


def table(levels: int = 5) -> Mesh:
    """A flat ball on four long legs, near each other in pairs."""
    mesh = subdivide(icosahedron(), "midpoint", levels)
    x, y, z = (mesh.verts / np.linalg.norm(mesh.verts, axis=1, keepdims=True) * [0.6, 0.35, 0.3]).T
    down = sum(np.exp(-((((x - a) ** 2 + (y - b) ** 2) / 0.09**2) ** 2)) for a in (-0.35, 0.35) for b in (-0.15, 0.15))
    return Mesh(np.stack([x, y, 0.3 + z - np.where(z < 0, 1.1 * down, 0)], axis=1), mesh.faces)
