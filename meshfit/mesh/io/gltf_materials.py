"""Materials of glTF files: the glTF objects with their textures, samplers and images, read and written."""

import copy
import json
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import unquote

from meshfit.errors import MeshError
from meshfit.mesh.attributes import Image, Material, MaterialDefinition
from meshfit.mesh.io.gltf_buffer_writer import BufferWriter
from meshfit.mesh.io.gltf_buffers import Document
from meshfit.mesh.io.json_objects import JsonObject

SUFFIX = ".gltf"
# Extensions of materials that refer to parts of a file which are not kept.
_FOREIGN = ("MSFT_lod", "KHR_techniques_webgl")
_SPECULAR = "KHR_materials_pbrSpecularGlossiness"
_PBR = "pbrMetallicRoughness"
_BASE = ((_PBR, "baseColorFactor", "baseColorTexture"), (_SPECULAR, "diffuseFactor", "diffuseTexture"))
_SIGNATURES = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_WHITE = (1.0, 1.0, 1.0, 1.0)
_Json = dict[str, Any]


class MaterialReader:
    """The materials of a file, each read once.

    The definition of a material has the members `material`, `textures`, `images` and `required`: the glTF object, whose
    textures count within the definition; the textures, with their samplers in place and the images counted within the
    definition; what the file says of each image besides its bytes; and names of extensions that the material cannot do
    without.

    Args:
        document: the file.

    Attributes:
        faults: for which a material or a texture was left out, in words.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        self._images: dict[int, Image] = {}
        self.faults: list[str] = []

    def read(self, index: int) -> Material:
        """Return a material that the file has; one without a look if it is damaged."""
        entry = self._document.items("materials")[index]
        try:
            return self._read(entry)
        except MeshError as fault:
            self.faults.append(str(fault))
            return Material(entry.name())

    def _read(self, entry: JsonObject) -> Material:
        if (base := entry.member(_PBR)) is not None:
            base.numbers("baseColorFactor", 4)
        material = entry.plain()
        for extension in _FOREIGN:
            if isinstance(extensions := material.get("extensions"), dict):
                extensions.pop(extension, None)
        textures: list[_Json] = []
        images: list[int] = []
        numbers: dict[int, int] = {}
        for owner, key, reference in list(_texture_references(material)):
            try:
                index = _number(reference, "index", f"{entry.place}.{key}")
                if index not in numbers:
                    texture = self._texture(index, images, f"{entry.place}.{key}")
                    numbers[index] = len(textures)
                    textures.append(texture)
                reference["index"] = numbers[index]
            except MeshError as fault:
                self.faults.append(str(fault))
                del owner[key]
        required = set(self._document.root.texts("extensionsRequired"))
        content = {
            "material": material,
            "textures": textures,
            "images": [_image_members(self._document.items("images")[index]) for index in images],
            "required": sorted(required & _extensions([material, textures])),
        }
        definition = MaterialDefinition(SUFFIX, content, tuple(self._images[index] for index in images))
        color, texture_image = _base(definition)
        return Material(entry.name(), color, texture_image, definition)

    def _texture(self, index: int, images: list[int], place: str) -> _Json:
        """Return a texture with its sampler in place; append the images that it refers to."""
        entry = self._document.item("textures", index, place)
        texture = entry.plain()
        if "sampler" in entry:
            texture["sampler"] = self._document.item("samplers", entry.integer("sampler"), entry.place).plain()
        found = 0
        for owner in _image_owners(texture):
            source = _number(owner, "source", entry.place)
            self._read_image(source, entry.place)
            if source not in images:
                images.append(source)
            owner["source"] = images.index(source)
            found += 1
        if not found:
            raise MeshError(f"{entry.place}: no image")
        return texture

    def _read_image(self, index: int, place: str) -> None:
        if index in self._images:
            return
        image = self._document.item("images", index, place)
        name = image.name()
        if "bufferView" in image:
            content = self._document.view(image.integer("bufferView"), image.place)[0].tobytes()
        else:
            uri = image.text("uri")
            content = self._document.uri_content(uri, image.place)[0]
            if not uri.startswith("data:"):
                name = PurePosixPath(unquote(uri).replace("\\", "/")).name
        kind = image.text("mimeType", "") or _kind(content)
        if name and not PurePosixPath(name).suffix and kind.startswith("image/"):
            name += "." + kind.removeprefix("image/").replace("jpeg", "jpg")
        self._images[index] = Image(name, content)


class MaterialWriter:
    """The materials of a file that is written, with textures, samplers and images, each once.

    Args:
        buffer: of the file.
        sections: JSON of the file, to which `materials` and so on are added.
    """

    def __init__(self, buffer: BufferWriter, sections: _Json) -> None:
        self._buffer = buffer
        self._sections = sections
        self._known: dict[tuple[str, str], int] = {}
        self._images: dict[tuple[str, bytes], int] = {}
        self._required: set[str] = set()

    def write(self, material: Material) -> int:
        """Add a material, and return its index."""
        definition = material.definition
        entry: _Json
        if definition is not None and is_gltf(material):
            entry = copy.deepcopy(definition.content["material"])
            textures = definition.content["textures"]
            for _, _, reference in _texture_references(entry):
                reference["index"] = self._texture(textures[reference["index"]], definition)
            color, texture = _base(definition)
            self._required |= set(definition.content["required"])
        else:
            # Nothing shines unless a file says so.
            entry = {_PBR: {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
            if material.color[3] < 1:
                entry["alphaMode"] = "BLEND"
            color, texture = _WHITE, None
        if color != material.color:
            entry.setdefault(_PBR, {})["baseColorFactor"] = list(material.color)
        if not _same_image(texture, material.texture):
            base = entry.setdefault(_PBR, {})
            base.pop("baseColorTexture", None)
            if material.texture is not None and image_kind(material.texture):
                source = self._image(material.texture, {})
                base["baseColorTexture"] = {"index": self._added("textures", {"source": source})}
        entry.pop("name", None)
        if material.name:
            entry["name"] = material.name
        return self._append("materials", entry)

    def finish(self) -> None:
        """Name the extensions that the materials use."""
        names = _extensions([self._sections.get(key, []) for key in ("materials", "textures", "samplers", "images")])
        if names:
            self._sections["extensionsUsed"] = sorted(names)
        if required := sorted(self._required & names):
            self._sections["extensionsRequired"] = required

    def _texture(self, texture: _Json, definition: MaterialDefinition) -> int:
        entry = copy.deepcopy(texture)
        for owner in _image_owners(entry):
            source = owner["source"]
            owner["source"] = self._image(definition.images[source], definition.content["images"][source])
        if "sampler" in entry:
            entry["sampler"] = self._added("samplers", entry["sampler"])
        return self._added("textures", entry)

    def _image(self, image: Image, members: _Json) -> int:
        key = (image.name, image.content)
        if key not in self._images:
            entry = {"name": image.name} if image.name else {}
            kind = _kind(image.content) or image_kind(image)
            entry |= {"mimeType": kind} if kind else {}
            entry |= members | {"bufferView": self._buffer.view(image.content)}
            self._images[key] = self._append("images", entry)
        return self._images[key]

    def _added(self, section: str, entry: _Json) -> int:
        """Return the index of an entry, which is added unless there is an equal one."""
        key = (section, json.dumps(entry, sort_keys=True))
        if key not in self._known:
            self._known[key] = self._append(section, entry)
        return self._known[key]

    def _append(self, section: str, entry: _Json) -> int:
        entries: list[_Json] = self._sections.setdefault(section, [])
        entries.append(entry)
        return len(entries) - 1


def is_gltf(material: Material) -> bool:
    """Return whether a material has the definition of a glTF file."""
    return material.definition is not None and material.definition.suffix == SUFFIX


def image_kind(image: Image) -> str:
    """Return the media type of an image that every reader of glTF takes: PNG or JPEG; empty for another."""
    return _kind(image.content)


def _same_image(one: Image | None, other: Image | None) -> bool:
    return one is other or (one is not None and other is not None and one.content == other.content)


def _kind(content: bytes) -> str:
    return next((kind for signature, kind in _SIGNATURES.items() if content.startswith(signature)), "")


def _base(definition: MaterialDefinition) -> tuple[tuple[float, float, float, float], Image | None]:
    """Return the base colour of a definition, and its image."""
    material: _Json = definition.content["material"]
    extensions = material.get("extensions")
    for member, factor, texture in _BASE:
        base = material.get(member) or (extensions.get(member) if isinstance(extensions, dict) else None)
        if not isinstance(base, dict):
            continue
        values = base.get(factor, list(_WHITE))
        if not isinstance(values, list) or len(values) != 4 or not all(isinstance(x, int | float) for x in values):
            values = _WHITE
        red, green, blue, opacity = (float(value) for value in values)
        reference = base.get(texture)
        image = None
        if isinstance(reference, dict) and isinstance(reference.get("index"), int):
            owners = list(_image_owners(definition.content["textures"][reference["index"]]))
            image = definition.images[owners[0]["source"]]
        return (red, green, blue, opacity), image
    return _WHITE, None


def _texture_references(entry: _Json) -> Iterator[tuple[_Json, str, _Json]]:
    """Yield each reference to a texture in a material, with its owner and its key."""
    for key, value in list(entry.items()):
        if isinstance(value, dict) and key != "extras":
            if key.lower().endswith("texture") and "index" in value:
                yield entry, key, value
            yield from _texture_references(value)


def _number(owner: _Json, key: str, place: str) -> int:
    return JsonObject(owner, place).integer(key)


def _image_owners(texture: _Json) -> Iterator[_Json]:
    """Yield the texture, and those of its extensions, that refer to an image by `source`."""
    extensions = texture.get("extensions")
    candidates = [texture, *(extensions.values() if isinstance(extensions, dict) else [])]
    yield from (owner for owner in candidates if isinstance(owner, dict) and "source" in owner)


def _image_members(image: JsonObject) -> _Json:
    """Return what a file says of an image besides its name and where its bytes are."""
    return {key: value for key, value in image.plain().items() if key not in ("uri", "bufferView", "name")}


def _extensions(value: Any) -> set[str]:  # noqa: ANN401  any JSON
    """Return names of the extensions in JSON, at any depth."""
    if isinstance(value, list):
        return set().union(*map(_extensions, value))
    if not isinstance(value, dict):
        return set()
    own = value.get("extensions")
    return set(own if isinstance(own, dict) else ()).union(
        *(_extensions(member) for key, member in value.items() if key != "extras")
    )
