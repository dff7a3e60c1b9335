"""Recognise files by their first bytes: mesh formats, and what is often taken for a mesh file."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from meshfit.mesh.faceless import POINTS_REMEDY

_EXPORT = "export it as OBJ, PLY or GLB"
_EXPORT_POINTS = "export its points as PLY, XYZ, PTS, PCD or LAS"
_EXPORT_SOLID = "export a mesh of it, as STL, OBJ or PLY"
_UNPACK = "unpack it first"
_HEAD = 4096
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_STL_HEADER, _STL_FACET = 84, 50


class Kind(NamedTuple):
    """A kind of file.

    Attributes:
        name: of the kind, to follow "looks like".
        suffixes: that its files have.
        remedy: what to do with one that is given as a mesh file, if it cannot be read.
    """

    name: str
    suffixes: tuple[str, ...] = ()
    remedy: str = ""


_FOREIGN = (
    Kind("FBX", (".fbx",), _EXPORT),
    Kind("a Blender file", (".blend", ".blend1"), _EXPORT),
    Kind("a 3ds Max file", (".max",), _EXPORT),
    Kind("3DS", (".3ds",), _EXPORT),
    Kind("a Cinema 4D file", (".c4d",), _EXPORT),
    Kind("a Maya file", (".ma", ".mb"), _EXPORT),
    Kind("a ZBrush file", (".ztl", ".zpr"), _EXPORT),
    Kind("a SketchUp file", (".skp",), _EXPORT),
    Kind("a Rhino file", (".3dm",), _EXPORT),
    Kind("LightWave", (".lwo", ".lws"), _EXPORT),
    Kind("Alembic", (".abc",), _EXPORT),
    Kind("USD", (".usd", ".usda", ".usdc", ".usdz"), _EXPORT),
    Kind("VRML", (".wrl", ".vrml", ".wrz"), _EXPORT),
    Kind("X3D", (".x3d", ".x3dv", ".x3db"), _EXPORT),
    Kind("COLLADA", (".dae",), _EXPORT),
    Kind("glTF", (".gltf", ".glb"), _EXPORT),
    Kind("3MF", (".3mf",), _EXPORT),
    Kind("AMF", (".amf",), _EXPORT),
    Kind("CTM", (".ctm",), _EXPORT),
    Kind("DirectX", (".x",), _EXPORT),
    Kind("VTK", (".vtk", ".vtu", ".vtp"), _EXPORT),
    Kind("Gmsh", (".msh",), _EXPORT),
    Kind("PTX", (".ptx",), _EXPORT_POINTS),
    Kind("E57", (".e57",), _EXPORT_POINTS),
    Kind("STEP", (".step", ".stp", ".stpz", ".p21"), _EXPORT_SOLID),
    Kind("IGES", (".iges", ".igs"), _EXPORT_SOLID),
    Kind("BREP", (".brep", ".brp"), _EXPORT_SOLID),
    Kind("Parasolid", (".x_t", ".x_b", ".xmt_txt"), _EXPORT_SOLID),
    Kind("a SolidWorks file", (".sldprt", ".sldasm"), _EXPORT_SOLID),
    Kind("an Inventor file", (".ipt", ".iam"), _EXPORT_SOLID),
    Kind("a Fusion file", (".f3d",), _EXPORT_SOLID),
    Kind("a CATIA file", (".catpart", ".catproduct"), _EXPORT_SOLID),
    Kind("a FreeCAD file", (".fcstd",), _EXPORT_SOLID),
    Kind("DXF", (".dxf",), _EXPORT_SOLID),
    Kind("DWG", (".dwg",), _EXPORT_SOLID),
    Kind("IFC", (".ifc",), _EXPORT_SOLID),
    Kind("the materials of an OBJ", (".mtl",), "give the .obj file"),
    Kind("a ZIP archive", (".zip",), _UNPACK),
    Kind("a 7z archive", (".7z",), _UNPACK),
    Kind("a RAR archive", (".rar",), _UNPACK),
    Kind("a tar archive", (".tar", ".tgz", ".tbz2", ".txz"), _UNPACK),
    Kind("a file compressed with zstd", (".zst",), _UNPACK),
    Kind("a file compressed with lz4", (".lz4",), _UNPACK),
    Kind("a file compressed with compress", (".z",), _UNPACK),
)
_BY_SUFFIX = {suffix: kind for kind in _FOREIGN for suffix in kind.suffixes}

_STARTS = (
    (b"glTF", Kind("GLB", (".glb", ".gltf"))),
    (b"LASF", Kind("a LAS point cloud", (".las", ".laz"), POINTS_REMEDY)),
    (b"Kaydara FBX", _BY_SUFFIX[".fbx"]),
    (b"; FBX", _BY_SUFFIX[".fbx"]),
    (b"BLENDER", _BY_SUFFIX[".blend"]),
    (b"Ogawa", _BY_SUFFIX[".abc"]),
    (b"PXR-USDC", _BY_SUFFIX[".usd"]),
    (b"#usda", _BY_SUFFIX[".usd"]),
    (b"#VRML", _BY_SUFFIX[".wrl"]),
    (b"# vtk DataFile", _BY_SUFFIX[".vtk"]._replace(suffixes=(".vtk",))),
    (b"# .PCD", Kind("a PCD point cloud", (".pcd",), POINTS_REMEDY)),
    (b"ISO-10303-21", _BY_SUFFIX[".step"]._replace(suffixes=(".step", ".stp", ".p21", ".ifc"))),
    (b"$MeshFormat", _BY_SUFFIX[".msh"]),
    (b"3D Geometry File Format", _BY_SUFFIX[".3dm"]),
    (b"PK\x03\x04", _BY_SUFFIX[".zip"]._replace(suffixes=(".usdz", ".zip"))),
    (b"7z\xbc\xaf\x27\x1c", _BY_SUFFIX[".7z"]),
    (b"Rar!\x1a\x07", _BY_SUFFIX[".rar"]),
    (b"\x28\xb5\x2f\xfd", _BY_SUFFIX[".zst"]),
    (b"\x04\x22\x4d\x18", _BY_SUFFIX[".lz4"]),
    (b"version https://git-lfs", Kind("a Git LFS pointer", (), "fetch the mesh with `git lfs pull`")),
    (b"\x00\x05\x16\x07", Kind("the file attributes of macOS", (), "give the file without '._' in its name")),
    (b"\x89PNG\r\n", Kind("a PNG image")),
    (b"\xff\xd8\xff", Kind("a JPEG image")),
    (b"%PDF-", Kind("a PDF document")),
    (b"\x89HDF\r\n", Kind("HDF5")),
    (b"\x7fELF", Kind("a program")),
)
_XML = {
    b"<html": Kind("an HTML page", (), "download the file itself"),
    b"<collada": _BY_SUFFIX[".dae"],
    b"<vtkfile": _BY_SUFFIX[".vtk"]._replace(suffixes=(".vtu", ".vtp", ".vtk")),
    b"<x3d": _BY_SUFFIX[".x3d"],
    b"<amf": _BY_SUFFIX[".amf"],
    b"<svg": Kind("an SVG image"),
    b"<error": Kind("the error message of a server", (), "download the file again"),
}
_PLY, _OFF = Kind("PLY", (".ply",)), Kind("OFF", (".off",))
_STL, _OBJ = Kind("STL", (".stl",)), Kind("OBJ", (".obj",))
_OFF_KEYWORD = re.compile(rb"(ST)?C?N?4?n?OFF\b")
_OBJ_VERTEX = re.compile(rb"^v[ \t]+[-+.\d]+[ \t]", re.MULTILINE)
_SEPARATORS = re.compile(rb"[ \t,;]+")
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def format_name(suffix: str) -> str:
    """Return the name of the format that a suffix stands for: `PLY` for `.ply`."""
    return "glTF" if suffix == ".gltf" else suffix[1:].upper()


def kind_of_suffix(suffix: str) -> Kind | None:
    """Return the well-known kind of file that has a suffix in lower case; None if it is not one of them."""
    return _BY_SUFFIX.get(suffix)


def recognise(content: bytes) -> Kind | None:
    """Return the kind of file that the first bytes are the signature of; None if they are none.

    Nothing that a mesh file of another format may start with counts as a signature.
    """
    if content.startswith(b"PK\x03\x04") and b".model" in content:
        return _BY_SUFFIX[".3mf"]
    for start, kind in _STARTS:
        if content.startswith(start):
            return kind
    text = content[:_HEAD].removeprefix(_BYTE_ORDER_MARK).lstrip()
    if re.match(rb"ply\s+(format|comment|obj_info)\s", text):
        return _PLY
    if text.startswith(b"<"):
        return _recognise_xml(text.lower())
    return None


def guess(head: bytes, size: int) -> Kind | None:
    """Return the kind of file that the content looks like, even where another format might look the same.

    Args:
        head: the first bytes, 64 kB or more of a longer file.
        size: of the whole content in bytes.
    """
    return recognise(head) or next(_guesses(head, size), None)


def _recognise_xml(text: bytes) -> Kind | None:
    if text.startswith(b"<!doctype html"):
        return _XML[b"<html"]
    return next((kind for start, kind in _XML.items() if re.search(re.escape(start) + rb"[\s>/]", text)), None)


def _is_point_row(text: bytes) -> bool:
    """Whether the first line that is not a comment is three numbers or more."""
    whole = text[: max(text.rfind(b"\n"), text.rfind(b"\r")) + 1]  # the last line may be cut short
    lines = (line.strip(b" \t,;") for line in whole.splitlines())
    row = next((line for line in lines if line and not line.startswith(b"#")), b"")
    words = _SEPARATORS.split(row)
    return len(words) >= 3 and all(map(_NUMBER.fullmatch, words))


def _guesses(content: bytes, size: int) -> Iterator[Kind]:
    text = content[:_HEAD].removeprefix(_BYTE_ORDER_MARK).lstrip()
    if len(content) >= _STL_HEADER:
        count = int.from_bytes(content[_STL_HEADER - 4 : _STL_HEADER], "little")
        if count and size == _STL_HEADER + _STL_FACET * count:
            yield _STL
    if text.lower().startswith(b"solid") and re.search(rb"\bfacet\s+normal\b", text.lower()):
        yield _STL
    if _OFF_KEYWORD.match(text):
        yield _OFF
    if content.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\x00" in text:
        yield Kind("text in UTF-16", (), "save it as UTF-8")
    if text.startswith(b"{") and b'"' in text:
        yield _BY_SUFFIX[".gltf"] if b'"asset"' in content[: 1 << 16] else Kind("JSON", (), "give a mesh file")
    if b"\x00" not in text:
        if _OBJ_VERTEX.search(content, 0, 1 << 16):
            yield _OBJ
        if _is_point_row(text):
            yield Kind("a point cloud", (".xyz", ".pts", ".txt", ".asc", ".csv"), POINTS_REMEDY)
