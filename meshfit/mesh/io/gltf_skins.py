"""Skins of glTF files: the joints that move a mesh, read in the pose of the file and written back at rest in it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.mesh.attributes import Skin, Values
from meshfit.mesh.io.gltf_buffer_writer import BufferWriter
from meshfit.mesh.io.json_objects import JsonObject

SUFFIX = ".gltf"
_REST = "rest"
_JOINTS_PER_SET = 4
# The pose of a joint whose inverse is larger cannot be undone in single precision.
_MOST_ILL_CONDITIONED = 1e6


def skin_of(
    joints: Sequence[int],
    nodes: Sequence[JsonObject],
    parents: Sequence[int | None],
    worlds: Float64[np.ndarray, "N 4 4"],
) -> Skin | None:
    """Return the skin of some joints, at rest in the pose of the nodes; None if a joint is flattened.

    Its content has the members `nodes`, glTF objects of the joints and of all above them, with children that count
    among them; `joints`, indices of nodes; and `worlds`, the transform of each joint to the scene, by rows.

    Args:
        joints: nodes that are joints.
        nodes: of the file.
        parents: the parent of each node.
        worlds: the transform of each node to the scene.
    """
    if any(np.linalg.cond(worlds[joint]) > _MOST_ILL_CONDITIONED for joint in joints):
        return None
    kept: set[int] = set()
    for joint in joints:
        node: int | None = joint
        while node is not None and node not in kept:
            kept.add(node)
            node = parents[node]
    numbers = {node: number for number, node in enumerate(sorted(kept))}
    entries = []
    for node in numbers:
        entry: dict[str, Any] = {"name": name} if (name := nodes[node].name()) else {}
        for key in ("translation", "rotation", "scale", "matrix"):
            if (values := nodes[node].numbers(key)) is not None:
                entry[key] = values
        if children := [numbers[child] for child in nodes[node].integers("children") if child in numbers]:
            entry["children"] = children
        entries.append(entry)
    content = {
        "nodes": entries,
        "joints": [numbers[joint] for joint in joints],
        "worlds": [worlds[joint].tolist() for joint in joints],
    }
    return Skin(SUFFIX, content)


class SkinWriter:
    """A skin that is written, so that its rest pose is the mesh.

    Vertices that no joint moves are given to a further joint, which stays where it is.

    Args:
        skin: of a glTF file.
        joints: (V, J) of the vertices.
        weights: (V, J) of the vertices.
    """

    def __init__(self, skin: Skin, joints: Values, weights: Values) -> None:
        self._nodes: list[dict[str, Any]] = [dict(node) for node in skin.content["nodes"]]
        self._joints: list[int] = list(skin.content["joints"])
        self._worlds: list[Any] = list(skin.content["worlds"])
        missing = -joints.shape[1] % _JOINTS_PER_SET
        indices = np.pad(np.asarray(joints, np.int64), ((0, 0), (0, missing)))
        shares = np.pad(np.asarray(weights, np.float64), ((0, 0), (0, missing)))
        sums = shares.sum(axis=1, keepdims=True)
        moved = sums[:, 0] > 0
        shares = np.divide(shares, sums, out=np.zeros_like(shares), where=sums > 0)
        if not moved.all():
            indices[~moved, 0] = len(self._joints)
            shares[~moved, 0] = 1
            self._joints.append(len(self._nodes))
            self._nodes.append({"name": _REST})
            self._worlds.append(np.eye(4).tolist())
        indices[shares == 0] = 0  # as the standard has it
        width = "<u1" if len(self._joints) <= np.iinfo(np.uint8).max else "<u2"
        self._indices, self._shares = indices.astype(width), shares.astype("<f4")

    def attributes(self) -> dict[str, NDArray[Any]]:
        """Return the vertex data of the file, by name."""
        rows: dict[str, NDArray[Any]] = {}
        for number, start in enumerate(range(0, self._indices.shape[1], _JOINTS_PER_SET)):
            chosen = slice(start, start + _JOINTS_PER_SET)
            rows |= {f"JOINTS_{number}": self._indices[:, chosen], f"WEIGHTS_{number}": self._shares[:, chosen]}
        return rows

    def write(self, buffer: BufferWriter, document: dict[str, Any]) -> None:
        """Append the joints to the nodes of a document, those without a parent to its scene, and its skin."""
        start = len(document["nodes"])
        inner = {child for node in self._nodes for child in node.get("children", [])}
        for node in self._nodes:
            children = {"children": [start + child for child in node["children"]]} if "children" in node else {}
            document["nodes"].append(node | children)
        document["scenes"][0]["nodes"] += [start + node for node in range(len(self._nodes)) if node not in inner]
        inverse = np.linalg.inv(np.array(self._worlds)).transpose(0, 2, 1).reshape(-1, 16).astype("<f4")
        inverse[:, [3, 7, 11]], inverse[:, 15] = 0, 1
        document["skins"] = [
            {"inverseBindMatrices": buffer.accessor(inverse), "joints": [start + node for node in self._joints]}
        ]
