"""`plan.json`: which trials an experiment's latest run is made of, for those who want to know what is still to come."""

from collections.abc import Sequence
from typing import Any

from meshfit.experiment.journal import now
from meshfit.experiment.plan import Trial, target_label
from meshfit.experiment.store import PLAN, RunDirectory, make_folder, write_atomically, write_json
from meshfit.mesh.targets import target_title

_VERSION = 1


def write_plan(trials: Sequence[Trial], store: RunDirectory, workers: int) -> None:
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
        content = {"schema_version": _VERSION, "written": now(), "workers": workers, "trials": mine}
        make_folder(store.root / experiment)
        write_atomically(store.root / experiment / PLAN, write_json(content))


def _entry(trial: Trial) -> dict[str, Any]:
    return {
        "folder": trial.folder.relative_to(trial.experiment).as_posix(),
        "identity": trial.identity,
        "target": target_label(trial.target),
        "target_title": target_title(trial.target),
        "scheme": trial.scheme,
        "seed": trial.seed,
        "variant": trial.variant,
        "steps": trial.settings.fit.steps,
    }
