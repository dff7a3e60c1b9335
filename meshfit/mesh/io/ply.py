"""PLY files, text or binary: vertices, faces, edges, and properties of vertices and faces."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.attributes import COLOR, GROUP, JOINTS, MATERIAL, UV, WEIGHTS, Attributes, Image, Material, is_uv
from meshfit.mesh.curves import Chains, Curves
from meshfit.mesh.io.images import FolderFiles, fault_text
from meshfit.mesh.io.ply_elements import Ply, Rows, read_comments, read_elements
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup, checked_face_size

_LISTS = ("vertex_indices", "vertex_index")
_LARGEST_INDEX = 2**53  # float64 holds every integer up to here
_RESTART = 2**32 - 1  # -1 in an unsigned list

_NORMALS = ("nx", "ny", "nz")
_COLOURS = ("red", "green", "blue", "alpha")
_COLOUR_TYPES = ("u1", "u2", "f4", "f8")
_TEXTURES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_TEXTURE_LIST, _TEXTURE_NUMBER, _TEXTURE_FILE = "texcoord", "texnumber", "TextureFile"
_RESERVED = {COLOR, JOINTS, WEIGHTS, MATERIAL, GROUP}
_NAME = re.compile(r"[!-~]+")
_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float"}
_TYPES |= {"f8": "double"}

_Values = Mapping[str, NDArray[np.float64]]
_Corners = tuple[NDArray[np.int64], NDArray[np.int64]]


def read_ply(content: bytes, folder: Path | None = None, *, attributes: bool = False) -> PolygonSoup:
    """Read vertices and faces in file order, then the triangles of strips.

    Args:
        content: of the file.
        folder: of the file, where its textures are.
        attributes: read colours, texture coordinates and all other numbers of vertices and faces, but no normals.

    Raises:
        MeshError: the file is damaged, or its surface is in elements of another kind; the message names the place.

    Warns:
        MeshfitWarning: of elements with lists of integers that are passed over, of bytes after the last element, and of
            attributes and textures that are not read.
    """
    ply = read_elements(content)
    _check_other_elements(ply)
    corners, sizes = _faces(ply.rows["face"]) if "face" in ply.rows else (np.empty(0, np.int64), np.empty(0, np.int64))
    if "tristrips" in ply.rows:
        triangles = _strip_triangles(ply.rows["tristrips"])
        corners = np.concatenate([corners, triangles.reshape(-1)])
        sizes = np.concatenate([sizes, np.full(len(triangles), 3, dtype=np.int64)])
    soup = PolygonSoup(_verts(ply), corners, sizes)
    if not attributes:
        return soup
    return soup._replace(attributes=_read_attributes(ply, sizes, folder, of_faces="tristrips" not in ply.rows))


def read_ply_segments(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read (V, 3) vertices and (S, 2) the ends of all `edge` elements, in file order.

    Raises:
        MeshError: the file is damaged; the message names the place.

    Warns:
        MeshfitWarning: of bytes after the last element.
    """
    ply = read_elements(content)
    ends = ply.rows["edge"].numbers("vertex1", "vertex2") if "edge" in ply.rows else np.empty((0, 2))
    return _verts(ply), _indices(ends, "'edge' has ends")


def read_ply_property(content: bytes, name: str) -> NDArray[np.float64]:
    """Read (N,) the values of a vertex property, in file order.

    Raises:
        MeshError: there is no such property, it is a list, or the file is damaged.

    Warns:
        MeshfitWarning: of bytes after the last element.
    """
    rows = read_elements(content).rows
    if "vertex" not in rows:
        raise MeshError("it has no vertices")
    names = [prop.name for prop in rows["vertex"].element.properties]
    if name not in names:
        raise MeshError(f"its vertices have no property '{name}'; they have {', '.join(names) or 'none'}")
    return rows["vertex"].numbers(name).reshape(-1)


def ply_files(content: bytes, folder: Path) -> list[Path]:
    """Return the image files that a PLY file names.

    Args:
        content: of the file.
        folder: of the file.

    Raises:
        MeshError: the header is damaged.
    """
    files = FolderFiles(folder)
    for name in _texture_names(read_comments(content)):
        files.read(name)
    return files.found


def read_ply_normals(content: bytes) -> NDArray[np.float64] | None:
    """Read (V, 3) the normals of vertices, in file order; None if there are none.

    Raises:
        MeshError: the file is damaged.
    """
    rows = read_elements(content).rows
    names = {prop.name for prop in rows["vertex"].element.properties} if "vertex" in rows else set()
    return rows["vertex"].numbers(*_NORMALS) if names.issuperset(_NORMALS) else None


