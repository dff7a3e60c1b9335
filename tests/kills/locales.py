"""Locales that are really installed, or that this machine can compile."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

WANTED = ("C", "C.UTF-8", "tr_TR.UTF-8", "de_DE.ISO-8859-1")
"""Turkish has other capitals of i; the last one writes decimal commas, and cannot encode every character."""


def locales(folder: Path) -> list[str]:
    """Return the names of the wanted locales that processes can be started in; set LOCPATH to find compiled ones."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in WANTED[2:]:
        language, _, encoding = name.partition(".")
        if not (folder / name).exists():
            command = ["localedef", "-i", language, "-f", encoding, str(folder / name)]
            with suppress(FileNotFoundError):
                subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    return [name for name in WANTED if _is_installed(name, folder)]


def _is_installed(name: str, folder: Path) -> bool:
    if name.startswith("C"):
        return True
    check = "import locale; locale.setlocale(locale.LC_ALL, '')"
    return not subprocess.run(
        [sys.executable, "-c", check],
        stderr=subprocess.DEVNULL,
        env={**os.environ, "LC_ALL": name, "LOCPATH": str(folder)},
        check=False,
    ).returncode
