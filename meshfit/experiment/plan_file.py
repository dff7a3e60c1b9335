"""What a run set out to do: the `plan.json` of an experiment, which its latest run wrote when it started."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from meshfit.errors import StoreError
from meshfit.experiment.store import PLAN, read_json

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class PlannedTrial:
    """A trial that was set out to be run; `folder` is relative to the folder of the experiment."""

    folder: Path
    identity: str
    target: str
    target_title: str
    scheme: str
    seed: int
    variant: str
    steps: int


@dataclass(frozen=True)
class PlanFile:
    """The latest plan of an experiment; `workers` is how many trials are run at once."""

    written: str
    workers: int
    trials: tuple[PlannedTrial, ...]


def read_plan(experiment: Path) -> PlanFile | None:
    """The plan in an experiment's folder; None where there is none, as in runs made before plans were written.

    Raises:
        StoreError: it cannot be read, or is of another version.
    """
    path = experiment / PLAN
    if not path.is_file():
        return None
    try:
        found = read_json(path)
    except StoreError as error:
        reason = str(error).removeprefix(f"{path}: ").partition("; delete it")[0]
        raise StoreError(f"{path}: {reason}; the next `meshfit run` writes it anew") from None
    if found.get("schema_version") != SCHEMA_VERSION:
        version = found.get("schema_version")
        raise StoreError(f"{path}: found schema_version {version}, this meshfit reads {SCHEMA_VERSION}")
    try:
        trials = tuple(map(_trial, found["trials"]))
        return PlanFile(str(found["written"]), max(1, int(found["workers"])), trials)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StoreError(f"{path}: not a plan: {_reason(error)}; the next `meshfit run` writes it anew") from None


def _trial(found: Mapping[str, Any]) -> PlannedTrial:
    folder = PurePath(found["folder"])
    if folder.is_absolute() or ".." in folder.parts or not folder.parts:
        raise ValueError(f"the folder {str(folder)!r} is not one below it")
    return PlannedTrial(
        folder=Path(folder),
        identity=str(found["identity"]),
        target=str(found["target"]),
        target_title=str(found["target_title"]),
        scheme=str(found["scheme"]),
        seed=int(found["seed"]),
        variant=str(found["variant"]),
        steps=int(found["steps"]),
    )


def _reason(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else str(error)
