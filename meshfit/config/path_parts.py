"""Names that users choose as parts of paths in a run directory."""

import os
import re
import unicodedata
from collections.abc import Iterable, Mapping

from meshfit.errors import ConfigError
from meshfit.paths import quoted_path
from meshfit.printable import require_printable

TRIAL_FOLDER = re.compile(r"seed-(\d+)-([0-9a-f]{10})")
"""Name of the folder of a trial, with its seed and the first digits of its identity."""
TARGETS = "targets"
"""Folder of the run directory with the targets of its trials."""
PLAN = "plan.json"
"""File in the folder of an experiment with its plan."""

OWN_IN_RUNS = re.compile(TARGETS)
"""Names in a run directory that no experiment can have."""
OWN_IN_EXPERIMENT = re.compile(rf"{re.escape(PLAN)}|search-.*\.json")
"""Names in the folder of an experiment that no target can have."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[1-9]|lpt[1-9])(\..*)?", re.IGNORECASE)
_LONGEST = 255
"""Bytes of the longest name that common file systems allow."""


def path_part(name: str, what: str, remedy: str = "choose another name", own: re.Pattern[str] | None = None) -> str:
    """Return a name that a user chose, if it can be one part of a path in a run directory.

    Args:
        name: the name.
        what: it names, for the message.
        remedy: what to do, for the message.
        own: names that the run directory uses there itself.

    Raises:
        ConfigError: it is empty, is or leads to another folder, has control characters, is too long, reserved on
            Windows or by the run directory, or has the form of the folder of a trial.
    """
    require_printable(name, what, remedy)
    if not name or name in {os.curdir, os.pardir}:
        reason = "is no name of a folder"
    elif "/" in name or "\\" in name:
        reason = "has a separator of paths"
    elif _RESERVED.fullmatch(name):
        reason = "is reserved on Windows"
    elif TRIAL_FOLDER.fullmatch(folder_key(name)):
        reason = "has the form seed-N-HASH, which is that of the folders of trials"
    elif own is not None and own.fullmatch(folder_key(name)):
        reason = "is a name that the run directory uses itself"
    elif len(os.fsencode(name)) > _LONGEST:
        reason = f"has {len(os.fsencode(name))} bytes, more than the {_LONGEST} of a file's name"
    else:
        return name
    raise ConfigError(f"{what} {quoted_path(name)} {reason}; {remedy}")


def folder_key(name: str) -> str:
    """Return a key that two names share if they lead to the same folder on macOS or Windows.

    These do not tell upper from lower case, nor an accented letter from a letter with an accent; Windows drops dots and
    blanks at the end.
    """
    composed = normal_form(normal_form(name).casefold())
    return composed.rstrip(". ") or composed


def normal_form(name: str) -> str:
    """Return a name with accented letters as one character each, where Unicode has one."""
    return unicodedata.normalize("NFC", name)


def require_distinct(folders: Mapping[str, str], kind: str, remedy: str) -> None:
    """Refuse names whose folders would be the same one on some file system.

    Args:
        folders: name of the folder of each, such as the label of each target.
        kind: what they are, in the plural.
        remedy: what to do, for the message.

    Raises:
        ConfigError: two have the same folder.
    """
    taken: dict[str, str] = {}
    for name, folder in folders.items():
        other = taken.setdefault(folder_key(folder), name)
        if other != name:
            raise ConfigError(
                f"{kind} {quoted_path(other)} and {quoted_path(name)}: {same_folder(folders[other], folder)}; {remedy}"
            )


def same_folder(first: str, second: str) -> str:
    """Return what is wrong with two names of one `folder_key`."""
    if first == second:
        return f"both would have the folder {quoted_path(first)}"
    how = "differ only in case, accents or dots at the end"
    return f"their folders {quoted_path(first)} and {quoted_path(second)} {how}, and are the same on macOS or Windows"


def similar_folder(name: str, names: Iterable[str]) -> str | None:
    """Return another of some names that shares a folder with a name on some file system; None if there is none."""
    key = folder_key(name)
    return next((other for other in names if other != name and folder_key(other) == key), None)
