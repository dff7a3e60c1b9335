"""meshfit: fit a subdivided source mesh to a target, measure it, and make the table.

The public names are listed in `__init__.pyi` and loaded on first use, so that `import meshfit` is instant.
"""

import lazy_loader

_load_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _load_name(name)
    from importlib.metadata import version  # takes longer than all the rest

    return version("meshfit")
