"""What to say of a path that is not there, or cannot be written: what is wrong, and what would do."""

import difflib
import errno
from collections.abc import Sequence
from pathlib import Path

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb")
CONFIG_SUFFIXES = (".yaml", ".yml")

_REMEDIES = {
    errno.EACCES: "choose another place, or change who may write there",
    errno.ENOSPC: "make room, and give the same command again",
    errno.EROFS: "choose another place",
    errno.EISDIR: "give the name of a file",
}


def missing_file_message(path: Path, suffixes: Sequence[str], otherwise: str = "") -> str:
    """That a file is not there, and which one may have been meant.

    Args:
        path: that was given.
        suffixes: of files that could have been meant.
        otherwise: what to do where none is near.
    """
    if not path.parent.is_dir():
        return f"no such file: there is no folder {path.parent}"
    beside = [other.name for other in path.parent.iterdir() if other.suffix.lower() in suffixes]
    if near := difflib.get_close_matches(path.name, beside, n=1):
        return f"no such file; did you mean '{path.parent / near[0]}'?"
    return f"no such file in {path.parent.resolve()}{f'; {otherwise}' if otherwise else ''}"


def write_error_message(path: Path, error: OSError) -> str:
    """That a file cannot be written, why, and what to do."""
    if error.errno == errno.ENOENT and not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}; make it, or choose another place"
    remedy = _REMEDIES.get(error.errno or 0)
    return f"cannot be written: {error.strerror}" + (f"; {remedy}" if remedy else "")


_PACKAGE = Path(__file__).resolve().parent


def bundled_folder(folder: str) -> Path:
    """The bundled folder of that name (`configs` or `data`).

    A wheel carries both inside the package; a checkout, which an editable install points at, has them at its top level.
    """
    inside = _PACKAGE / folder
    return inside if inside.is_dir() else _PACKAGE.parent / folder
