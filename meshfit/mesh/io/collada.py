"""COLLADA files (`.dae`): geometries, nodes and their transforms."""

import warnings
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.bridging import with_holes
from meshfit.mesh.io.placement import Matrix, PlacedMeshes
from meshfit.mesh.io.xml_elements import (
    Element,
    child,
    children,
    integer_attribute,
    local_name,
    numbers,
    parse_xml,
    require_finite_rows,
    shown,
)
from meshfit.mesh.polygons import PolygonSoup

_POLYGONAL = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_PASSED_OVER = ("lines", "linestrips")
_DEEPEST = 1000


class _Faces(NamedTuple):
    """Corners of faces, and their sizes."""

    corners: NDArray[np.int64]
    sizes: NDArray[np.int64]


def read_dae(content: bytes) -> PolygonSoup:
    """Read the polygons of a COLLADA file's scene, all geometries where their nodes put them, in its unit and axes.

    Without a scene, each geometry is read once. Skins are read in their bind pose, morphs in their base shape. A hole
    of a polygon is joined to its outline by two edges at the same place.

    Raises:
        MeshError: a damaged file, or a reference to another file.

    Warns:
        MeshfitWarning: with the number of lines and geometries that are passed over.
    """
    return _Document(parse_xml(content, "COLLADA"), len(content)).read()


