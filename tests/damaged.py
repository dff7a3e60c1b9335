"""Reading damaged files."""

import warnings

from meshfit.errors import MeshError, MeshfitWarning


def read_or_refused(read, path):
    """What is read, or None where that is refused in one line; any other warning than our own is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshfitWarning)
        try:
            return read(path)
        except MeshError as error:
            message = str(error)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return None
