"""Image files beside a mesh file: those that it refers to, and those to write with it."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from meshfit.mesh.attributes import Image
from meshfit.paths import is_regular_file, quoted_path

_PLACE = re.compile(r"[a-zA-Z][\w+.-]*:")
_SIGNATURES = {b"\x89PNG": ".png", b"\xff\xd8": ".jpg", b"RIFF": ".webp", b"\xabKTX": ".ktx2", b"BM": ".bmp"}
_SHOWN = 4


@dataclass
class FolderFiles:
    """The files of a folder that a mesh file refers to.

    Attributes:
        path: of the folder.
        images: that have been asked for, by name; None for those that are missing.
        missing: names of images that are missing.
        found: paths of the files that have been read, without repetition.
    """

    path: Path
    images: dict[str, Image | None] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    found: list[Path] = field(default_factory=list)

    def find(self, name: str) -> Path | None:
        """Return a file in the folder or below it, or None.

        Of a path to another place, such as that of another computer, the last part is looked for.
        """
        parts = PurePosixPath(name.replace("\\", "/")).parts
        if not parts or "\0" in name:
            return None
        inside = parts[0] != "/" and ".." not in parts and not _PLACE.match(name)
        path = self.path.joinpath(*(parts if inside else parts[-1:]))
        return path if parts[-1] not in ("/", "..") and is_regular_file(path) else None

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if it is not there or cannot be read."""
        path = self.find(name)
        try:
            content = None if path is None else path.read_bytes()
        except OSError:
            return None
        if path is not None and path not in self.found:
            self.found.append(path)
        return content

    def image(self, name: str) -> Image | None:
        """Return an image; None if it is missing."""
        if name not in self.images:
            content = self.read(name)
            self.images[name] = None if content is None else Image(name, content)
            if content is None:
                self.missing.append(name)
        return self.images[name]


@dataclass(frozen=True)
class ImagesBeside:
    """The images to write to a folder."""

    folder: Path
    files: dict[Path, bytes] = field(default_factory=dict)

    def place(self, image: Image, otherwise: str) -> str:
        """Return the name of an image in the folder: of a file that holds it, or of one to write.

        Args:
            image: the image.
            otherwise: stem of the name of one without a name.
        """
        present = FolderFiles(self.folder).find(image.name)
        if present is not None and _holds(present, image.content):
            return present.relative_to(self.folder).as_posix()
        planned = (path.name for path, content in self.files.items() if content == image.content)
        if not image.name and (name := next(planned, "")):
            return name
        given = PurePosixPath(image.name.replace("\\", "/"))
        starts = (suffix for start, suffix in _SIGNATURES.items() if image.content.startswith(start))
        stem = "_".join((given.stem or otherwise).split())

        def is_free(name: str) -> bool:
            planned = self.files.get(self.folder / name)
            return is_free_path(self.folder / name, image.content) if planned is None else planned == image.content

        name = first_free(stem, given.suffix or next(starts, ".png"), is_free)
        self.files[self.folder / name] = image.content
        return name


def fault_text(noun: str, names: Sequence[str], fault: str) -> str:
    """Return `image 'a.png' is missing` or `images 'a.png', 'b.png' are missing`."""
    plural = "libraries" if noun == "library" else f"{noun}s"
    return f"{plural} {listed(names)} are {fault}" if len(names) > 1 else f"{noun} {listed(names)} is {fault}"


def listed(names: Sequence[str]) -> str:
    """Return names in quotes, the first few of many."""
    shown = ", ".join(quoted_path(name) for name in names[:_SHOWN])
    return f"{shown} and {len(names) - _SHOWN} more" if len(names) > _SHOWN else shown


def first_free(stem: str, suffix: str, is_free: Callable[[str], bool]) -> str:
    """Return the first free name of `stem`, `stem-1`, `stem-2` and so on."""
    number, name = 0, f"{stem}{suffix}"
    while not is_free(name):
        number += 1
        name = f"{stem}-{number}{suffix}"
    return name


def is_free_path(path: Path, content: bytes) -> bool:
    """Return whether there is no file at a path, or one of this content."""
    return not os.path.lexists(path) or _holds(path, content)


def _holds(path: Path, content: bytes) -> bool:
    try:
        return is_regular_file(path) and path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
