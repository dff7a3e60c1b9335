"""Damaging content at random, and reading what comes of it."""

import re
import warnings

import numpy as np

from meshfit.errors import MeshError, MeshfitWarning
from meshfit.mesh.io.raw_points import RawPoints

# Pieces of messages of Python and its libraries, which say nothing to who has a damaged file.
OF_EXCEPTIONS = re.compile(
    r"invalid literal|could not|list index|unpack|buffer (is|size|too)|from buffer|object (of|is|has|at)|-like object|"
    r"Traceback|NoneType|codec|broadcast|argument|dtype|ndarray|out of bounds|not supported between|byte \d+ in|<class|"
    r"unexpected keyword|Error\b|None\b"
)
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_WORDS = [
    b"-1", b"0", b"9" * 9, b"9" * 25, b"4294967295", b"1e999", b"nan", b"-nan(ind)", b"1.#QNAN", b"0.5", b"1,5", b"x",
    b"\n", b"\r", b"\r\n", b" ", b"#", b"\\\n", b"/", b"", b"\xff" * 4, b"\0" * 4, b"\xef\xbb\xbf", b"1_0", b"\"", b"'",
]  # fmt: skip


def damaged(content, rng):
    """The content with a few changes of any kind; never empty."""
    for _ in range(rng.choice([1, 1, 2, 4])):
        content = _changed(content, rng) or b"\0"
    return content


def _changed(content, rng):
    at, length = rng.randrange(len(content)), rng.choice([1, 4, rng.randrange(1, 60)])
    other = rng.randrange(len(content))
    kind = rng.randrange(8)
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
    if kind == 2:  # a piece twice, or in another place
        return content[:at] + content[other : other + length] * rng.choice([1, 1, 3]) + content[at:]
    if kind == 3:
        return content[:at] + content[at + length :]
    if kind == 4:
        return content[:at] + rng.randbytes(length) + content[at + length :]
    if kind == 5:
        words = list(re.finditer(rb"\S+", content))
        start, end = rng.choice(words).span() if words else (at, at)
        return content[:start] + rng.choice(_WORDS) + content[end:]
    piece = rng.choice(_WORDS)
    return content[:at] + piece + content[at + len(piece) * (kind - 6) :]


def require_plain(message):
    """Check that a message is one line in words of our own."""
    assert "\n" not in message
    assert message.strip()
    assert not OF_EXCEPTIONS.search(_QUOTED.sub("", message)), message


def soup_or_refused(read, content):
    """Return the polygon soup or points of some bytes, or None where they are refused in words of our own.

    Any other exception passes, and any other warning than our own is an error.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("error")
        warnings.simplefilter("always", MeshfitWarning)
        try:
            found = read(content)
        except MeshError as error:
            found = None
            require_plain(str(error))
    for warning in caught:
        require_plain(str(warning.message))
    if isinstance(found, np.ndarray):
        assert found.shape == (len(found), 3)
    elif isinstance(found, RawPoints):
        assert found.verts.shape == (len(found.verts), 3)
        assert found.normals is None or found.normals.shape == found.verts.shape
    elif found is not None:
        assert found.verts.shape == (len(found.verts), 3)
        assert found.corners.shape == (found.sizes.sum(),)
        assert (found.corners.dtype, found.sizes.dtype) == (np.int64, np.int64)
        assert (found.sizes >= 3).all()
    return found


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
