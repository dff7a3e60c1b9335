"""The errors and warnings that meshfit raises: each says what was found, where, and what is allowed."""

from typing import ClassVar


class MeshfitError(Exception):
    """Any failure that meshfit foresees; its text is one line, fit to be shown to a person."""

    exit_code: ClassVar[int] = 2


class ConfigError(MeshfitError):
    """A config, an override or a command-line choice that is not allowed."""


class MeshError(MeshfitError):
    """A mesh, or a file that should hold one, that cannot be used."""


class DomainError(MeshError):
    """A file of something else: without faces where a surface is needed, or without segments where curves are."""


class SchemeError(MeshfitError):
    """A subdivision scheme that does not exist, or a parameter that it does not take."""


class DeviceError(MeshfitError):
    """A device or dtype that this machine or this build of torch does not offer."""


class StoreError(MeshfitError):
    """A run directory, or a file in it, that cannot be read or written."""


class MeasureError(MeshfitError):
    """A measurement whose figures would not be what they claim to be."""


class ClusterError(MeshfitError):
    """A cluster that cannot be reached, or whose workers cannot run trials."""


class TrialError(MeshfitError):
    """A trial that failed while it ran."""

    exit_code: ClassVar[int] = 1


class MeshfitWarning(UserWarning):
    """Something in the input that meshfit mended or that its user should know of."""
