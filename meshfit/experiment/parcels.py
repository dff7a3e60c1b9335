"""Trials on their way to workers that see none of this machine's files, and back."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from meshfit.errors import StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.snapshots import SNAPSHOTS, keep_snapshots, snapshots_in
from meshfit.experiment.store import CHECKPOINT, FAILURE, LOCK, PROGRESS, RESULT, RunDirectory, make_folder

Files = Mapping[str, bytes]
"""The content of files by name; those under `inputs/` are what a trial reads, the others lie in its folder."""

_INPUTS = "inputs/"


def parcel_for(trial: Trial, store: RunDirectory) -> Files:
    """What a worker needs to begin with a trial: its mesh files, and where an earlier attempt got to.

    Raises:
        StoreError: a file cannot be read.
    """
    files = {f"{_INPUTS}{role}/{Path(path).name}": _content(Path(path)) for role, path in trial.files.items()}
    for name in (CHECKPOINT, FAILURE):
        if (path := store.folder(trial) / name).is_file():
            files[name] = _content(path)
    snapshots = snapshots_in(store.folder(trial)).values()
    return files | {f"{SNAPSHOTS}/{path.name}": _content(path) for path in snapshots}


def open_parcel(trial: Trial, files: Files, store: RunDirectory, inputs: Path) -> Trial:
    """Lay a parcel's files out; the trial is returned with the places where its mesh files are now."""
    copies = {}
    for name, content in files.items():
        if name.startswith(_INPUTS):
            path = inputs / name.removeprefix(_INPUTS)
            copies[trial.files[path.parent.name]] = str(path)
        else:
            path = store.folder(trial) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return replace(trial, copies=tuple(copies.items()))


def parcel_of(trial: Trial, store: RunDirectory) -> Files:
    """The files of a trial that a worker has done with."""
    folder = store.folder(trial)
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in (LOCK, PROGRESS)]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def put_back(trial: Trial, files: Files, store: RunDirectory, *, force: bool = False) -> None:
    """Write what came back into the trial's folder, the result last.

    Args:
        trial: whose files.
        files: what came back.
        store: where its folder is.
        force: write over what is complete there, which else stays as it is.

    Raises:
        StoreError: it cannot be written.
    """
    with store.lock(trial):
        if store.is_complete(trial) and not force:
            return
        keep_snapshots(trial, store, ())
        if any(name.startswith(SNAPSHOTS) for name in files):
            make_folder(store.folder(trial) / SNAPSHOTS)
        for name in sorted(files, key=lambda name: (name == RESULT, name)):
            store.write(trial, name, files[name])
        if RESULT in files:
            store.remove(trial, CHECKPOINT, FAILURE)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
