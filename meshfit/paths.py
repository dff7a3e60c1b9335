"""Bundled folders, known suffixes, and error messages for files that are missing or cannot be written."""

import difflib
import errno
from collections.abc import Collection
from pathlib import Path

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
CONFIG_SUFFIXES = (".yaml", ".yml")

_PACKAGE = Path(__file__).resolve().parent
_REMEDIES = {
    errno.EACCES: "choose another place, or change the permissions",
    errno.ENOSPC: "free some space, and run the same command again",
    errno.EROFS: "choose another place",
    errno.EISDIR: "give the path of a file",
}


def bundled_folder(name: str) -> Path:
    """Return the bundled folder `configs` or `data`.

    A wheel carries both inside the package; a checkout, which an editable install points at, has them at its top level.
    """
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


def missing_file_message(path: Path, suffixes: Collection[str], otherwise: str = "") -> str:
    """Return the message for a missing file, with the most similar file of its folder if there is one.

    Args:
        path: of the missing file.
        suffixes: of the files to suggest.
        otherwise: what to do where no similar file exists.
    """
    if not path.parent.is_dir():
        return f"no such file: there is no folder {path.parent}"
    names = [other.name for other in path.parent.iterdir() if other.suffix.lower() in suffixes]
    if similar := difflib.get_close_matches(path.name, names, n=1):
        return f"no such file; did you mean '{path.parent / similar[0]}'?"
    return f"no such file in {path.parent.resolve()}{f'; {otherwise}' if otherwise else ''}"


def write_error_message(path: Path, error: OSError) -> str:
    """Return the message for a file that cannot be written: the reason, and the remedy."""
    if error.errno == errno.ENOENT and not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}; create it, or choose another place"
    remedy = _REMEDIES.get(error.errno or 0)
    return f"cannot be written: {error.strerror}" + (f"; {remedy}" if remedy else "")
