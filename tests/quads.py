"""Small meshes of quads and of mixed polygons for tests."""

import numpy as np

from meshfit.mesh.polygons import PolygonMesh, face_rows
from meshfit.mesh.solids import quad_cube
from tests.shapes import mixed_closed, mixed_open, wheel


def quad_torus(columns: int = 9, rows: int = 8) -> PolygonMesh:
    """A closed mesh of quads whose verts all have valence 4: vertex (i, j) is i + columns * j."""
    i, j = np.arange(columns * rows) % columns, np.arange(columns * rows) // columns

    def at(right, up):
        return (i + right) % columns + columns * ((j + up) % rows)

    around, about = 2 * np.pi * i / columns, 2 * np.pi * j / rows
    radius = 2 + np.cos(about)
    verts = np.stack([radius * np.cos(around), radius * np.sin(around), np.sin(about)], axis=1)
    return of_rows(verts, np.stack([at(0, 0), at(1, 0), at(1, 1), at(0, 1)], axis=1))


def quad_patch(columns: int = 9, rows: int = 8) -> PolygonMesh:
    """A flat open piece of the lattice; x and y are the lattice coordinates."""
    i, j = np.arange(columns * rows) % columns, np.arange(columns * rows) // columns
    here = np.flatnonzero((i < columns - 1) & (j < rows - 1))
    quads = np.stack([here, here + 1, here + columns + 1, here + columns], axis=1)
    return of_rows(np.stack([i, j, 0 * i], axis=1), quads)


def quad_wheel(valence: int, rings: int = 4) -> PolygonMesh:
    """A flat disk of quads about one vertex, number 0, of any valence; all other inner verts have valence 4.

    Vertex (s, i, j) lies i steps along spoke s, then j along the next one, 1 ≤ i ≤ rings, 0 ≤ j ≤ rings.
    """
    turn = 2 * np.pi / valence
    spokes = np.array([[np.cos(turn * s), np.sin(turn * s), 0.0] for s in range(valence + 1)])

    def at(s, i, j):
        if i == 0:
            s, i, j = (s + 1) % valence, j, 0
        return 1 + (s % valence) * rings * (rings + 1) + (i - 1) * (rings + 1) + j if i else 0

    verts = [np.zeros(3)]
    for s in range(valence):
        verts += [i * spokes[s] + j * spokes[s + 1] for i in range(1, rings + 1) for j in range(rings + 1)]
    quads = [
        (at(s, i, j), at(s, i + 1, j), at(s, i + 1, j + 1), at(s, i, j + 1))
        for s in range(valence)
        for i in range(rings)
        for j in range(rings)
    ]
    return of_rows(np.array(verts), np.array(quads))


def prism(sides: int) -> PolygonMesh:
    """A closed mesh of two polygons of that many corners and quads between them."""
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    low, ahead = np.arange(sides), (np.arange(sides) + 1) % sides
    quads = np.stack([low, ahead, ahead + sides, low + sides], axis=1)
    corners = np.concatenate([low[::-1], low + sides, quads.reshape(-1)])
    return PolygonMesh(np.concatenate([ring, ring + np.array([0, 0, 1.0])]), corners, [sides, sides] + [4] * sides)


def lens(sides: int) -> PolygonMesh:
    """Two polygons glued along all sides, so that every vertex has valence 2; corners lie up and down in turn."""
    turn = 2 * np.pi * np.arange(sides) / sides
    verts = np.stack([np.cos(turn), np.sin(turn), 0.3 * (-1.0) ** np.arange(sides)], axis=1)
    return of_rows(verts, np.array([np.arange(sides), np.arange(sides)[::-1]]))


def cut(mesh: PolygonMesh, face: int) -> PolygonMesh:
    """A mesh one of whose quads is cut in two along a diagonal, by a vertex of valence 2."""
    rows = face_rows(mesh)
    a, b, c, d = rows[face]
    middle, here = mesh.num_verts, mesh.verts[[a, b, c, d]]
    rows[face : face + 1] = [[a, b, c, middle], [a, middle, c, d]]
    verts = np.concatenate([mesh.verts, [here.mean(axis=0) + 0.1 * np.cross(here[1] - here[0], here[2] - here[0])]])
    return PolygonMesh(verts, [v for row in rows for v in row], [len(row) for row in rows])


def cube_with_a_vertex_in_an_edge() -> PolygonMesh:
    """A cube, two of whose faces are pentagons, as a vertex lies in an edge between them."""
    mesh = quad_cube()
    rows = face_rows(mesh)
    a, b = rows[0][:2]
    for row in rows:
        for k, pair in enumerate(zip(row, row[1:] + row[:1], strict=True)):
            if set(pair) == {a, b}:
                row.insert(k + 1, mesh.num_verts)
                break
    verts = np.concatenate([mesh.verts, [(mesh.verts[a] + 2 * mesh.verts[b]) / 3]])
    return PolygonMesh(verts, [v for row in rows for v in row], [len(row) for row in rows])


