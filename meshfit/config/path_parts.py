"""Names that users choose as parts of paths in a run directory."""

import os
import re

from meshfit.errors import ConfigError
from meshfit.paths import quoted_path
from meshfit.printable import printable

TRIAL_FOLDER = re.compile(r"seed-(\d+)-([0-9a-f]{10})")
"""Name of the folder of a trial, with its seed and the first digits of its identity."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[1-9]|lpt[1-9])(\..*)?", re.IGNORECASE)
_LONGEST = 255
"""Bytes of the longest name that common file systems allow."""


def path_part(name: str, what: str, remedy: str = "choose another name") -> str:
    """Return a name that a user chose, if it can be one part of a path in a run directory.

    Args:
        name: the name.
        what: it names, for the message.
        remedy: what to do, for the message.

    Raises:
        ConfigError: it is empty, is or leads to another folder, has control characters, is too long, reserved on
            Windows, or has the form of the folder of a trial.
    """
    if not name or name in {os.curdir, os.pardir}:
        reason = "is no name of a folder"
    elif "/" in name or "\\" in name:
        reason = "has a separator of paths"
    elif printable(name) != name:
        reason = "has control characters"
    elif _RESERVED.fullmatch(name):
        reason = "is reserved on Windows"
    elif TRIAL_FOLDER.fullmatch(name):
        reason = "has the form seed-N-HASH, which is that of the folders of trials"
    elif len(os.fsencode(name)) > _LONGEST:
        reason = f"has {len(os.fsencode(name))} bytes, more than the {_LONGEST} of a file's name"
    else:
        return name
    raise ConfigError(f"{what} {quoted_path(name)} {reason}; {remedy}")
