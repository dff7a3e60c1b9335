"""What a run set out to do: the `plan.json` of an experiment, which its latest run wrote when it started."""

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
    make_folder,
    now,
    read_json,
    write_atomically,
    write_json,
)

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial


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


def write_plan(trials: Sequence["Trial"], store: RunDirectory, workers: int) -> None:
    """Write the plan of each experiment among some trials, in place of the one before.

    Args:
        trials: in the order in which they are to run.
        store: where they go.
        workers: how many run side by side.

    Raises:
        StoreError: it cannot be written.
    """
    for experiment in dict.fromkeys(trial.experiment for trial in trials):
        mine = [_entry(trial) for trial in trials if trial.experiment == experiment]
        content = {"schema_version": SCHEMA_VERSION, "written": now(), "workers": workers, "trials": mine}
        make_folder(store.root / experiment)
        write_atomically(store.root / experiment / PLAN, write_json(content))


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


def with_planned_names(results: Iterable[Result]) -> list[Result]:
    """Results with the names that the latest plan has for their points of a sweep, whatever they were when they ran."""
    names: dict[Path, dict[str, str]] = {}
    found = []
    for result in results:
        folder = Path(result["folder"])
        experiment = folder.parents[2] if len(folder.parents) > 2 else folder
        if experiment not in names:
            names[experiment] = _names_in(experiment)
        name = names[experiment].get(folder.relative_to(experiment).as_posix(), result.get("variant", ""))
        found.append(result | {"variant": name})
    return found


def _names_in(experiment: Path) -> dict[str, str]:
    with suppress(StoreError):  # names are a nicety; `meshfit status` says what is wrong with a plan
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
