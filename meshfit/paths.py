"""Bundled folders, known suffixes, and error messages for paths that cannot be read or written."""

import difflib
import errno
import os
import re
import shlex
import stat
from collections.abc import Collection
from pathlib import Path

WRITABLE_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
"""Suffixes of the mesh formats that are read and written."""
MESH_SUFFIXES = (*WRITABLE_SUFFIXES, ".3mf", ".dae", ".vtk", ".vtp", ".vtu")
"""Suffixes of the mesh formats that are read."""
COMPRESSION_SUFFIXES = (".gz", ".bz2", ".xz")
"""Suffixes that may follow that of a mesh format, as in `scan.ply.gz`."""
CONFIG_SUFFIXES = (".yaml", ".yml")
STREAM = "-"
"""The name of standard input as a mesh to read, and of standard output as a mesh to write."""
STDOUT_PATHS = (STREAM, "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
"""Paths that lead to standard output."""

_PACKAGE = Path(__file__).resolve().parent
_LONGEST_SHOWN = 400
_READ_REMEDIES = {
    errno.EACCES: "change its permissions, or read a copy of your own",
    errno.EPERM: "change its permissions, or read a copy of your own",
    errno.EIO: "copy or download it again",
}
_WRITE_REMEDIES = {
    errno.EACCES: "choose another place, or change the permissions",
    errno.ENOSPC: "free some space, and run the same command again",
    errno.EROFS: "choose another place",
    errno.EISDIR: "give the path of a file",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOTDIR: "choose another place",
}
_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def bundled_folder(name: str) -> Path:
    """Return the bundled folder `configs` or `data`.

    A wheel carries both inside the package; a checkout, which an editable install points at, has them at its top level.
    """
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


def compression_suffix(path: str | Path) -> str:
    """Return the suffix of compression in lower case: `.gz` of `Scan.PLY.GZ`; empty if there is none."""
    suffix = Path(path).suffix.lower()
    return suffix if suffix in COMPRESSION_SUFFIXES else ""


def format_suffix(path: str | Path) -> str:
    """Return the suffix in lower case, without one of compression: `.ply` of `Scan.PLY.GZ`; empty if there is none."""
    return uncompressed(path).suffix.lower()


def file_stem(path: str | Path) -> str:
    """Return the file's name without its suffix and one of compression: `scan` of `meshes/scan.ply.gz`."""
    return uncompressed(path).stem


def uncompressed(path: str | Path) -> Path:
    """Return a path without a suffix of compression: `scan.ply` for `scan.ply.gz`."""
    path = Path(path)
    return path.with_suffix("") if compression_suffix(path) else path


def path_text(path: str | Path) -> str:
    """Return a path on one line for a message: quoted if it has blanks at an end or characters that cannot be seen."""
    text = str(path)
    if len(text) > _LONGEST_SHOWN:
        text = f"{text[: _LONGEST_SHOWN // 2]}…{text[-_LONGEST_SHOWN // 2 :]}"
    return text if text and text.isprintable() and text == text.strip() else repr(text)


def quoted_path(path: str | Path) -> str:
    """Return a path in quotes, on one line, for a message."""
    text = path_text(path)
    return text if text != str(path) and text[0] in "'\"" else f"'{text}'"


def shell_path(path: str | Path) -> str:
    """Return a path for a command that a message shows, which can be pasted into bash and zsh."""
    text = str(path)
    # A leading dash would be an option; zsh expands a leading equals sign.
    return shlex.quote(f"./{text}" if text[:1] in ("-", "=") else text)


def is_regular_file(path: str | Path) -> bool:
    """Return whether a path leads to a regular file; False for any name that cannot be one."""
    mode = _mode(path)
    return mode is not None and stat.S_ISREG(mode)


def is_pipe(path: str | Path) -> bool:
    """Return whether a path leads to a pipe, named or anonymous, such as `/dev/stdin` or `/dev/fd/63`."""
    mode = _mode(path)
    return mode is not None and stat.S_ISFIFO(mode)


def is_folder(path: str | Path) -> bool:
    """Return whether a path leads to a folder; False for any name that cannot be one."""
    mode = _mode(path)
    return mode is not None and stat.S_ISDIR(mode)


def looks_like_path(text: str) -> bool:
    """Return whether a text has a suffix or a separator, so that it is meant as a path rather than a name."""
    return bool(Path(text).suffix) or len(Path(text).parts) > 1 or os.sep in text


def not_a_file_message(path: str | Path, suffixes: Collection[str], otherwise: str = "") -> str:
    """Return what is wrong with a path that is no regular file, and what to do.

    Args:
        path: of no regular file.
        suffixes: of the files to suggest.
        otherwise: what to do where no similar file exists.
    """
    if not str(path):
        return "the path is empty; give the path of a file"
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except ValueError:
        return "no file can have this name; rename it, or give another path"
    except OSError as error:
        return _stat_error_message(path, error, suffixes, otherwise)
    if stat.S_ISFIFO(mode):
        return "a pipe can be read only once; save its content to a file, and give that"
    kind = next((kind for is_kind, kind in _KINDS if is_kind(mode)), "something else")
    files = _files_in(path, suffixes) if stat.S_ISDIR(mode) else []
    return f"expected a file, got {kind}" + (
        f"; did you mean {quoted_path(path / files[0])}?" if len(files) == 1 else ""
    )


def read_error_message(error: OSError) -> str:
    """Return the message for a file that cannot be read: the reason, and the remedy."""
    return _with_remedy("cannot be read", error, _READ_REMEDIES)


def write_error_message(path: Path, error: OSError) -> str:
    """Return the message for a file that cannot be written: the reason, and the remedy."""
    if error.errno == errno.ENOENT and not is_folder(path.parent):
        home = _home_suggestion(path)
        remedy = home or "create it, or choose another place"
        return f"cannot be written: there is no folder {path_text(path.parent)}; {remedy}"
    if error.errno == errno.ENOENT and path.is_symlink():
        return f"cannot be written: a link to {quoted_path(_link_target(path))}, whose folder does not exist"
    return _with_remedy("cannot be written", error, _WRITE_REMEDIES)


def _with_remedy(fault: str, error: OSError, remedies: dict[int, str]) -> str:
    reason = os.strerror(error.errno) if error.errno else "the file system gives no reason"
    remedy = remedies.get(error.errno or 0)
    return f"{fault}: {reason}" + (f"; {remedy}" if remedy else "")


def _mode(path: str | Path) -> int | None:
    try:
        return Path(path).stat().st_mode
    except (OSError, ValueError):
        return None


def _stat_error_message(path: Path, error: OSError, suffixes: Collection[str], otherwise: str) -> str:
    if error.errno == errno.ENAMETOOLONG:
        return "the name is too long for the file system; rename the file, or give another path"
    if error.errno == errno.ELOOP:
        return "a link that leads back to itself; give the path of the file"
    if error.errno == errno.EACCES:
        return f"permission denied in folder {path_text(path.parent)}; change its permissions, or give another path"
    if error.errno not in (errno.ENOENT, errno.ENOTDIR):
        return read_error_message(error)
    if path.is_symlink():
        target = quoted_path(_link_target(path))
        return f"a link to {target}, which does not exist; restore that file, or give another path"
    return _missing_message(path, suffixes, otherwise)


def _missing_message(path: Path, suffixes: Collection[str], otherwise: str) -> str:
    if re.match(r"(https?|ftp|s3|gs):/", str(path), re.IGNORECASE):
        return "a web address; download the file, and give its path"
    if path.parent in (Path("/dev/fd"), Path("/proc/self/fd")):
        return "no such pipe is open"
    similar = next(filter(is_regular_file, _other_spellings(path)), None) or similar_file(path, suffixes)
    if similar is not None:
        return f"no such file; did you mean {quoted_path(similar)}?"
    if home := _home_suggestion(path):
        return f"no such file; {home}"
    return _missing_in_folder(path, otherwise)


def _missing_in_folder(path: Path, otherwise: str) -> str:
    if is_folder(path.parent):
        return f"no such file in {path_text(path.parent.resolve())}{f'; {otherwise}' if otherwise else ''}"
    file = next(filter(is_regular_file, path.parents), None)
    if file is not None:
        return f"no such file: {path_text(file)} is a file, not a folder"
    return f"no such file: there is no folder {path_text(path.parent)}"


def similar_file(path: Path, suffixes: Collection[str]) -> Path | None:
    """Return the file in a missing one's folder that differs in case or suffix only, or has the most similar name.

    Args:
        path: of the missing file.
        suffixes: that the other file may have.
    """
    names = {file.name.casefold(): file for file in _files_in(path.parent, suffixes) if file.name != path.name}
    same_stem = [name for name in names if file_stem(name) == file_stem(path.name.casefold())]
    similar = difflib.get_close_matches(path.name.casefold(), same_stem, n=1, cutoff=0)
    similar = similar or difflib.get_close_matches(path.name.casefold(), names, n=1)
    return names[similar[0]] if similar else None


def _files_in(folder: Path, suffixes: Collection[str]) -> list[Path]:
    try:
        paths = sorted(folder.iterdir())
    except OSError:
        return []
    return [path for path in paths if format_suffix(path) in suffixes and is_regular_file(path)]


def _other_spellings(path: Path) -> list[Path]:
    """Return what a path would be without stray blanks and quotes, and as a path of another kind."""
    text = str(path)
    without_scheme = re.sub(r"^file:/*", "/", text)
    spellings = [text.strip(), text.strip("\"' \t\r\n"), text.replace("\\", "/"), without_scheme]
    return [Path(spelling) for spelling in spellings if spelling and spelling != text]


def _home_suggestion(path: Path) -> str:
    if not str(path).startswith("~"):
        return ""
    expanded = os.path.expanduser(path)  # noqa: PTH111  leaves an unknown ~user as it is
    return f"'~' is not expanded here; give {quoted_path(expanded)}" if expanded != str(path) else ""


def _link_target(path: Path) -> Path:
    try:
        return path.readlink()
    except OSError:
        return path.resolve()