def write_ply(
    mesh: Mesh | PolygonMesh, normals: NDArray[np.float64] | None = None, *, textures: Sequence[str] = ()
) -> bytes:
    """Return the bytes of a binary PLY file in double precision; texture coordinates of corners in single precision.

    Args:
        mesh: the mesh, with what `left_out_of_ply` does not name of its attributes.
        normals: (V, 3) of its vertices.
        textures: names of the files of `textures_of`.
    """
    polygons, attributes = PolygonMesh.of(mesh), mesh.attributes
    verts = dict(zip(("x", "y", "z"), mesh.verts.T, strict=True))
    verts |= {} if normals is None else dict(zip(_NORMALS, normals.T, strict=True))
    verts |= _scalars(attributes.vertex)
    faces = _scalars({**attributes.face, **_face_colours(polygons)})
    numbers = textures_of(mesh)[1]
    if textures and (numbers != 0).any():
        faces[_TEXTURE_NUMBER] = numbers.astype(np.int32)
    lists = {_LISTS[0]: polygons.corners[:, None].astype("<i4")}
    if UV in attributes.corner:
        lists[_TEXTURE_LIST] = attributes.corner[UV].astype(np.float32)  # MeshLab reads no others
    of_verts = np.empty(mesh.num_verts, [(name, values.dtype.newbyteorder("<")) for name, values in verts.items()])
    for name, values in verts.items():
        of_verts[name] = values
    sizes = {name: int(polygons.sizes.max(initial=0)) * values.shape[1] for name, values in lists.items()}
    counts = {name: "u1" if size < 256 else "u4" for name, size in sizes.items()}
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {_TEXTURE_FILE} {name}" for name in textures)]
    lines += [f"element vertex {mesh.num_verts}", *_properties(verts), f"element face {mesh.num_faces}"]
    for name, values in lists.items():
        lines.append(f"property list {_TYPES[counts[name]]} {_TYPES[values.dtype.str[1:]]} {name}")
    lines += [*_properties(faces), "end_header\n"]
    header = "\n".join(lines).encode("utf-8", "surrogateescape")
    return header + of_verts.tobytes() + _face_rows(polygons, lists, counts, faces)


def left_out_of_ply(mesh: PolygonMesh) -> list[str]:
    """Return, in words, the attributes of a mesh that a PLY file and its textures leave out."""
    given = mesh.attributes
    kept = _scalars(given.vertex).keys() | _scalars(given.face).keys()
    colours = _face_colours(mesh)
    vertex = {
        name: v for name, v in given.vertex.items() if name not in kept and name != COLOR and not _is_pair(name, v)
    }
    face = {name: v for name, v in given.face.items() if name not in kept and name not in (COLOR, MATERIAL)}
    corner = {name: v for name, v in given.corner.items() if name != UV and not (name == COLOR and colours)}
    phrases = Attributes(vertex, face, corner, groups=given.groups).described()
    looks = Attributes(
        face={n: v for n, v in given.face.items() if n == MATERIAL}, materials=given.materials
    ).described()
    with_texture = [material for material in given.materials if material.texture is not None]
    if looks and not with_texture:
        return [*looks, *phrases]
    if looks and any(m.texture is None or m.definition or m.color != Material().color for m in given.materials):
        return ["materials beyond their textures", *phrases]
    return phrases


def textures_of(mesh: Mesh | PolygonMesh) -> tuple[list[Image], NDArray[np.int64]]:
    """Return the textures of the faces' materials, and (F,) which one each face has; -1 for none."""
    materials, numbers = mesh.attributes.materials, mesh.attributes.face.get(MATERIAL)
    if numbers is None or not any(material.texture for material in materials):
        return [], np.full(mesh.num_faces, -1)
    images, of_material = list[Image](), [-1] * (len(materials) + 1)
    for number, material in enumerate(materials):
        if material.texture is not None:
            same = [at for at, image in enumerate(images) if image.content == material.texture.content]
            of_material[number] = same[0] if same else len(images)
            images += [] if same else [material.texture]
    return images, np.array(of_material)[numbers.astype(np.int64)]


