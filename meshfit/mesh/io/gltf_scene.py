"""Scene of a glTF file: nodes, their transforms, and the triangles that they place."""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.attributes import NO_ATTRIBUTES, Attributes
from meshfit.mesh.io.gltf_buffers import Document
from meshfit.mesh.io.gltf_carried import CarriedData
from meshfit.mesh.io.gltf_primitives import FAN, TRIANGLES, Primitive
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.mesh.io.placement import PlacedMeshes, elements_of
from meshfit.mesh.polygons import PolygonSoup
from meshfit.units import count_text

Matrices = Float64[np.ndarray, "N 4 4"]

_POINTS = 0
INSTANCING = "EXT_mesh_gpu_instancing"
# Single precision, in which a file has its matrices, moves a vertex by no more, relative to the size of all.
_ROUNDING = 2e-6


class _Part(NamedTuple):
    """Primitives of a mesh that share their vertices: positions, triangles, joints that move them, attributes.

    Those of points alone have normals, too.
    """

    verts: Float64[np.ndarray, "V 3"]
    triangles: Int64[np.ndarray, "T 3"]
    joints: Int64[np.ndarray, "V J"] | None
    weights: Float64[np.ndarray, "V J"] | None
    attributes: Attributes
    normals: NDArray[np.floating] | None = None

    def soup(self) -> PolygonSoup:
        """Return its triangles."""
        soup = PolygonSoup.of_triangles(self.verts, self.triangles)
        return soup._replace(attributes=self.attributes, normals=self.normals)


