"""Where the bundled configs and data lie: inside the installed package, or beside it in a checkout."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def bundled(folder: str) -> Path:
    """The bundled folder of that name (`configs` or `data`).

    A wheel carries both inside the package; a checkout, which an editable install points at, has them at its top level.
    """
    inside = _PACKAGE / folder
    return inside if inside.is_dir() else _PACKAGE.parent / folder