class _Document:
    """The elements of a file by their id, and the geometries that were read."""

    def __init__(self, root: Element, num_bytes: int) -> None:
        self._root = root
        self._num_bytes = num_bytes
        for number, geometry in enumerate(root.iter()):
            if local_name(geometry) == "geometry" and not geometry.get("id"):
                geometry.set("id", f"number {number}")
        self._by_id = {element.get("id", ""): element for element in root.iter() if element.get("id")}
        self._geometries: dict[str, list[PolygonSoup]] = {}
        self._placed = PlacedMeshes()
        self._notes: dict[str, int] = {}

    def read(self) -> PolygonSoup:
        """Return the polygons of the scene."""
        ids = [
            geometry.get("id", "")
            for library in children(self._root, "library_geometries")
            for geometry in children(library, "geometry")
            if child(geometry, "mesh") is not None
        ]
        scene = self._scene()
        if scene is None:
            for name in ids:
                self._place(name, np.eye(4))
        else:
            self._place_nodes(scene)
        if unused := len(set(ids) - set(self._geometries)):
            self._notes["geometries that the scene does not use"] = unused
        for note, count in self._notes.items():
            warnings.warn(f"passed over {count} {note}", MeshfitWarning, stacklevel=3)
        return self._placed.soup()

    def _scene(self) -> Element | None:
        scene = child(self._root, "scene")
        instance = None if scene is None else child(scene, "instance_visual_scene")
        if instance is not None:
            return self._target(instance, "visual_scene")
        return next(
            (
                scene
                for library in children(self._root, "library_visual_scenes")
                for scene in children(library, "visual_scene")
            ),
            None,
        )

    def _place_nodes(self, scene: Element) -> None:
        """Place the geometries of all nodes below a scene."""
        waiting: list[tuple[Element, Matrix, int]] = [(node, np.eye(4), 0) for node in children(scene, "node")][::-1]
        while waiting:
            node, above, depth = waiting.pop()
            if depth > _DEEPEST:
                raise MeshError(f"node {shown(node.get('id'))} is nested {depth} deep, or among its own ancestors")
            self._placed.spend(0, self._num_bytes)
            transform = above @ _node_transform(node)
            for instance in children(node, "instance_geometry"):
                self._place(self._target(instance, "geometry").get("id", ""), transform)
            for instance in children(node, "instance_controller"):
                self._place_controlled(self._target(instance, "controller"), transform)
            below = list(children(node, "node"))
            below += [self._target(instance, "node") for instance in children(node, "instance_node")]
            waiting += [(each, transform, depth + 1) for each in below[::-1]]

    def _place_controlled(self, controller: Element, transform: Matrix) -> None:
        """Place the geometry of a skin or morph, through those that it applies to."""
        for _ in range(_DEEPEST):
            kind = next(children(controller, "skin", "morph"), None)
            if kind is None:
                raise MeshError(f"controller {shown(controller.get('id'))}: expected a skin or a morph, got neither")
            bind = child(kind, "bind_shape_matrix")
            if bind is not None:
                transform = transform @ _matrix(bind.text, "bind_shape_matrix")
            target = self._target(kind, "geometry", "controller", key="source")
            if local_name(target) == "geometry":
                self._place(target.get("id", ""), transform)
                return
            controller = target
        raise MeshError(f"controller {shown(controller.get('id'))} applies to itself")

    def _place(self, name: str, transform: Matrix) -> None:
        if name not in self._geometries:
            self._geometries[name] = self._read_geometry(self._by_id[name]) if name in self._by_id else []
        for piece in self._geometries[name]:
            self._placed.place(piece, transform, self._num_bytes)

    def _target(self, element: Element, *kinds: str, key: str = "url") -> Element:
        """Return the element that another refers to."""
        reference = element.get(key) or ""
        if not reference.startswith("#"):
            raise MeshError(
                f"{local_name(element)}: expected the id of an element of this file, got {shown(reference)}"
            )
        target = self._by_id.get(reference[1:])
        if target is None or local_name(target) not in kinds:
            raise MeshError(
                f"{local_name(element)} refers to {' or '.join(kinds)} {shown(reference)}, which is not there"
            )
        return target

    def _read_geometry(self, geometry: Element) -> list[PolygonSoup]:
        """Return the polygons of a geometry, one piece for each source of positions."""
        place = f"geometry {shown(geometry.get('id'))}"
        mesh = child(geometry, "mesh")
        if mesh is None:
            self._count("geometries that are no meshes", 1)
            return []
        pieces: dict[str, tuple[NDArray[np.float64], list[_Faces]]] = {}
        for element in mesh:
            kind = local_name(element)
            if kind in _PASSED_OVER:
                self._count("sets of lines", 1)
            elif kind in _POLYGONAL:
                source, corners = self._corners(element, place)
                verts, found = pieces.setdefault(source, (self._positions(source, place), []))
                faces = _read_faces(element, corners, verts, f"{place}: {kind}")
                _require_inside(faces, len(verts), f"{place}: {kind}")
                found.append(faces)
        if not pieces:
            vertices = child(mesh, "vertices")
            if vertices is not None:
                pieces[""] = (self._positions(self._position_source(vertices, place), place), [])
        empty = np.empty(0, np.int64)
        return [
            PolygonSoup(
                verts,
                np.concatenate([empty, *(corners for corners, _ in faces)]),
                np.concatenate([empty, *(sizes for _, sizes in faces)]),
            )
            for verts, faces in pieces.values()
        ]

    def _count(self, note: str, count: int) -> None:
        self._notes[note] = self._notes.get(note, 0) + count

    def _corners(self, element: Element, place: str) -> tuple[str, Callable[[Element], NDArray[np.int64]]]:
        """Return the source of positions, and a function that takes their indices out of a `p` or `h` element."""
        inputs = list(children(element, "input"))
        offsets = [integer_attribute(one, "offset", f"{place}: input", 0) for one in inputs]
        found = [(one, offset) for one, offset in zip(inputs, offsets, strict=True) if one.get("semantic") == "VERTEX"]
        if len(found) != 1 or max(offsets) > 100:
            raise MeshError(f"{place}: expected one input VERTEX, got {len(found)}")
        vertices, offset = self._target(found[0][0], "vertices", key="source"), found[0][1]
        stride = max(offsets) + 1

        def indices(holder: Element) -> NDArray[np.int64]:
            values = numbers(holder.text, np.int64, f"{place}: {local_name(holder)}")
            if len(values) % stride:
                raise MeshError(f"{place}: expected a multiple of {stride} indices, got {len(values)}")
            return np.asarray(values[offset::stride])

        return self._position_source(vertices, place), indices

    def _position_source(self, vertices: Element, place: str) -> str:
        for one in children(vertices, "input"):
            if one.get("semantic") == "POSITION":
                return self._target(one, "source", key="source").get("id", "")
        raise MeshError(f"{place}: its vertices have no input POSITION")

    def _positions(self, name: str, place: str) -> NDArray[np.float64]:
        source = self._by_id[name]
        technique = child(source, "technique_common")
        accessor = None if technique is None else child(technique, "accessor")
        array = child(source, "float_array")
        if accessor is not None:
            array = self._target(accessor, "float_array", "int_array", key="source")
        if array is None:
            raise MeshError(f"{place}: source {shown(name)} has no array of numbers")
        values = numbers(array.text, np.float64, f"{place}: source {shown(name)}")
        stride = 3 if accessor is None else integer_attribute(accessor, "stride", place, 1)
        start = 0 if accessor is None else integer_attribute(accessor, "offset", place, 0)
        count = len(values) // max(stride, 1) if accessor is None else integer_attribute(accessor, "count", place)
        if stride < 3 or start + count * stride > len(values) + (stride - 3):
            raise MeshError(f"{place}: source {shown(name)} announces {count} points, but has {len(values)} numbers")
        rows = start + stride * np.arange(count)[:, None] + np.arange(3)
        points = np.asarray(values[rows], np.float64)
        require_finite_rows(points, f"{place}: source {shown(name)}: point")
        return points