def _scalars(rows: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the columns of data of vertices or faces by the names of their properties; not those that have none."""
    columns = dict[str, NDArray[Any]]()
    for name, values in rows.items():
        if name == COLOR:
            columns |= dict(zip(_COLOURS, _writable(values).T, strict=False))
        elif _is_pair(name, values):
            columns |= dict(zip(_TEXTURES[0], _writable(values).T, strict=True))
    taken = {"x", "y", "z", *_NORMALS, *_LISTS, _TEXTURE_LIST, _TEXTURE_NUMBER, *columns}
    for name, values in rows.items():
        is_scalar = values.ndim == 1 or values.shape[1:] == (1,)
        if is_scalar and _NAME.fullmatch(name) and name not in taken | _RESERVED and not is_uv(name):
            columns[name] = _writable(values.reshape(-1))
    return columns


def _is_pair(name: str, values: NDArray[Any]) -> bool:
    return name == UV and values.ndim == 2 and values.shape[1] == 2


def _face_colours(mesh: PolygonMesh) -> dict[str, NDArray[Any]]:
    """Return colours of corners as those of faces, if all corners of each face have the same and faces have none."""
    colours = mesh.attributes.corner.get(COLOR)
    if colours is None or COLOR in mesh.attributes.face:
        return {}
    of_face = colours[mesh.starts]
    return {COLOR: of_face} if np.array_equal(colours, np.repeat(of_face, mesh.sizes, axis=0)) else {}


def _writable(values: NDArray[Any]) -> NDArray[Any]:
    """Return values in a type that PLY has: 64-bit integers as 32-bit ones, or as float64 where they are too large."""
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind == "b":
        return values.astype(np.uint8)
    if kind in "iu" and size == 8:
        fits = not len(values) or (values.min() >= -(2**31) and values.max() < 2**31)
        return values.astype(np.int32 if fits else np.float64)
    if kind == "f" and size != 4:
        return values.astype(np.float64 if size > 4 else np.float32)
    return values


def _properties(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    return [f"property {_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]


def _face_rows(
    mesh: PolygonMesh, lists: Mapping[str, NDArray[Any]], counts: Mapping[str, str], scalars: Mapping[str, NDArray[Any]]
) -> bytes:
    """Return the rows of the faces: each list after its length, then the numbers."""
    groups = list[tuple[NDArray[np.int64], NDArray[Any]]]()
    every_size = np.unique(mesh.sizes).tolist()
    for size in every_size:
        faces = np.flatnonzero(mesh.sizes == size)
        corners = mesh.starts[faces][:, None] + np.arange(size) if len(every_size) > 1 else None
        fields: list[tuple[Any, ...]] = []
        for name, values in lists.items():
            kind = values.dtype.newbyteorder("<")
            fields += [(f"number of {name}", f"<{counts[name]}"), (name, kind, (size, values.shape[1]))]
        fields += [(f"value of {name}", values.dtype.newbyteorder("<")) for name, values in scalars.items()]
        rows = np.empty(len(faces), fields)
        for name, values in lists.items():
            rows[f"number of {name}"] = size * values.shape[1]
            rows[name] = values.reshape(len(faces), size, -1) if corners is None else values[corners]
        for name, values in scalars.items():
            rows[f"value of {name}"] = values[faces]
        groups.append((faces, rows))
    if len(groups) < 2:
        return b"".join(rows.tobytes() for _, rows in groups)
    widths = np.empty(mesh.num_faces, dtype=np.int64)
    for faces, rows in groups:
        widths[faces] = rows.itemsize
    starts = np.cumsum(widths) - widths
    content = np.empty(int(widths.sum()), dtype=np.uint8)
    for faces, rows in groups:
        places = starts[faces][:, None] + np.arange(rows.itemsize)
        content[places] = np.frombuffer(rows.tobytes(), np.uint8).reshape(places.shape)
    return content.tobytes()


def write_ply_values(mesh: Mesh, of_verts: _Values, of_faces: _Values, comment: str) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with values of vertices and faces by property name.

    Args:
        mesh: V vertices, F faces.
        of_verts: (V,) each.
        of_faces: (F,) each.
        comment: one line of the header.
    """
    verts = np.empty(mesh.num_verts, [(name, "<f8") for name in ("x", "y", "z", *of_verts)])
    faces = np.empty(mesh.num_faces, [("size", "u1"), ("corners", "<i4", 3), *((name, "<f8") for name in of_faces)])
    for name, values in {**dict(zip("xyz", mesh.verts.T, strict=True)), **of_verts}.items():
        verts[name] = values
    for name, values in {"size": 3, "corners": mesh.faces, **of_faces}.items():
        faces[name] = values
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(verts)}"]
    lines += [f"property double {name}" for name in ("x", "y", "z", *of_verts)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    lines += [f"property double {name}" for name in of_faces]
    return "\n".join([*lines, "end_header\n"]).encode() + verts.tobytes() + faces.tobytes()


def write_ply_curves(curves: Curves) -> bytes:
    """Return the bytes of a binary PLY file in double precision, with one `edge` element per segment."""
    chains = Chains.of(curves)
    edges = f"element edge {curves.num_segments}\nproperty int vertex1\nproperty int vertex2\n"
    return _write_points(curves.verts, edges) + np.stack([chains.tail, chains.head], axis=1).astype("<i4").tobytes()


def _write_points(points: NDArray[np.float64], other_elements: str) -> bytes:
    """Return the header and the rows of the vertices."""
    properties = "".join(f"property double {name}\n" for name in ("x", "y", "z"))
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}{other_elements}end_header\n"
    )
    return header.encode() + points.astype("<f8").tobytes()


