"""Checks of the folders of trials before they run: inside the run directory, and not those of other names."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from meshfit.config.path_parts import normal_form, same_folder, similar_folder
from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import RunDirectory
from meshfit.paths import path_text

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial


def check_folders(trials: Iterable["Trial"], store: RunDirectory) -> None:
    """Refuse trials whose folders lie outside the run directory, or would be those of other names on some systems.

    Raises:
        StoreError: a folder of an experiment, target or scheme leads out of the run directory, or differs from one that
            exists only in case or in the form of accents.
    """
    root = store.root.resolve()
    listed = cache(_names)
    for folder in dict.fromkeys(store.folder(trial).parent for trial in trials):
        resolved = folder.resolve()
        if root not in resolved.parents:
            remedy = "remove the link, or give the directory it leads to as --runs"
            raise StoreError(f"{path_text(folder)}: outside the run directory, in {path_text(resolved)}; {remedy}")
        place = store.root
        for part in folder.relative_to(store.root).parts:
            names = listed(place)
            other = None if part in names else similar_folder(part, names)
            if other is not None and not (normal_form(other) == normal_form(part) and (place / part).exists()):
                raise StoreError(
                    f"{path_text(place / other)} and {path_text(place / part)}: {same_folder(other, part)}; "
                    "give another name, or another run directory"
                )
            place /= part


def _names(folder: Path) -> frozenset[str]:
    """The names in a folder as the file system has them; HFS+ writes accents as characters of their own."""
    try:
        return frozenset(path.name for path in folder.iterdir() if path.is_dir())
    except OSError:
        return frozenset()
