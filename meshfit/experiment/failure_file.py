"""Failed trials: what their `failure.json` says of them."""

from dataclasses import dataclass
from pathlib import Path

from meshfit.errors import StoreError
from meshfit.experiment.folders import State
from meshfit.experiment.overview import ExperimentOverview, Standing
from meshfit.experiment.store import FAILURE, LOG, Result, read_json

UNREADABLE = "unreadable"


@dataclass(frozen=True)
class Failure:
    """Why a trial failed.

    Attributes:
        trial: which one.
        kind: what went wrong, in one word; `unreadable` where the record itself is damaged.
        message: in one line.
        step: at which step, if it was at one.
        where: the file to look into: the trial's log, or the record where there is no log.
        record: all that the record says.
    """

    trial: Standing
    kind: str
    message: str
    step: int | None
    where: Path
    record: Result


def read_failure(trial: Standing) -> Failure:
    """Why a trial failed; a record that cannot be read is told as such."""
    path = trial.path / FAILURE
    try:
        record = read_json(path)
    except StoreError as error:
        return Failure(trial, UNREADABLE, str(error), None, path, {})
    step = record.get("step")
    return Failure(
        trial,
        str(record.get("kind", "error")),
        " ".join(str(record.get("message", "")).split()),
        step if isinstance(step, int) else None,
        trial.path / LOG if LOG in trial.folder.files else path,
        record,
    )


def failures_by_kind(experiment: ExperimentOverview) -> dict[str, list[Failure]]:
    """The failed trials of an experiment by kind, the most frequent kind first."""
    kinds: dict[str, list[Failure]] = {}
    for trial in experiment.of(State.FAILED):
        found = read_failure(trial)
        kinds.setdefault(found.kind, []).append(found)
    return dict(sorted(kinds.items(), key=lambda kind: -len(kind[1])))
