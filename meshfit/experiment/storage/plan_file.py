"""`plan.json`: the trials of an experiment, as its latest run planned them when it started."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from meshfit.errors import StoreError
from meshfit.experiment.storage.run_directory import (
    PLAN,
    Result,
    RunDirectory,
    json_text,
    make_folder,
    now,
    read_json,
    write_atomically,
)

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

PLAN_FILE_VERSION = 1


@dataclass(frozen=True)
class PlannedTrial:
    """A planned trial; `folder` is relative to the folder of the experiment."""

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
    """The latest plan of an experiment; `workers` is the number of trials that run side by side."""

    written: str
    workers: int
    trials: tuple[PlannedTrial, ...]


def write_plan(trials: Sequence["Trial"], store: RunDirectory, workers: int) -> None:
    """Write the plan of each experiment among some trials, in place of the previous one.

    Args:
        trials: the trials, in the order in which they are to run.
        store: the run directory.
        workers: the number of trials that run side by side.

    Raises:
        StoreError: it cannot be written.
    """
    for experiment in dict.fromkeys(trial.experiment for trial in trials):
        entries = [_entry(trial) for trial in trials if trial.experiment == experiment]
        content = {"schema_version": PLAN_FILE_VERSION, "written": now(), "workers": workers, "trials": entries}
        make_folder(store.root / experiment)
        write_atomically(store.root / experiment / PLAN, json_text(content))


def read_plan(experiment: Path) -> PlanFile | None:
    """Read the plan in the folder of an experiment; None where there is none, as in runs of older versions.

    Raises:
        StoreError: it cannot be read, or is of another version.
    """
    path = experiment / PLAN
    if not path.is_file():
        return None
    try:
        content = read_json(path)
    except StoreError as error:
        reason = str(error).removeprefix(f"{path}: ").partition("; delete it")[0]
        raise StoreError(f"{path}: {reason}; the next `meshfit run` rewrites it") from None
    if (got := content.get("schema_version")) != PLAN_FILE_VERSION:
        expected = f"got schema_version {got}, expected {PLAN_FILE_VERSION}"
        raise StoreError(f"{path}: {expected}; the next `meshfit run` rewrites it")
    try:
        trials = tuple(map(_planned_trial, content["trials"]))
        return PlanFile(str(content["written"]), max(1, int(content["workers"])), trials)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise StoreError(f"{path}: not a plan: {reason}; the next `meshfit run` rewrites it") from None


def with_planned_names(results: Iterable[Result]) -> list[Result]:
    """Return results with the variant names of the latest plan, whatever the names were when the trials ran."""
    names: dict[Path, dict[str, str]] = {}
    renamed = []
    for result in results:
        folder = Path(result["folder"])
        experiment = folder.parents[2] if len(folder.parents) > 2 else folder
        if experiment not in names:
            names[experiment] = _variant_names(experiment)
        name = names[experiment].get(folder.relative_to(experiment).as_posix(), result.get("variant", ""))
        renamed.append(result | {"variant": name})
    return renamed


def _variant_names(experiment: Path) -> dict[str, str]:
    """The variant of each planned trial by its folder."""
    with suppress(StoreError):  # names are optional here; `meshfit status` reports a damaged plan
        if (plan := read_plan(experiment)) is not None:
            return {trial.folder.as_posix(): trial.variant for trial in plan.trials}
    return {}


def _entry(trial: "Trial") -> dict[str, Any]:
    return {
        "folder": trial.folder.relative_to(trial.experiment).as_posix(),
        "identity": trial.identity,
        **trial.names,
        "steps": trial.settings.fit.steps,
    }


def _planned_trial(entry: Mapping[str, Any]) -> PlannedTrial:
    folder = PurePath(entry["folder"])
    if folder.is_absolute() or ".." in folder.parts or not folder.parts:
        raise ValueError(f"the folder {str(folder)!r} is not inside the experiment's")
    return PlannedTrial(
        folder=Path(folder),
        identity=str(entry["identity"]),
        target=str(entry["target"]),
        target_title=str(entry["target_title"]),
        scheme=str(entry["scheme"]),
        seed=int(entry["seed"]),
        variant=str(entry["variant"]),
        steps=int(entry["steps"]),
    )
