"""Errors and warnings of meshfit. Each message is one line: the place, the finding and the remedy."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class MeshfitError(Exception):
    """An expected failure, whose message is one line for the user; or several, with one line each.

    Args:
        faults: a line for each failure.

    Example:
        >>> import meshfit
        >>> try:
        ...     meshfit.subdivide("cube", "lop")
        ... except meshfit.MeshfitError as error:
        ...     print(type(error).__name__)
        SchemeError
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, *faults: str) -> None:
        super().__init__(*faults)

    @property
    def faults(self) -> tuple[str, ...]:
        """The lines."""
        return tuple(map(str, self.args))

    def __str__(self) -> str:
        """Return the message, of a line for each failure."""
        return "\n".join(self.faults)


@contextmanager
def error_prefix(place: str) -> Iterator[None]:
    """Prefix errors that are raised within the block with the option or key at fault."""
    try:
        yield
    except MeshfitError as error:
        raise type(error)(f"{place}: {error}") from None


class Faults:
    """Errors of several inputs, which are raised together once all have been read."""

    def __init__(self) -> None:
        self._errors: list[tuple[str, MeshfitError]] = []

    @contextmanager
    def collected(self, prefix: str = "") -> Iterator[None]:
        """Hold an error that is raised within the block; the prefix names its input where there are others."""
        try:
            yield
        except MeshfitError as error:
            self._errors.append((prefix, error))

    def __bool__(self) -> bool:
        """Whether an error is held."""
        return bool(self._errors)

    def raise_any(self) -> None:
        """Raise what has been held: a single error as it is, several as one with the lines of all.

        Raises:
            MeshfitError: there was an error.
        """
        if len(self._errors) == 1:
            raise self._errors[0][1]
        if self._errors:
            lines = dict.fromkeys(f"{prefix}{fault}" for prefix, error in self._errors for fault in error.faults)
            of_meshes = all(isinstance(error, MeshError) for _, error in self._errors)
            raise (MeshError if of_meshes else ConfigError)(*lines) from None


class ConfigError(MeshfitError):
    """An invalid config, override or command-line option."""


class MeshError(MeshfitError):
    """An unusable mesh or mesh file."""


class NoFacesError(MeshError):
    """A file or mesh of points alone where a surface is expected."""


class FormatError(MeshError):
    """A mesh file whose format is not known, or not the one that its name or the caller gives.

    Attributes:
        remedy: what to do, which is the end of the message; empty if there is only one way, to give the format.
        file_format: the format to give, such as `ply`, `obj|ply` or `FORMAT`; None where giving one is of no use.
    """

    def __init__(self, finding: str, remedy: str = "", file_format: str | None = None) -> None:
        super().__init__(f"{finding}; {remedy}" if remedy else finding)
        self.remedy = remedy
        self.file_format = file_format


class DomainError(MeshError):
    """A file of curves where a surface is expected, or without curves where they are."""


class ViewError(MeshError):
    """Images or cameras that cannot be a target."""


class SchemeError(MeshfitError):
    """An unknown subdivision scheme, or a parameter that it does not take."""


class DeviceError(MeshfitError):
    """A device or dtype that this machine or this build of torch does not support."""


class StoreError(MeshfitError):
    """A run directory, or a file in it, that cannot be read or written."""


class MeasureError(MeshfitError):
    """A measurement whose values would be wrong."""


class ClusterError(MeshfitError):
    """An unreachable cluster, or workers that cannot run trials."""


class TrialError(MeshfitError):
    """A trial that failed while it ran."""

    exit_code: ClassVar[int] = 1


class MeshfitWarning(UserWarning):
    """A fault in the input that meshfit repaired, or that the user should know of.

    Example:
        >>> import warnings, meshfit
        >>> warnings.simplefilter("error", meshfit.MeshfitWarning)  # refuse to go on with such an input
    """
