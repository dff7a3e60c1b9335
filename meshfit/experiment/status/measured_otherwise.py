"""Trials that are complete with other settings of the measurement, which need no other fit to be measured again."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from meshfit.errors import StoreError
from meshfit.experiment.plan import Trial
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.storage.copying import find_complete
from meshfit.experiment.storage.run_directory import Result, RunDirectory, read_result


class MeasuredOtherwise(NamedTuple):
    """Trials of an experiment whose fits are complete, and the settings of the measurement that have changed.

    Attributes:
        experiment: name of the experiment.
        changes: the key of each setting under `measure`, with its value in the results and in the trials.
        trials: their number.
    """

    experiment: str
    changes: tuple[tuple[str, object, object], ...]
    trials: int


def find_measured_otherwise(trials: Sequence[Trial], store: RunDirectory) -> list[MeasuredOtherwise]:
    """Find trials without a result whose fit is complete: other results differ from them in `measure` alone."""
    folders_of = cache(_by_seed)
    counts: dict[tuple[str, tuple[tuple[str, object, object], ...]], int] = {}
    for trial, complete in zip(trials, find_complete(trials, store), strict=True):
        if trial.fault or complete is not None:
            continue
        folders = folders_of(store.folder(trial).parent).get(f"seed-{trial.seed}")
        if not folders:
            continue
        measure = trial.plain_settings["measure"]
        for result in _same_fits(trial, folders):
            before = result["settings"]["measure"]
            changes = tuple((key, before.get(key), measure[key]) for key in measure if before.get(key) != measure[key])
            key = trial.experiment, changes
            counts[key] = counts.get(key, 0) + 1
            break
    return [MeasuredOtherwise(*key, count) for key, count in counts.items()]


def _by_seed(parent: Path) -> dict[str, list[Path]]:
    """Return the trial folders in one of target and scheme, by their names up to the hash."""
    folders: dict[str, list[Path]] = {}
    with suppress(OSError):
        for folder in parent.iterdir():
            folders.setdefault(folder.name.rpartition("-")[0], []).append(folder)
    return folders


def _same_fits(trial: Trial, folders: Iterable[Path]) -> Iterator[Result]:
    """Yield the results of a trial's fit with other settings of the measurement, the latest first."""
    found = list[Result]()
    for folder in folders:
        try:
            result = read_result(folder)
        except StoreError:  # damaged
            continue
        if result is not None and _facts(result["settings"], result) == _facts(trial.plain_settings, _record(trial)):
            found.append(result)
    yield from sorted(found, key=lambda result: str(result.get("finished", "")), reverse=True)


def _record(trial: Trial) -> Result:
    return {"inputs": dict(trial.inputs), "schema_version": RESULTS_VERSION}


def _facts(settings: Result, record: Result) -> tuple[object, ...]:
    """Return what the fit of a trial depends on."""
    plain = {key: value for key, value in settings.items() if key != "measure"}
    return plain, record.get("inputs"), record["schema_version"], isinstance(settings.get("measure"), dict)