class Scene:
    """The nodes of a file, their transforms, and the triangles that they place.

    Args:
        document: the file.
        attributes: read what the meshes carry too.
    """

    def __init__(self, document: Document, *, attributes: bool = False) -> None:
        self._document = document
        self._carried = CarriedData(document) if attributes else None
        self._nodes = document.items("nodes")
        self._meshes: dict[tuple[int, tuple[float, ...], bool], list[_Part]] = {}
        self._passed_over = 0
        self._notes: dict[str, None] = {}
        self._placed = PlacedMeshes()

    def read(self) -> PolygonSoup:
        """Return all triangles; the vertices alone where there are none."""
        children, parents = self._forest()
        worlds = self._worlds(children, parents)
        shown = self._shown_nodes(children, parents)
        with_mesh = {number for number, node in enumerate(self._nodes) if "mesh" in node}
        if not self._document.items("meshes"):
            raise MeshError("no meshes in it")
        if with_mesh:
            for number in (number for number in shown if number in with_mesh):
                self._place_node(number, worlds)
            self._warn_of_the_rest(with_mesh, set(shown))
        else:
            for number in range(len(self._document.items("meshes"))):
                name = self._mesh_name(number)
                self._place(self._parts(number, "the file", None, skinned=False), np.eye(4)[None], name)
        soup = self._placed.soup()
        if self._passed_over and len(soup.sizes):
            _warn(f"passed over {count_text(self._passed_over, 'primitive')} of points and lines")
        for note in self._notes:
            _warn(note)
        return soup if self._carried is None else self._carried.completed(soup, self._placed.pieces, parents, worlds)

    def _forest(self) -> tuple[list[list[int]], list[int | None]]:
        """Return the children and the parent of each node; every node has one parent at most, and none is its own."""
        parents: list[int | None] = [None] * len(self._nodes)
        children = [node.integers("children") for node in self._nodes]
        for number, node in enumerate(self._nodes):
            for child in children[number]:
                self._document.item("nodes", child, f"{node.place}.children")
                if parents[child] is not None:
                    raise MeshError(f"nodes[{child}] is a child twice: of nodes[{parents[child]}] and nodes[{number}]")
                parents[child] = number
        reached = _descendants([number for number, parent in enumerate(parents) if parent is None], children)
        if len(reached) < len(self._nodes):
            circular = min(set(range(len(self._nodes))) - set(reached))
            raise MeshError(f"nodes[{circular}] is among its own ancestors")
        return children, parents

    def _worlds(self, children: list[list[int]], parents: list[int | None]) -> Matrices:
        """Return the transform of each node to the scene."""
        worlds = np.array([_local_transform(node) for node in self._nodes]).reshape(-1, 4, 4)
        for number in _descendants([number for number, parent in enumerate(parents) if parent is None], children):
            parent = parents[number]
            if parent is not None:
                worlds[number] = worlds[parent] @ worlds[number]
        return worlds

    def _shown_nodes(self, children: list[list[int]], parents: list[int | None]) -> list[int]:
        scenes = self._document.items("scenes")
        if not scenes:
            return _descendants([number for number, parent in enumerate(parents) if parent is None], children)
        chosen = self._document.root.integer("scene", 0)
        scene = self._document.item("scenes", chosen, "scene")
        if len(scenes) > 1:
            _warn(f"{len(scenes)} scenes; reading scene {chosen}")
        roots = scene.integers("nodes")
        if len(set(roots)) < len(roots):
            raise MeshError(f"{scene.place}.nodes: a node is listed twice")
        for number in roots:
            self._document.item("nodes", number, f"{scene.place}.nodes")
            if parents[number] is not None:
                raise MeshError(f"{scene.place}.nodes: expected root nodes, got a child of nodes[{parents[number]}]")
        return _descendants(roots, children)

    def _warn_of_the_rest(self, with_mesh: set[int], shown: set[int]) -> None:
        used = {self._nodes[number].integer("mesh") for number in with_mesh}
        if not with_mesh & shown:
            raise MeshError(f"the scene shows none of the {len(with_mesh)} nodes that have a mesh")
        if hidden := len(with_mesh - shown):
            _warn(f"passed over {count_text(hidden, 'node')} with a mesh outside the scene")
        if unused := len(self._document.items("meshes")) - len(used):
            _warn(f"passed over {unused:,} {'mesh' if unused == 1 else 'meshes'} that no node uses")

    def _place_node(self, number: int, worlds: Matrices) -> None:
        """Place the mesh of a node, once or as often as the node repeats it."""
        node = self._nodes[number]
        parts = self._parts(node.integer("mesh"), node.place, node.numbers("weights"), skinned="skin" in node)
        name = self._mesh_name(node.integer("mesh"), node)
        extensions = node.member("extensions")
        instancing = extensions.member(INSTANCING) if extensions else None
        skin = self._document.item("skins", node.integer("skin"), node.place) if "skin" in node else None
        if skin is not None:
            self._place([part for part in parts if part.joints is None], worlds[number][None], name)
            self._place_skinned([part for part in parts if part.joints is not None], skin, worlds, name)
        elif instancing is not None:
            self._place(parts, worlds[number] @ self._instances(instancing), name)
        else:
            self._place(parts, worlds[number][None], name)

    def _mesh_name(self, mesh: int, node: JsonObject | None = None) -> str:
        """Return the name of a node, or else that of its mesh; an empty one where they do not matter."""
        if self._carried is None:
            return ""
        owners = [self._document.items("meshes")[mesh], *([node] if node else [])]
        return next((name for owner in reversed(owners) if (name := owner.name())), "")

    def _place(self, parts: list[_Part], transforms: Matrices, name: str) -> None:
        """Place the parts under each transform, in the group of a name."""
        soups = [self._grouped(part.soup(), name) for part in parts]
        self._placed.require_room(len(transforms) * sum(map(elements_of, soups)), self._document.num_bytes)
        for transform in transforms:
            for soup in soups:
                self._placed.place(soup, transform, self._document.num_bytes)

    def _grouped(self, soup: PolygonSoup, name: str) -> PolygonSoup:
        return soup if self._carried is None else self._carried.grouped(soup, name)

    def _place_skinned(self, parts: list[_Part], skin: JsonObject, worlds: Matrices, name: str) -> None:
        """Append the parts in the pose of the joints; the node of the mesh itself moves nothing."""
        joints = skin.integers("joints")
        for joint in joints:
            self._document.item("nodes", joint, f"{skin.place}.joints")
        pose = worlds[joints]
        if "inverseBindMatrices" in skin:
            inverse = self._document.accessor(skin.integer("inverseBindMatrices"), skin.place, "MAT4")
            if len(inverse) < len(joints):
                raise MeshError(f"{skin.place}: {len(joints)} joints, but {len(inverse)} inverse bind matrices")
            pose = pose @ inverse[: len(joints)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        for part in parts:
            if part.joints is None or part.weights is None:
                continue
            if part.joints.max(initial=-1) >= len(joints):
                raise MeshError(f"{skin.place} has {len(joints)} joints, but a vertex names joint {part.joints.max()}")
            elements = 16 * len(part.verts) + 3 * len(part.triangles) + part.attributes.num_values
            self._placed.spend(elements, self._document.num_bytes)
            verts, mirrored = part.verts, False
            if _moves(pose, worlds[joints], verts):
                self._notes["a skin bends the mesh; reading it in the pose of the file's nodes"] = None
                verts, mirrored = _posed(verts, part.joints, part.weights, pose)
            soup = self._grouped(part.soup()._replace(verts=verts, normals=None), name)
            if self._carried is not None:
                soup = self._carried.skinned(soup, joints, part.joints, part.weights)
            self._placed.append(soup, mirrored=mirrored)

    def _instances(self, instancing: JsonObject) -> Matrices:
        """Return the transforms of a mesh that one node repeats."""
        attributes = instancing.member("attributes") or JsonObject({}, instancing.place)
        kinds = {"TRANSLATION": ("VEC3", [0.0] * 3), "ROTATION": ("VEC4", [0.0, 0, 0, 1]), "SCALE": ("VEC3", [1.0] * 3)}
        columns = {
            name: self._document.accessor(attributes.integer(name), attributes.place, kind).astype(np.float64)
            for name, (kind, _) in kinds.items()
            if name in attributes
        }
        counts = {len(column) for column in columns.values()}
        if len(counts) != 1:
            raise MeshError(f"{attributes.place}: expected accessors of one count, got {sorted(counts)}")
        count = counts.pop()
        translation, rotation, scale = (
            columns.get(name, np.tile(default, (count, 1))) for name, (_, default) in kinds.items()
        )
        return _composed(translation, rotation, scale, attributes.place)

    def _parts(self, index: int, place: str, weights: list[float] | None, *, skinned: bool) -> list[_Part]:
        mesh = self._document.item("meshes", index, place)
        weights = weights if weights is not None else mesh.numbers("weights") or []
        key = (index, tuple(weights), skinned)
        if key not in self._meshes:
            self._meshes[key] = self._read_mesh(mesh, np.array(weights), skinned=skinned)
        return self._meshes[key]

    def _read_mesh(self, mesh: JsonObject, weights: Float64[np.ndarray, " M"], *, skinned: bool) -> list[_Part]:
        """Return the parts of a mesh; primitives with the same position accessor share their vertices."""
        parts: dict[object, _Part] = {}
        points: list[_Part] = []
        for primitive in mesh.objects("primitives"):
            mode = primitive.integer("mode", TRIANGLES)
            if mode > FAN:
                raise MeshError(f"{primitive.place}.mode: expected 0 to 6, got {mode}")
            key, part = self._read_primitive(primitive, mode, weights, skinned=skinned)
            if mode < TRIANGLES:
                self._passed_over += 1
                points.append(part)
            elif key in parts:
                first = parts[key]
                triangles = np.concatenate([first.triangles, part.triangles])
                joined = self._carried.joined(first.soup(), part.soup()) if self._carried else NO_ATTRIBUTES
                parts[key] = first._replace(triangles=triangles, attributes=joined)
            else:
                parts[key] = part
        return [*parts.values(), *points]

    def _read_primitive(
        self, primitive: JsonObject, mode: int, weights: Float64[np.ndarray, " M"], *, skinned: bool
    ) -> tuple[object, _Part]:
        """Return a primitive, and a key that is equal for primitives with the same vertices."""
        reader = Primitive(self._document, primitive)
        base = reader.attribute("POSITION", "VEC3")
        if base is None:
            raise MeshError(f"{primitive.place}: no POSITION among its attributes")
        verts = base.astype(np.float64)
        if "targets" in primitive:
            self._notes["morph targets move the mesh; reading it with the weights of the file"] = None
        for weight, target in zip(weights.tolist(), primitive.objects("targets"), strict=False):
            if weight and "POSITION" in target:
                moved = self._document.accessor(target.integer("POSITION"), target.place, "VEC3")
                if len(moved) != len(verts):
                    raise MeshError(f"{target.place}: {len(moved)} positions for {len(verts)} vertices")
                verts += weight * moved
        triangles = reader.triangles(mode, len(verts)) if mode >= TRIANGLES else np.empty((0, 3), np.int64)
        joints, joint_weights = reader.joints(len(verts)) if skinned else (None, None)
        attributes = NO_ATTRIBUTES
        if self._carried is not None:
            attributes = self._carried.of_primitive(reader, primitive, len(verts), len(triangles))
        normals = reader.attribute("NORMAL", "VEC3") if mode == _POINTS else None
        if normals is not None and len(normals) != len(verts):
            raise MeshError(f"{primitive.place}: {len(normals)} normals for {len(verts)} vertices")
        return reader.vertex_key(), _Part(verts, triangles, joints, joint_weights, attributes, normals)


def _moves(pose: Matrices, worlds: Matrices, verts: Float64[np.ndarray, "V 3"]) -> bool:
    """Return whether joints in a pose move vertices by more than the rounding of the file's matrices."""
    reach = np.abs(verts).max(axis=0, initial=0.0)
    shift = np.abs(pose[:, :3, :3] - np.eye(3)) @ reach + np.abs(pose[:, :3, 3])
    size = reach.max() + np.abs(worlds[:, :3, 3]).max(initial=0.0)
    return bool(shift.max(initial=0.0) > _ROUNDING * size)


def _posed(
    verts: Float64[np.ndarray, "V 3"],
    joints: Int64[np.ndarray, "V J"],
    weights: Float64[np.ndarray, "V J"],
    pose: Matrices,
) -> tuple[Float64[np.ndarray, "V 3"], bool]:
    """Return vertices that joints have moved, and whether most of them are mirrored."""
    blended = np.zeros((len(verts), 4, 4))
    for joint, weight in zip(joints.T, weights.T, strict=True):
        blended += weight[:, None, None] * pose[joint]
    moved = np.einsum("vij,vj->vi", blended[:, :3, :3], verts) + blended[:, :3, 3]
    return moved, bool(np.median(np.sign(np.linalg.det(blended[:, :3, :3]))) < 0)


def _descendants(roots: list[int], children: list[list[int]]) -> list[int]:
    """Return nodes and all below them, each after its parent and in the order of the file."""
    found, waiting = [], roots[::-1]
    while waiting:
        found.append(waiting.pop())
        waiting += children[found[-1]][::-1]
    return found


def _local_transform(node: JsonObject) -> NDArray[np.float64]:
    """Return the transform of a node to its parent, from its matrix or from its translation, rotation and scale."""
    if (numbers := node.numbers("matrix", 16)) is not None:
        matrix: NDArray[np.float64] = np.reshape(numbers, (4, 4)).T
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
            raise MeshError(f"{node.place}.matrix: expected a last row of 0 0 0 1")
        return matrix
    composed: NDArray[np.float64] = _composed(
        np.array([node.numbers("translation", 3) or [0.0] * 3]),
        np.array([node.numbers("rotation", 4) or [0.0, 0, 0, 1]]),
        np.array([node.numbers("scale", 3) or [1.0] * 3]),
        node.place,
    )[0]
    return composed


def _composed(
    translation: Float64[np.ndarray, "N 3"],
    rotation: Float64[np.ndarray, "N 4"],
    scale: Float64[np.ndarray, "N 3"],
    place: str,
) -> Matrices:
    """Return transforms that scale, then rotate by quaternions x y z w, then translate."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if not ((length > 1e-6) & np.isfinite(length)).all():
        raise MeshError(f"{place}: expected a rotation by a unit quaternion, got one of length 0")
    x, y, z, w = (rotation / length).T
    matrices = np.tile(np.eye(4), (len(scale), 1, 1))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrices[:, :3, :3] = np.array(rows).transpose(2, 0, 1) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    return matrices


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=3)
