"""The `meshfit fit` command that a message shows to one who has typed something else."""

import os
from collections.abc import Sequence
from pathlib import Path

from meshfit.paths import MESH_SUFFIXES, bundled_folder, file_stem, format_suffix, is_regular_file, shell_path


def is_mesh_name(name: str) -> bool:
    """Whether a word is the path of a mesh file that exists."""
    return format_suffix(name) in MESH_SUFFIXES and is_regular_file(name)


def is_config_name(word: str) -> bool:
    """Whether a word is the path of a config that exists, or the name of a bundled one."""
    if word.endswith((".yaml", ".yml")):
        return is_regular_file(word)
    is_name = Path(word).name == word and not os.path.lexists(word)
    return is_name and (bundled_folder("configs") / f"{word}.yaml").is_file()


def fit_command(words: Sequence[str]) -> str:
    """Return a command that can be pasted into a shell, for the meshes among some words, or else the bunny."""
    meshes = [word for word in words if is_mesh_name(word)]
    if len(meshes) > 1:
        return f"meshfit fit {' '.join(map(shell_path, meshes))} -o fitted/"
    (mesh,) = meshes or ["bunny"]
    return f"meshfit fit {shell_path(mesh)} -o {shell_path(f'{file_stem(mesh)}-fitted.ply')}"
