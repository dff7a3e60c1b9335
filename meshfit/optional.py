"""Import of optional libraries: those of the extra `report`, which only pictures and pages use, and pandas."""

import importlib
from typing import Any

from meshfit.errors import ConfigError

_PACKAGES = {"PIL": "pillow", "vtkmodules": "pyvista", "imageio_ffmpeg": "imageio-ffmpeg"}


def import_optional(module: str, purpose: str = "pictures need", install: str = "'meshfit[report]'") -> Any:  # noqa: ANN401
    """Import a module of an optional library.

    Args:
        module: its name.
        purpose: what needs it, as the start of the message.
        install: what to install with pip.

    Raises:
        ConfigError: the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        library = _PACKAGES.get(name, name)
        raise ConfigError(f"{purpose} {library}, which is not installed: pip install {install}") from None


def import_pandas() -> Any:  # noqa: ANN401  an optional library
    """Import pandas.

    Raises:
        ConfigError: it is not installed.
    """
    return import_optional("pandas", "to_pandas() needs", "pandas")
