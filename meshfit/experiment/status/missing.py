"""Planned trials without a result: each as a record like that of a result, which says why it has none."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.status.scan import ScannedExperiment, ScannedTrial
from meshfit.experiment.storage.failure import UNREADABLE, FailureKind, read_failure
from meshfit.experiment.storage.measurement import AGAIN
from meshfit.experiment.storage.result import read_settings
from meshfit.experiment.storage.run_directory import LOG, RESULT, Result, damage
from meshfit.experiment.trial_status import TrialStatus

_FAILURES: Mapping[str, str] = MappingProxyType(
    {
        FailureKind.DIVERGED: "diverged",
        FailureKind.OUT_OF_MEMORY: "out of memory",
        FailureKind.KILLED: "killed",
        FailureKind.TOOL: "tool failed",
        FailureKind.TIME_LIMIT: "timed out",
        FailureKind.MEMORY_LIMIT: "over the memory limit",
        FailureKind.INPUT: "input unusable",
        FailureKind.ERROR: "crashed",
        UNREADABLE: "failed",
    }
)
_STATUSES: Mapping[TrialStatus, str] = MappingProxyType(
    {
        TrialStatus.WAITING: "not run",
        TrialStatus.RUNNING: "running",
        TrialStatus.DAMAGED: "damaged",
        TrialStatus.INTERRUPTED: "interrupted",
    }
)


def missing_results(experiments: Sequence[ScannedExperiment], results: Sequence[Result]) -> list[Result]:
    """Return a record of each planned trial that is not complete, in the order of the plans.

    A record has the names and the settings of a result, and in place of its numbers `missing`: the `state` of the trial
    in a word or two, a `message`, and the path of its `log`. Without a plan, trials that have begun are the planned
    ones.

    Args:
        experiments: scanned experiments.
        results: complete ones; trials of older plans, which hold no settings, take those of their variant.
    """
    return [
        record
        for experiment in experiments
        for trial in experiment.trials
        if trial.status is not TrialStatus.COMPLETE and (trial.planned is not None or experiment.plan is None)
        for record in _record(experiment, trial, results)
    ]


def count_unfinished(experiments: Sequence[ScannedExperiment]) -> dict[str, int]:
    """Return how many trials have neither a result nor a failure, by their state in a word or two."""
    states = Counter(trial.status for experiment in experiments for trial in experiment.trials)
    return {text: states[status] for status, text in _STATUSES.items() if states[status]}


def _record(experiment: ScannedExperiment, trial: ScannedTrial, results: Sequence[Result]) -> Iterator[Result]:
    planned, origin = trial.planned, _origin(experiment, trial, results)
    if origin is None or trial.seed is None:
        return
    origin = _measured_as_the_others(origin, experiment, trial, results)
    (scheme,) = origin["settings"]["schemes"]
    yield {
        **origin,
        "identity": trial.identity,
        "experiment": experiment.name,
        "target": planned.target if planned else trial.target,
        "target_title": planned.target_title if planned else trial.target,
        "scheme": planned.scheme if planned else scheme,
        "seed": trial.seed,
        "variant": trial.variant,
        "folder": str(trial.path),
        "missing": _reason(trial) | {"log": str(log) if (log := trial.path / LOG).is_file() else ""},
    }


def _reason(trial: ScannedTrial) -> dict[str, str]:
    if trial.status is TrialStatus.FAILED:
        failure = read_failure(trial.path)
        return {"state": _FAILURES.get(failure.kind, "failed"), "message": failure.message}
    message = ""
    if trial.status is TrialStatus.DAMAGED:
        message = (damage(trial.path / RESULT) or "").removeprefix(f"{trial.path / RESULT}: ")
    return {"state": _STATUSES[trial.status], "message": message}


def _measured_as_the_others(
    origin: dict[str, Any], experiment: ScannedExperiment, trial: ScannedTrial, results: Sequence[Result]
) -> dict[str, Any]:
    """Return the origin with the settings of a later measurement, if all results of its variant have that one."""
    alike = [
        result
        for result in results
        if result["experiment"] == experiment.name and (result.get("variant") or "") == trial.variant
    ]
    before = origin["settings"].get("measure")
    measured = [result["settings"].get("measure") for result in alike]
    is_shared = all(settings == measured[0] for settings in measured)
    if not alike or not is_shared or any(result.get(AGAIN, {}).get("settings") != before for result in alike):
        return origin
    return {**origin, "settings": {**origin["settings"], "measure": measured[0]}}


def _origin(experiment: ScannedExperiment, trial: ScannedTrial, results: Sequence[Result]) -> dict[str, Any] | None:
    """Return the settings, inputs and schema version that the result of a trial would have; None if not known."""
    if trial.planned is not None and trial.planned.origin:
        return dict(trial.planned.origin)
    try:
        settings = read_settings(trial.path, None)
    except (StoreError, ConfigError):
        settings = {}
    alike = next(
        (
            result
            for result in results
            if result["experiment"] == experiment.name and (result.get("variant") or "") == trial.variant
        ),
        None,
    )
    if not settings and alike is not None:
        axes = {"targets": [trial.target], "schemes": [trial.scheme], "seeds": [trial.seed]}
        settings = alike["settings"] | axes
    if not (settings.get("targets") and settings.get("schemes")):
        return None
    inputs = {} if alike is None else {role: sha for role, sha in alike.get("inputs", {}).items() if role != "target"}
    version = RESULTS_VERSION if alike is None else alike["schema_version"]
    return {"schema_version": version, "settings": settings, "inputs": inputs}
