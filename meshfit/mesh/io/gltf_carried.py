"""All that the meshes of a glTF scene carry: data of their primitives, materials, groups and a skin."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.attributes import GROUP, JOINTS, MATERIAL, WEIGHTS, Attributes, Skin, Values, is_uv
from meshfit.mesh.io.attribute_union import is_color, lacking, over_shared_verts
from meshfit.mesh.io.gltf_attributes import read_attributes
from meshfit.mesh.io.gltf_buffers import Document
from meshfit.mesh.io.gltf_materials import MaterialReader
from meshfit.mesh.io.gltf_primitives import Primitive
from meshfit.mesh.io.gltf_skins import skin_of
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.mesh.polygons import PolygonSoup

# What a file may hold that a mesh does not carry.
_SECTIONS = {"animations": "animations", "cameras": "cameras"}
_EXTENSIONS = {"KHR_lights_punctual": "lights", "KHR_materials_variants": "variants of materials"}


class CarriedData:
    """What the meshes of a file carry, collected while they are placed.

    Args:
        document: the file.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        self._groups: dict[str, int] = {}
        self._joints: dict[int, int] = {}
        self._faults: dict[str, None] = {}
        self._lacking: dict[str, None] = {}
        self._has_morph_targets = False

    def of_primitive(self, reader: Primitive, primitive: JsonObject, num_verts: int, num_faces: int) -> Attributes:
        """Return the data of the vertices of a primitive, and the number of its material in the file."""
        material = -1
        try:
            if "material" in primitive:
                material = primitive.integer("material")
                self._document.item("materials", material, primitive.place)
        except MeshError as fault:
            self._faults[str(fault)] = None
            material = -1
        self._has_morph_targets |= "targets" in primitive
        attributes, faults = read_attributes(reader, num_verts, num_faces, material)
        self._faults |= dict.fromkeys(faults)
        return attributes

    def joined(self, first: PolygonSoup, second: PolygonSoup) -> Attributes:
        """Return the attributes of the faces of two primitives, which have the same vertices."""
        self._lacking |= dict.fromkeys(lacking([first, second]))
        return over_shared_verts(first, second)

    def grouped(self, soup: PolygonSoup, name: str) -> PolygonSoup:
        """Return the soup with its faces in the group of a name, or in none if the name is empty."""
        group = self._groups.setdefault(name, len(self._groups)) if name else -1
        face = {**soup.attributes.face, GROUP: np.full(len(soup.sizes), group)}
        return soup._replace(attributes=replace(soup.attributes, face=face))

    def skinned(
        self, soup: PolygonSoup, joints: Sequence[int], indices: NDArray[np.int64], weights: NDArray[np.float64]
    ) -> PolygonSoup:
        """Return the soup with joints and weights; `indices` count in `joints`, which are nodes."""
        numbers = np.array([self._joints.setdefault(joint, len(self._joints)) for joint in joints])
        rows: dict[str, Values] = {JOINTS: numbers[indices].astype(np.uint16), WEIGHTS: weights.astype(np.float32)}
        return soup._replace(attributes=replace(soup.attributes, vertex={**soup.attributes.vertex, **rows}))

    def completed(
        self,
        soup: PolygonSoup,
        pieces: Sequence[PolygonSoup],
        parents: Sequence[int | None],
        worlds: Float64[np.ndarray, "N 4 4"],
    ) -> PolygonSoup:
        """Return the placed meshes with the materials, groups and the skin that their data counts.

        Args:
            soup: all pieces.
            pieces: of the scene, with their data.
            parents: the parent of each node.
            worlds: the transform of each node to the scene.
        """
        given = soup.attributes
        vertex, face = dict(given.vertex), dict(given.face)
        materials = MaterialReader(self._document)
        used = np.unique(face.pop(MATERIAL, np.empty(0, np.int64)))
        used = used[used >= 0]
        if len(used):
            place = np.searchsorted(used, given.face[MATERIAL])
            face[MATERIAL] = np.where(given.face[MATERIAL] >= 0, place, -1)
        if not self._groups:
            face.pop(GROUP, None)
        attributes = Attributes(
            vertex,
            face,
            given.corner,
            tuple(materials.read(int(index)) for index in used),
            tuple(self._groups),
            self._skin(vertex, parents, worlds),
        )
        self._lacking |= dict.fromkeys(lacking(pieces))
        self._warn([*self._faults, *materials.faults])
        return soup._replace(attributes=attributes)

    def _skin(
        self, vertex: dict[str, Values], parents: Sequence[int | None], worlds: Float64[np.ndarray, "N 4 4"]
    ) -> Skin | None:
        """Return the skin of all joints; without one, take joints and weights out of the data of vertices."""
        if not self._joints:
            return None
        skin = skin_of(list(self._joints), self._document.items("nodes"), parents, worlds)
        if skin is None:
            del vertex[JOINTS], vertex[WEIGHTS]
            self._faults["a joint of its skin has no size"] = None
        return skin

    def _warn(self, faults: list[str]) -> None:
        if faults:
            others = f", and {len(faults) - 1} more" if len(faults) > 1 else ""
            _warn(f"left out damaged attributes: {faults[0]}{others}")
        if self._lacking:
            nouns = ", ".join(dict.fromkeys(_noun(name) for name in sorted(self._lacking)))
            _warn(f"only some of its primitives have {nouns}; the others get white, or 0")
        root = self._document.root
        extensions = root.member("extensions")
        lost = [noun for section, noun in _SECTIONS.items() if section in root]
        lost += [noun for name, noun in _EXTENSIONS.items() if extensions is not None and name in extensions]
        lost += ["morph targets"] if self._has_morph_targets else []
        if lost:
            _warn(f"a mesh does not carry its {', '.join(lost)}")


def _noun(name: str) -> str:
    if is_uv(name):
        return "texture coordinates"
    if is_color(name):
        return "colours"
    return "skin weights" if name in (JOINTS, WEIGHTS) else f"'{name}'"


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=3)
