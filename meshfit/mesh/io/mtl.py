"""MTL files: the materials of an OBJ file, with their images, in the folder of the file."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshfit.mesh.attributes import Image, Material, MaterialDefinition
from meshfit.mesh.io.images import FolderFiles, ImagesBeside, fault_text, first_free, is_free_path, listed
from meshfit.mesh.io.text import BYTE_ORDER_MARK, parse_float

NO_MATERIAL = "(null)"
"""The name in `usemtl` that ends the use of a material."""

# Keywords of lines that end in the name of an image file.
_IMAGE_KEYWORD = re.compile(r"map_\w+|bump|disp|decal|refl|norm", re.IGNORECASE)
_ONE_WORD_OPTIONS = {"-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-imfchan", "-texres", "-type"}
_NUMBERS_OPTIONS = {"-mm": 2, "-o": 3, "-s": 3, "-t": 3}
_NEW_MATERIAL = re.compile(r"[ \t]*newmtl[ \t]+(.*)")
_WORD = re.compile(r"\S+")
_PLACE = re.compile(r"[a-zA-Z][\w+.-]*:")
_SIGNATURES = {b"\x89PNG": ".png", b"\xff\xd8": ".jpg", b"RIFF": ".webp", b"\xabKTX": ".ktx2", b"BM": ".bmp"}
_SHOWN = 4


def read_materials(
    libraries: Iterable[str], names: Iterable[str], folder: Path | None
) -> tuple[tuple[Material, ...], str]:
    """Return the named materials of an OBJ file, and in words what is missing of them; empty if nothing is.

    Args:
        libraries: the text of each `mtllib` line: a name of a file, or several.
        names: of the materials.
        folder: of the OBJ file; None where it is not known.
    """
    texts = list(dict.fromkeys(libraries))
    if folder is None:
        reason = f"they are in {listed(texts)}, in the folder of the file, which is not known here" if texts else ""
        return tuple(Material(name) for name in names), reason
    files = FolderFiles(folder)
    known, absent = _read_libraries(texts, files)
    found = tuple(known.get(name, Material(name)) for name in names)
    unknown = [] if absent or not texts else [material.name for material in found if material.name not in known]
    parts = [("library", absent, "missing"), ("image", files.missing, "missing"), ("material", unknown, "not defined")]
    return found, "; ".join(fault_text(noun, names, fault) for noun, names, fault in parts if names)


def library_files(libraries: Iterable[str], folder: Path) -> list[Path]:
    """Return the files in the folder of an OBJ file, or below it, that `read_materials` reads: libraries and images."""
    files = FolderFiles(folder)
    _read_libraries(dict.fromkeys(libraries), files)
    return files.found


def _read_libraries(texts: Iterable[str], files: FolderFiles) -> tuple[dict[str, Material], list[str]]:
    """Return the materials of all libraries by name, and the libraries that are missing."""
    known, absent = dict[str, Material](), list[str]()
    for text in texts:
        content = files.read(text)
        for library in [text] if content is not None else text.split():
            content = files.read(library)
            if content is None:
                absent.append(library)
            else:
                known |= _parse(content, files)
    return known, absent


def _parse(content: bytes, folder: FolderFiles) -> dict[str, Material]:
    lines: dict[str, list[str]] = {}
    name = None
    for line in content.removeprefix(BYTE_ORDER_MARK).decode("utf-8", "surrogateescape").splitlines():
        if found := _NEW_MATERIAL.match(line):
            name = found[1].strip()
            lines[name] = []
        elif name is not None and line.strip():
            lines[name].append(line.rstrip())
    return {name: _material(name, rows, folder) for name, rows in lines.items()}


def _material(name: str, lines: list[str], folder: FolderFiles) -> Material:
    values = {words[0].lower(): words[1:] for line in lines if (words := line.split())}
    images = {
        words[0].lower(): folder.image(image)
        for line in lines
        if (image := _image_name(line)) and (words := line.split())
    }
    colour = _numbers(values.get("kd", []))
    colour = colour * 3 if len(colour) == 1 else colour
    opacity = _numbers(values.get("d", [])[-1:]) or [1 - number for number in _numbers(values.get("tr", [])[-1:])]
    red, green, blue = colour[:3] if len(colour) >= 3 else (1.0, 1.0, 1.0)
    definition = MaterialDefinition(".obj", "\n".join(lines), tuple({i.name: i for i in images.values() if i}.values()))
    return Material(name, (red, green, blue, opacity[0] if opacity else 1.0), images.get("map_kd"), definition)


def _numbers(words: Sequence[str]) -> list[float]:
    """Return the numbers that some words are; none if one is not."""
    numbers = [number for word in words if (number := parse_float(word.encode("utf-8", "replace"))) is not None]
    return numbers if len(numbers) == len(words) else []


def _image_name(line: str) -> str:
    """Return the name of the image file that a line ends in, after its options; empty if it names none."""
    words = list(_WORD.finditer(line))
    if not words or not _IMAGE_KEYWORD.fullmatch(words[0][0]):
        return ""
    at = 1
    while at < len(words) and words[at][0].startswith("-"):
        option = words[at][0].lower()
        at += 1
        if option in _ONE_WORD_OPTIONS:
            at += 1
        for _ in range(_NUMBERS_OPTIONS.get(option, 0)):
            if at < len(words) - 1 and parse_float(words[at][0].encode("utf-8", "replace")) is not None:
                at += 1
    return line[words[at].start() :].strip() if at < len(words) else ""


@dataclass(frozen=True)
class Library:
    """The files beside an OBJ file.

    Attributes:
        name: of the MTL file.
        files: content of each file to write, by path: the images, then the MTL file.
    """

    name: str
    files: dict[Path, bytes]


def material_names(materials: Sequence[Material]) -> list[str]:
    """Return a name for each material by which an OBJ file can refer to it: without blanks, and no two alike."""
    names = list[str]()
    for material in materials:
        name = "_".join(material.name.split()) or "material"
        names.append(first_free(name, "", lambda other: other not in names and other != NO_MATERIAL))
    return names


def has_look(material: Material) -> bool:
    """Return whether a material is more than a name."""
    return material.definition is not None or material.texture is not None or material.color != Material().color


def library_beside(materials: Sequence[Material], path: Path) -> Library:
    """Return the MTL file of an OBJ file, and its images.

    A material that came from an MTL file keeps all its lines. No image of another content is replaced, and no MTL file
    that the OBJ file does not refer to already: other names are chosen.

    Args:
        materials: of the mesh.
        path: of the OBJ file.
    """
    images = ImagesBeside(path.parent)
    blocks = [
        "\n".join([f"newmtl {name}", *_lines(material, images.place), ""])
        for name, material in zip(material_names(materials), materials, strict=True)
    ]
    content = "\n".join(blocks).encode("utf-8", "surrogateescape")
    usual = f"{path.stem}.mtl"

    def is_free(name: str) -> bool:
        return (name == usual and _refers(path, f"mtllib {name}")) or is_free_path(path.parent / name, content)

    library = first_free(path.stem, ".mtl", is_free)
    return Library(library, {**images.files, path.parent / library: content})


def _lines(material: Material, place: Callable[[Image, str], str]) -> list[str]:
    """Return the lines of a material, with the names that `place` gives to its images."""
    name = material.name or "material"
    if material.definition is not None and material.definition.suffix == ".obj":
        names = {image.name: place(image, name) for image in material.definition.images}
        lines = str(material.definition.content).split("\n")
        ends = [_image_name(line) for line in lines]
        return [
            line.rstrip().removesuffix(end) + names[end] if end in names else line
            for line, end in zip(lines, ends, strict=True)
        ]
    *colour, opacity = map(float, material.color)
    lines = [f"Kd {' '.join(map(repr, colour))}"]
    if opacity != 1:
        lines.append(f"d {opacity!r}")
    if material.texture is not None:
        lines.append(f"map_Kd {place(material.texture, name)}")
    return lines


def _refers(path: Path, line: str) -> bool:
    """Return whether a file has this line among its first ones."""
    try:
        with path.open("rb") as stream:
            return line.encode("utf-8", "surrogateescape") in stream.read(1 << 12).splitlines()
    except OSError:
        return False
