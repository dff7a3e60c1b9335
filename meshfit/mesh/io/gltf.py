"""glTF 2.0 files, text (`.gltf`) with buffers beside them and binary (`.glb`)."""

import base64
import json
import struct
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.gltf_buffers import DRACO, MESHOPT, WITHOUT_COMPRESSION, Document, buffer_path
from meshfit.mesh.io.gltf_scene import INSTANCING, Scene
from meshfit.mesh.io.gltf_writing import gltf_document
from meshfit.mesh.io.json_objects import JsonObject
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh, PolygonSoup

_MAGIC = b"glTF"
_JSON, _BIN = b"JSON", b"BIN\0"
_SUPPORTED = {"KHR_mesh_quantization", INSTANCING, DRACO, *MESHOPT}
# Extensions of looks, light, sound and data, which move no vertex.
_NEUTRAL = {
    "ADOBE_materials_thin_transparency",
    "AGI_stk_metadata",
    "CESIUM_primitive_outline",
    "EXT_feature_metadata",
    "EXT_instance_features",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "KHR_techniques_webgl",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
}
_NEUTRAL_PREFIXES = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_audio", "EXT_texture_", "EXT_lights_",
                     "EXT_materials_", "MSFT_texture_", "MSFT_packing_", "VRMC_materials_")  # fmt: skip


def read_gltf(content: bytes, folder: Path | None = None, *, attributes: bool = False) -> PolygonSoup:
    """Read the triangles of the default scene of a glTF file, text or binary, all meshes where their nodes put them.

    Without a default scene, the first one is read; without scenes, all nodes; without nodes, each mesh once. Skins and
    morph targets are applied in the pose that the file holds. A file of points and lines alone gives their vertices.

    Args:
        content: of the file.
        folder: of the file, where its buffers and images are.
        attributes: read texture coordinates, colours, custom data, materials with their images, and skins too; the
            names of nodes, or of meshes, become groups.

    Raises:
        MeshError: a damaged or invalid file, a missing buffer, or a required extension that is not supported.

    Warns:
        MeshfitWarning: with the number of primitives, nodes, meshes and scenes that are passed over; with attributes,
            also with those that are damaged, that only some primitives have, or that a mesh cannot carry.
    """
    root, binary = _split(content)
    _require_version(root)
    _require_extensions(root)
    return Scene(Document(root, binary, folder), attributes=attributes).read()


def gltf_files(content: bytes, folder: Path, *, images: bool = False) -> list[Path]:
    """Return the files beside a glTF file that hold its buffers, without repetition.

    Args:
        content: of the file.
        folder: of the file.
        images: return those of its images too, as far as they are there.

    Raises:
        MeshError: a damaged file, or a missing buffer.
    """
    root = _split(content)[0]
    paths = [buffer_path(uri, folder, place) for uri, place in _uris(root.objects("buffers"))]
    if images:
        with suppress(MeshError):  # reading the file says what is wrong with its images
            paths += _present(root.objects("images"), folder)
    return list(dict.fromkeys(paths))


def _present(images: Iterable[JsonObject], folder: Path) -> Iterator[Path]:
    for image in images:
        with suppress(MeshError):
            yield from (buffer_path(uri, folder, place) for uri, place in _uris([image]))


def _uris(objects: Iterable[JsonObject]) -> list[tuple[str, str]]:
    """Return the URI of each object that is in a file, and the object's place."""
    uris = [(each.text("uri"), each.place) for each in objects if "uri" in each]
    return [(uri, place) for uri, place in uris if not uri.startswith("data:")]


def write_glb(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of a GLB file of the triangles, in single precision, with what the mesh carries.

    The same mesh gives the same bytes.
    """
    document, binary = gltf_document(mesh)
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = [(_JSON, text + b" " * (-len(text) % 4)), (_BIN, binary + b"\0" * (-len(binary) % 4))]
    body = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks if data)
    return _MAGIC + struct.pack("<II", 2, 12 + len(body)) + body


def write_gltf(mesh: Mesh | PolygonMesh) -> bytes:
    """Return the bytes of a text glTF file that holds all its data, otherwise as `write_glb`."""
    document, binary = gltf_document(mesh)
    for buffer in document.get("buffers", []):
        buffer["uri"] = f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    return json.dumps(document, indent=1).encode()


def _split(content: bytes) -> tuple[JsonObject, bytes | None]:
    """Return the JSON and the binary chunk of a file, text or binary."""
    if not content.startswith(_MAGIC):
        return JsonObject.parse(content), None
    if len(content) < 12:
        raise MeshError(f"cut short within its header: {len(content)} bytes")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise MeshError(f"version {version} of glTF; expected version 2: convert the file, for example with Blender")
    if length > len(content):
        raise MeshError(f"cut short: its header announces {length} bytes, but the file has {len(content)}")
    if length < len(content):
        _warn(f"its header announces {length} bytes; ignored the {len(content) - length} bytes after them")
    chunks = _chunks(content[:length])
    if [kind for kind, _ in chunks].count(_JSON) != 1 or chunks[0][0] != _JSON:
        raise MeshError("expected one JSON chunk, and that as the first")
    binary = next((data for kind, data in chunks if kind == _BIN), None)
    return JsonObject.parse(chunks[0][1].rstrip(b"\0 ")), binary


def _chunks(content: bytes) -> list[tuple[bytes, bytes]]:
    """Return the kind and the data of each chunk of a binary file."""
    chunks: list[tuple[bytes, bytes]] = []
    place = 12
    while len(content) - place >= 8:
        size, kind = struct.unpack_from("<I", content, place)[0], content[place + 4 : place + 8]
        place += 8
        if place + size > len(content):
            raise MeshError(f"chunk {len(chunks)} announces {size} bytes, but {len(content) - place} are left")
        chunks.append((kind, content[place : place + size]))
        place += size
    if content[place:].strip(b"\0 "):
        raise MeshError(f"cut short within a chunk's header: {len(content) - place} bytes after the last whole chunk")
    return chunks


def _require_version(root: JsonObject) -> None:
    asset = root.member("asset")
    if asset is None:
        if "meshes" not in root:
            raise MeshError("expected members 'asset' and 'meshes', got neither")
        return
    version = asset.text("version", "2.0")
    if version.partition(".")[0] != "2" or asset.text("minVersion", "2.0") not in {"2", "2.0"}:
        raise MeshError(
            f"version {asset.text('minVersion', version)[:20]} of glTF; expected 2.0: "
            "convert the file, for example with Blender"
        )


def _require_extensions(root: JsonObject) -> None:
    required = root.texts("extensionsRequired")
    unknown = [
        name[:60] for name in required if name not in _SUPPORTED | _NEUTRAL and not name.startswith(_NEUTRAL_PREFIXES)
    ]
    if unknown:
        remedy = WITHOUT_COMPRESSION if any("compression" in name for name in unknown) else "export the file without"
        raise MeshError(f"requires {', '.join(sorted(set(unknown)))}, which is not supported; {remedy}")


def _warn(text: str) -> None:
    warnings.warn(text, MeshfitWarning, stacklevel=3)
