"""Copies in the run directory that stand in for targets whose files are missing."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from meshfit.config.path_parts import PLAN, TARGETS
from meshfit.errors import StoreError
from meshfit.experiment.input_checks import CopyFinder, TargetCopy
from meshfit.experiment.storage.plan_file import read_plan
from meshfit.experiment.storage.run_directory import RESULT, read_result
from meshfit.experiment.storage.targets import carried_name, is_missing
from meshfit.images.folders import PACK_SUFFIX
from meshfit.mesh.cleaning_options import CleaningOptions


def copies_in(runs: Path) -> CopyFinder:
    """Return a function that finds the copy in a run directory of a target whose file is missing."""
    root = Path(os.path.abspath(runs))  # noqa: PTH100  workers may have another current folder
    return lambda experiment, *target: find_copy(root / experiment, *target)


def find_copy(experiment: Path, target: str, label: str, cleaning: CleaningOptions) -> TargetCopy | None:
    """Find the copy of a target whose file is missing, by the latest plan of an experiment, or else by its results.

    Those of other experiments in the run directory are looked at after its own.

    Args:
        experiment: the folder of the experiment in its run directory.
        target: the target, as the config names it.
        label: its short name in the experiment.
        cleaning: options for cleaning its file.

    Returns:
        The copy; None if the file is there, or if there is no copy of it.
    """
    if not is_missing(target):
        return None
    others = [path.parent for path in sorted(experiment.parent.glob(f"*/{PLAN}")) if path.parent != experiment]
    for name, sha256 in (each for place in (experiment, *others) for each in _recorded(place, label)):
        packed = experiment.parent / TARGETS / f"{sha256}{PACK_SUFFIX}"
        copy = packed if packed.is_file() else packed.with_name(carried_name(sha256, cleaning))
        if copy.is_file() and (Path(name).name == packed.name or _is_same(name, target)):
            return TargetCopy(str(copy) if copy is packed else name, copy, sha256)
    return None


def _is_same(name: str, target: str) -> bool:
    """Whether a recorded name is that of a target; a relative path where there is no file may be of any folder."""
    parts = Path(target).parts
    return name == target or (bool(parts) and Path(name).parts[-len(parts) :] == parts)


def _recorded(experiment: Path, label: str) -> Iterator[tuple[str, str]]:
    """Yield the targets of a label that an experiment has had, and the SHA-256 of each."""
    yield from _planned(experiment, label)
    yield from _complete(experiment, label)


def _planned(experiment: Path, label: str) -> Iterator[tuple[str, str]]:
    """Yield the targets of a label in the latest plan, and the SHA-256 of each."""
    with suppress(StoreError):  # damaged
        plan = read_plan(experiment)
        for trial in plan.trials if plan else ():
            if trial.target == label and trial.origin and "target" in trial.origin["inputs"]:
                yield trial.origin["settings"]["targets"][0], trial.origin["inputs"]["target"]


def _complete(experiment: Path, label: str) -> Iterator[tuple[str, str]]:
    """Yield the targets of a label in complete trials, the latest first, and the SHA-256 of each."""
    found = []
    for path in (experiment / label).glob(f"*/*/{RESULT}"):
        with suppress(StoreError):  # damaged
            result = read_result(path.parent)
            if result is not None and isinstance(sha256 := result.get("inputs", {}).get("target"), str):
                found.append((str(result.get("finished", "")), result["settings"]["targets"][0], sha256))
    yield from ((name, sha256) for _, name, sha256 in sorted(found, reverse=True))
