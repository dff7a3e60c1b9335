"""What the extra `report` brings: libraries that only pictures need."""

import importlib
from typing import Any

from meshfit.errors import ConfigError


def needed(module: str) -> Any:  # noqa: ANN401  an optional library
    """A module of an optional library.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        library = {"PIL": "pillow", "vtkmodules": "pyvista"}.get(module.partition(".")[0], module.partition(".")[0])
        raise ConfigError(f"pictures need {library}, which is not installed: pip install 'meshfit[report]'") from None