def _read_faces(
    element: Element, indices: Callable[[Element], NDArray[np.int64]], verts: NDArray[np.float64], place: str
) -> _Faces:
    """Return the faces of a set of triangles, polygons, strips or fans."""
    kind = local_name(element)
    lists = [indices(holder) for holder in children(element, "p")]
    if kind == "polygons":
        outlines = [[corners] for corners in lists]
        outlines += [
            [indices(loop) for name in ("p", "h") for loop in children(holder, name)]
            for holder in children(element, "ph")
        ]
        for loops in outlines:
            _require_inside(
                _Faces(np.concatenate([np.empty(0, np.int64), *loops]), np.empty(0, np.int64)), len(verts), place
            )
        faces = [with_holes(verts, loops) for loops in outlines if loops]
        return _Faces(np.concatenate([np.empty(0, np.int64), *faces]), _sizes(faces, place))
    if kind in {"tristrips", "trifans"}:
        triangles = np.concatenate([np.empty((0, 3), np.int64), *(_unrolled(corners, kind) for corners in lists)])
        return _Faces(triangles.reshape(-1), np.full(len(triangles), 3))
    corners = np.concatenate([np.empty(0, np.int64), *lists])
    if kind == "triangles":
        if len(corners) % 3:
            raise MeshError(f"{place}: expected three corners for each triangle, got {len(corners)}")
        return _Faces(corners, np.full(len(corners) // 3, 3))
    counts = child(element, "vcount")
    sizes = numbers(counts.text if counts is not None else "", np.int64, f"{place}: vcount")
    if (sizes < 0).any() or sizes.sum() != len(corners):
        raise MeshError(f"{place}: its vcount names {int(sizes.sum())} corners, but {len(corners)} are there")
    whole = sizes >= 3
    if not whole.all():
        few = int((~whole).sum())
        warnings.warn(f"{place}: passed over {few} faces of fewer than 3 corners", MeshfitWarning, stacklevel=3)
    return _Faces(corners[np.repeat(whole, sizes)], sizes[whole])


def _sizes(faces: list[NDArray[np.int64]], place: str) -> NDArray[np.int64]:
    sizes = np.array([len(face) for face in faces], np.int64)
    if (sizes < 3).any():
        raise MeshError(f"{place}: expected polygons of 3 or more corners, got {int(sizes.min())}")
    return sizes


def _unrolled(corners: NDArray[np.int64], kind: str) -> NDArray[np.int64]:
    """Return the triangles of a strip or fan, without those that only lead it elsewhere."""
    first = np.arange(max(len(corners) - 2, 0))
    if kind == "trifans":
        places = np.stack([np.zeros_like(first), first + 1, first + 2], axis=1)
    else:
        places = np.stack([first, first + 1 + first % 2, first + 2 - first % 2], axis=1)
    triangles = corners[places]
    return np.asarray(triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)])


def _require_inside(faces: _Faces, num_verts: int, place: str) -> None:
    outside = (faces.corners < 0) | (faces.corners >= num_verts)
    if outside.any():
        corner = int(faces.corners[outside][0])
        raise MeshError(f"{place}: index {corner}, but its positions are numbered 0 to {num_verts - 1}")


def _node_transform(node: Element) -> Matrix:
    """Return the product of a node's transforms, in their order."""
    result = np.eye(4)
    for matrix in _transforms(node):
        result = result @ matrix
    return result


def _transforms(node: Element) -> Iterator[Matrix]:
    place = f"node {shown(node.get('id') or node.get('name'))}"
    for element in children(node, "matrix", "translate", "rotate", "scale", "lookat", "skew"):
        kind = local_name(element)
        if kind == "matrix":
            yield _matrix(element.text, f"{place}: matrix")
            continue
        values = _finite(element.text, {"rotate": 4, "lookat": 9, "skew": 7}.get(kind, 3), f"{place}: {kind}")
        matrix = np.eye(4)
        if kind == "translate":
            matrix[:3, 3] = values
        elif kind == "scale":
            matrix[[0, 1, 2], [0, 1, 2]] = values
        elif kind == "rotate":
            matrix[:3, :3] = _rotation(values[:3], np.radians(values[3]))
        else:
            raise MeshError(f"{place}: the transform '{kind}' is not supported; apply it, and export again")
        yield matrix


def _rotation(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return the rotation about an axis; the identity for an axis of length 0."""
    length = float(np.linalg.norm(axis))
    if length == 0:
        return np.eye(3)
    x, y, z = (axis / length).tolist()
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))


def _matrix(text: str | None, place: str) -> Matrix:
    return _finite(text, 16, place).reshape(4, 4)


def _finite(text: str | None, count: int, place: str) -> NDArray[np.float64]:
    values = np.asarray(numbers(text, np.float64, place))
    if len(values) != count or not np.isfinite(values).all():
        raise MeshError(f"{place}: expected {count} finite numbers, got {len(values)} numbers")
    return values