def _read_attributes(ply: Ply, sizes: NDArray[np.int64], folder: Path | None, *, of_faces: bool) -> Attributes:
    """Return the attributes of vertices and of faces; those of faces only where all are in the element `face`."""
    left_out = list[str]()
    vertex = _columns(ply.rows["vertex"], {"x", "y", "z"}, left_out) if "vertex" in ply.rows else {}
    face, corner = dict[str, NDArray[Any]](), dict[str, NDArray[Any]]()
    materials: tuple[Material, ...] = ()
    if "face" in ply.rows and ply.rows["face"].element.length and of_faces:
        rows = ply.rows["face"]
        face = _columns(rows, {*_LISTS, _TEXTURE_LIST}, left_out)
        if _TEXTURE_LIST in {prop.name for prop in rows.element.properties}:
            corner = _corner_textures(rows, sizes, left_out)
        materials = _textures(ply.comments, folder)
        numbers = face.pop(_TEXTURE_NUMBER, np.zeros(len(sizes), np.int64))
        if materials:
            with np.errstate(invalid="ignore"):
                face[MATERIAL] = np.where((numbers >= 0) & (numbers < len(materials)), numbers, -1).astype(np.int64)
    known = {"vertex", "face", "tristrips", "edge"}
    others = [rows.element for name, rows in ply.rows.items() if name not in known and rows.element.length]
    left_out += [f"element '{element.name}'" for element in others if not element.integer_lists]
    if left_out:
        warnings.warn(f"not read: {', '.join(left_out)}", MeshfitWarning, stacklevel=3)
    return Attributes(vertex, face, corner, materials)


def _columns(rows: Rows, known: set[str], left_out: list[str]) -> dict[str, NDArray[Any]]:
    """Return the data of an element's numbers, and note in words what is not read; normals would soon be wrong."""
    names = [prop.name for prop in rows.element.properties]
    columns = dict[str, NDArray[Any]]()
    for prop in rows.element.properties:
        if prop.name in known or prop.name in _NORMALS:
            continue
        if prop.count_code or names.count(prop.name) > 1 or prop.name in _RESERVED or is_uv(prop.name):
            left_out.append(f"{'list' if prop.count_code else 'property'} '{prop.name}' of '{rows.element.name}'")
            continue
        columns[prop.name] = rows.column(prop.name)
    for prefix in ("diffuse_", ""):
        colour = [prefix + name for name in _COLOURS if prefix + name in columns]
        channels = [columns[name] for name in colour]
        if colour[:3] == [prefix + name for name in _COLOURS[:3]] and _are_colours(channels):
            columns = {name: values for name, values in columns.items() if name not in colour}
            columns[COLOR] = np.stack(channels, axis=1)
    for pair in _TEXTURES if rows.element.name == "vertex" else ():
        if all(name in columns and columns[name].dtype.kind == "f" for name in pair) and UV not in columns:
            columns[UV] = np.stack([columns.pop(name) for name in pair], axis=1)
    return columns


def _are_colours(channels: list[NDArray[Any]]) -> bool:
    dtype = channels[0].dtype
    if dtype.str[1:] not in _COLOUR_TYPES or any(channel.dtype != dtype for channel in channels):
        return False
    return dtype.kind == "u" or all(((channel >= 0) & (channel <= 1)).all() for channel in channels)