def two_quads_that_share_two_edges() -> PolygonMesh:
    """An open mesh with an interior vertex of valence 2, number 3."""
    verts = [[0, 0, 2], [0, 0.3, 0], [2, 0, 0], [0.6, 0.1, 0.8], [2, 0.2, 2]]
    return PolygonMesh(verts, [0, 1, 2, 3, 3, 2, 4, 0], [4, 4])


def mixed(*, closed: bool = True, seed: int = 5) -> PolygonMesh:
    """Triangles, quads and pentagons: a triangle mesh of mixed valence, some of whose inner edges are taken away."""
    mesh = mixed_closed() if closed else mixed_open()
    faces = {f: list(map(int, face)) for f, face in enumerate(mesh.faces)}
    generator = np.random.default_rng(seed)
    for _ in range(400):
        first, second = (int(f) for f in generator.choice(list(faces), 2, replace=False))
        joined = _joined(faces[first], faces[second])
        valence = np.bincount(np.concatenate([np.array(face) for face in faces.values()]), minlength=mesh.num_verts)
        shared = [v for v in faces[first] if v in faces[second]]
        if joined and len(joined) < 6 and (valence[shared] > 4).all():
            faces[first] = joined
            del faces[second]
    rows = list(faces.values())
    return PolygonMesh(mesh.verts, [v for row in rows for v in row], [len(row) for row in rows])


def _joined(one: list[int], two: list[int]) -> list[int] | None:
    """The polygon that two make that share one edge."""
    shared = [v for v in one if v in two]
    if len(shared) != 2:
        return None
    k = next(k for k in range(len(one)) if {one[k], one[(k + 1) % len(one)]} == set(shared) or k == len(one) - 1)
    one = one[k + 1 :] + one[: k + 1]
    if {one[0], one[-1]} != set(shared):
        return None
    start = two.index(one[-1])
    two = two[start:] + two[:start]
    return one + two[1:-1] if two[-1] == one[0] else None


def merged(seed: int) -> PolygonMesh:
    """A closed mesh of large polygons, most of whose verts have valence 2: neighbours merged at random."""
    generator, rows = np.random.default_rng(seed), face_rows(PolygonMesh.of(mixed_closed()))
    for _ in range(400):
        one = rows[generator.integers(len(rows))]
        k = generator.integers(len(one))
        a, b = one[k - 1], one[k]
        two = next(row for row in rows if (b, a) in zip(row, row[1:] + row[:1], strict=True))
        if set(one) & set(two) == {a, b}:
            rest = np.roll(two, -two.index(a)).tolist()[1:-1]
            rows = [row for row in rows if row not in (one, two)] + [one[k:] + one[:k] + rest]
    corners = [v for row in rows for v in row]
    used, names = np.unique(corners, return_inverse=True)
    return PolygonMesh(mixed_closed().verts[used], names, [len(row) for row in rows])


def of_rows(verts: np.ndarray, rows: np.ndarray) -> PolygonMesh:
    """A mesh whose faces all have as many corners as the rows are long."""
    return PolygonMesh(verts, rows.reshape(-1), np.full(len(rows), rows.shape[1]))


def renumbered(mesh: PolygonMesh, order: np.ndarray) -> PolygonMesh:
    """The same mesh with vertex v renumbered as order[v]."""
    verts = np.empty_like(mesh.verts)
    verts[order] = mesh.verts
    return PolygonMesh(verts, order[mesh.corners], mesh.sizes)


QUADS = {
    "cube": quad_cube,
    "torus": lambda: quad_torus(5, 4),
    "patch": lambda: quad_patch(5, 4),
    "wheel of 3": lambda: quad_wheel(3, 2),
    "wheel of 7": lambda: quad_wheel(7, 2),
    "one quad": lambda: quad_patch(2, 2),
}
POLYGONS = {
    "prism of 3": lambda: prism(3),
    "prism of 5": lambda: prism(5),
    "mixed closed": mixed,
    "mixed open": lambda: mixed(closed=False),
    "triangles": lambda: PolygonMesh.of(wheel(5, 2)),
}
VALENCE_2 = {
    "pillow": lambda: lens(4),
    "lens of 5": lambda: lens(5),
    "cut torus": lambda: cut(quad_torus(5, 4), 7),
    "cut corner": lambda: cut(quad_patch(4, 3), 0),
    "merged": lambda: merged(3),
    "cube with a vertex in an edge": cube_with_a_vertex_in_an_edge,
    "triangle in a quad": lambda: PolygonMesh(np.eye(4)[:, :3], [0, 1, 2, 0, 2, 3, 1], [3, 4]),
    "two quads that share two edges": two_quads_that_share_two_edges,
}
"""Meshes with interior vertices of valence 2, where two faces share several edges."""
EVERY = QUADS | POLYGONS | VALENCE_2
