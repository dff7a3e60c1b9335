"""Trials as rows of one flat table: every metric and every setting by its dotted name."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from meshfit.config.changed import defaults
from meshfit.experiment.failure_file import read_failure
from meshfit.experiment.folders import State
from meshfit.experiment.overview import ExperimentOverview, Standing
from meshfit.experiment.records import read_result, read_settings
from meshfit.experiment.store import Result
from meshfit.fitting.settings import METHODS
from meshfit.measuring.metrics import METRICS
from meshfit.report.gather import flat

Row = Mapping[str, bool | int | float | str | None]

HEAD = ("experiment", "target", "target_title", "scheme", "seed", "variant", "state", "identity", "folder")
FAILURE_HEAD = ("failure.kind", "failure.message")

# What follows metrics and settings, by the beginning of its name.
_AFTER = ("fit.", "seconds.", "peak_memory_mb", "warnings", "frame.", "versions.", "platform.", "inputs.")
_NOT_SHOWN = {*HEAD, "settings", "traceback", "log"}


def rows_of(experiments: Sequence[ExperimentOverview]) -> list[Row]:
    """A row for each trial that is complete or failed, in the order of their folders.

    Raises:
        StoreError: a file of one cannot be read.
        ConfigError: the settings of one are no settings.
    """
    ended = (State.COMPLETE, State.FAILED)
    return [
        _row(experiment, trial) for experiment in experiments for trial in experiment.trials if trial.state in ended
    ]


def columns_of(rows: Sequence[Row]) -> list[str]:
    """The columns that some rows have, in an order that does not hang on which rows these are."""
    found = dict.fromkeys(key for row in rows for key in row)
    settings = [key for key in _settings() if key in found]
    first = dict.fromkeys((*HEAD, *METRICS, *settings))
    rest = [key for key in found if key not in first and key not in FAILURE_HEAD]
    failure = [key for key in rest if key.startswith("failure.")]
    after = sorted((key for key in rest if key not in failure), key=_place)
    return [*first, *after, *FAILURE_HEAD, *failure]


def _row(experiment: ExperimentOverview, trial: Standing) -> Row:
    result = read_result(trial)
    settings = read_settings(trial, result)
    record = _failure_record(trial) if result is None else result
    head = {
        "experiment": record.get("experiment", experiment.name),
        "target": record.get("target", trial.target),
        "target_title": record.get("target_title", trial.planned.target_title if trial.planned else trial.target),
        "scheme": record.get("scheme", next(iter(settings.get("schemes", ())), trial.scheme)),
        "seed": record.get("seed", trial.seed),
        "variant": record.get("variant", trial.variant),
        "state": trial.state.value,
        "identity": record.get("identity", trial.identity),
        "folder": str(trial.path),
    }
    rest = {key: value for key, value in record.items() if key not in _NOT_SHOWN}
    facts = flat(rest if result is not None else {"failure": rest})
    return {key: _cell(value) for key, value in (head | facts | flat(settings)).items()}


def _failure_record(trial: Standing) -> Result:
    """What is known of a failure, even where its record is damaged."""
    failure = read_failure(trial)
    return failure.record | {"kind": failure.kind, "message": failure.message}


def _cell(value: Any) -> bool | int | float | str | None:  # noqa: ANN401  whatever JSON holds
    return value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)


def _settings() -> list[str]:
    """Every setting there is, of one engine or the other, in the order of a config."""
    found: dict[str, None] = {}
    for key, value in defaults().items():
        several = [model().model_dump(mode="json") for model in METHODS.values()] if key == "fit" else [value]
        for one in several:
            found |= dict.fromkeys(flat({key: one}))
    return list(found)


def _place(column: str) -> tuple[int, str]:
    """Those whose place is not known come last."""
    places = [place for place, start in enumerate(_AFTER) if column.startswith(start)]
    return (places[0], "") if places else (len(_AFTER), column)
