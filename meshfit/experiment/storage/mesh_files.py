"""Sizes and digests of the meshes of a trial in its result, by which damaged and foreign ones are found."""

import hashlib
import os
from pathlib import Path
from typing import Any

from meshfit.errors import MeshError

FILES = "files"
"""Key of a result with the size and the SHA-256 of each mesh in its folder, by name."""
_FITTED = "result.ply"
_BYTES, _SHA256 = "bytes", "sha256"


def file_record(content: bytes) -> dict[str, Any]:
    """Return the record of a file of some content."""
    return {_BYTES: len(content), _SHA256: hashlib.sha256(content).hexdigest()}


def fault_in_size(folder: Path, result: dict[str, Any]) -> str | None:
    """Return what is wrong with the size of the fitted mesh of a result; None if nothing is, or there is no such file.

    Only the size is looked up, since every run and every table does so for each trial.
    """
    expected = result.get(FILES, {}).get(_FITTED)
    if expected is None:
        return None
    try:
        size = (folder / _FITTED).stat().st_size
    except OSError as error:
        if not os.path.lexists(folder / _FITTED):  # removed to save space, say: the numbers are as they were
            return None
        return f"{_FITTED} cannot be read: {error.strerror}"
    return None if size == expected[_BYTES] else f"{_FITTED} has {size} bytes, expected {expected[_BYTES]}"


def check_mesh_file(path: Path, result: dict[str, Any]) -> None:
    """Refuse a mesh of a trial that is not the one that the trial wrote.

    Raises:
        MeshError: its content has changed.
    """
    expected = result.get(FILES, {}).get(path.name)
    if expected is None or not path.is_file():  # of an older version; reading it says what is wrong
        return
    if hashlib.sha256(path.read_bytes()).hexdigest() != expected[_SHA256]:
        remedy = f"delete {path.with_name('result.json')}, and the next `meshfit run` repeats the trial"
        raise MeshError(f"{path}: damaged: not the mesh that the trial wrote; {remedy}")