def _corner_textures(rows: Rows, sizes: NDArray[np.int64], left_out: list[str]) -> dict[str, NDArray[Any]]:
    """Return the texture coordinates of corners, 0 in faces without."""
    values, lengths = rows.lists(_TEXTURE_LIST)
    if values.dtype.kind != "f" or not ((lengths == 2 * sizes) | (lengths == 0)).all():
        left_out.append(f"list '{_TEXTURE_LIST}' of 'face'")
        return {}
    if not len(values):
        return {}
    prop = next(prop for prop in rows.element.properties if prop.name == _TEXTURE_LIST)
    uv = np.zeros((int(sizes.sum()), 2), np.dtype(prop.code if prop.code in ("f", "d") else "d"))
    with np.errstate(invalid="ignore", over="ignore"):
        uv[np.repeat(lengths > 0, sizes)] = values.reshape(-1, 2)
    return {UV: uv}


def _textures(comments: list[list[str]], folder: Path | None) -> tuple[Material, ...]:
    """Return a material for each texture that the comments name."""
    names = _texture_names(comments)
    files = FolderFiles(folder) if folder is not None else None
    images = [files.image(name) if files else None for name in names]
    missing = files.missing if files else names
    if missing:
        warnings.warn(fault_text("image", list(dict.fromkeys(missing)), "missing"), MeshfitWarning, stacklevel=3)
    return tuple(Material(Path(name).stem, texture=image) for name, image in zip(names, images, strict=True))


def _texture_names(comments: list[list[str]]) -> list[str]:
    return [" ".join(words[1:]) for words in comments if words[:1] == [_TEXTURE_FILE] and len(words) > 1]


def _verts(ply: Ply) -> NDArray[np.float64]:
    return ply.rows["vertex"].numbers("x", "y", "z") if "vertex" in ply.rows else np.empty((0, 3))


def _faces(rows: Rows) -> _Corners:
    """Return the corners of all faces in a row, and the size of each face."""
    entries, sizes = rows.lists(*_LISTS)
    small = np.flatnonzero(sizes < 3)
    if len(small):
        checked_face_size(int(sizes[small[0]]), f"face {small[0]}: ")
    return _indices(entries, "'face' has corners"), sizes


def _strip_triangles(rows: Rows) -> NDArray[np.int64]:
    """Return (T, 3) the triangles of all strips, of which -1 ends one; every other one is turned.

    A triangle with a repeated vertex joins two parts of a strip and is left out.
    """
    entries, sizes = rows.lists(*_LISTS)
    indices = _indices(entries, "'tristrips' has entries")
    strip = np.repeat(np.arange(len(sizes)), sizes)
    is_restart = (indices == -1) | (indices == _RESTART)
    strip = (strip + np.cumsum(is_restart))[~is_restart]
    indices = indices[~is_restart]
    first = np.flatnonzero(np.diff(strip, prepend=-1))
    place = np.arange(len(strip)) - np.repeat(first, np.diff(first, append=len(strip)))
    triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    turned = place[:-2] % 2 == 1
    triangles[turned] = triangles[turned][:, [1, 0, 2]]
    a, b, c = triangles.T
    is_triangle = (strip[:-2] == strip[2:]) & (a != b) & (b != c) & (c != a)
    return np.asarray(triangles[is_triangle])


def _indices(values: NDArray[Any], what: str) -> NDArray[np.int64]:
    if values.dtype.kind == "f" or values.dtype.itemsize == 8:
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(~(np.abs(values.astype(np.float64)) < _LARGEST_INDEX) | (values % 1 != 0))
        if len(bad):
            raise MeshError(f"{what} that are not vertex indices: {float(values.flat[bad[0]]):g}")
    return values.astype(np.int64)


def _check_other_elements(ply: Ply) -> None:
    """Warn of elements that may hold a surface in a way that is not read; refuse a file whose only surface it is."""
    known = ("vertex", "face", "tristrips")
    elements = [rows.element for name, rows in ply.rows.items() if name not in known and rows.element.length]
    names = [f"'{element.name}'" for element in elements if element.integer_lists]
    if not names:
        return
    has_faces = any(name in ply.rows and ply.rows[name].element.length for name in known[1:])
    if has_faces or names == ["'range_grid'"]:  # of a scanner, which has points and no faces
        warnings.warn(f"passed over elements with lists of indices: {', '.join(names)}", MeshfitWarning, stacklevel=3)
        return
    raise MeshError(f"its surface is in elements {', '.join(names)}; expected 'face' or 'tristrips'")
