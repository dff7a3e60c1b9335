"""Import of the libraries of the extra `report`, which only pictures and pages use."""

import importlib
from typing import Any

from meshfit.errors import ConfigError

_PACKAGES = {"PIL": "pillow", "vtkmodules": "pyvista", "imageio_ffmpeg": "imageio-ffmpeg"}


def import_optional(module: str) -> Any:  # noqa: ANN401  an optional library
    """Import a module of an optional library.

    Raises:
        ConfigError: the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        library = _PACKAGES.get(name, name)
        raise ConfigError(f"pictures need {library}, which is not installed: pip install 'meshfit[report]'") from None
