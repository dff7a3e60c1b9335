"""meshfit: fit a subdivided source mesh to a target, measure it, and make the table.

The public names are listed in `__init__.pyi` and loaded on first use, so that `import meshfit` is instant.
"""

from importlib.metadata import version

import lazy_loader

_load_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    return version("meshfit") if name == "__version__" else _load_name(name)
