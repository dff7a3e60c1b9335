"""OFF files: a count of vertices and faces, then one per line."""

from meshfit.errors import MeshError
from meshfit.mesh.io.text import Lines, parse_integers, parse_point, split_lines
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size, face_rows


def read_off(content: bytes) -> PolygonSoup:
    """Read vertices and faces in file order; ignore colours and normals.

    Raises:
        MeshError: naming the line at fault.
    """
    lines = split_lines(content)
    number, words = next(lines, (1, [b""]))
    if not words[0].endswith(b"OFF") or b"BINARY" in words or words[0].strip(b"STCNOF"):
        raise MeshError(f"line {number}: expected 'OFF', as text and in three dimensions")
    number, words = (number, words[1:]) if words[1:] else next(lines, (number, []))
    counts = parse_integers(words, number)
    if len(counts) < 2 or min(counts) < 0:
        raise MeshError(f"line {number}: expected the numbers of vertices and faces")
    verts = [parse_point(words, number) for number, words in _take(lines, counts[0], "vertices")]
    faces: list[list[int]] = []
    for number, words in _take(lines, counts[1], "faces"):
        size = parse_integers(words[:1], number)[0]
        if len(words) <= size:
            raise MeshError(f"line {number}: expected a face of {size} corners, got {len(words) - 1}")
        faces.append(parse_integers(words[1 : checked_face_size(size, f"line {number}: ") + 1], number))
    for number, _ in lines:
        raise MeshError(f"line {number}: more lines than the header's {counts[0]} vertices and {counts[1]} faces")
    return PolygonSoup.of_rows(verts, faces)


def write_off(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of an OFF file; every coordinate is read back to the last bit."""
    verts = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.verts.tolist())
    faces = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in face_rows(mesh))
    return f"OFF\n{mesh.num_verts} {mesh.num_faces} 0\n{verts}{faces}".encode()


def _take(lines: Lines, count: int, kind: str) -> Lines:
    for taken in range(count):
        line = next(lines, None)
        if line is None:
            raise MeshError(f"the file ends after {taken} of {count} {kind}")
        yield line
