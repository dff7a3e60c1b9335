"""From what a person types to the one trial that is meant: its folder, a file in it, or how its identity begins."""

import os
import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from meshfit.errors import ConfigError
from meshfit.experiment.overview import ExperimentOverview, Standing, overview

FEWEST_DIGITS = 4
_MOST_LISTED = 5
_IDENTITY = re.compile(rf"[0-9a-f]{{{FEWEST_DIGITS},64}}")


def find_trial(text: str, runs: Path, now: datetime) -> tuple[ExperimentOverview, Standing]:
    """The trial that is meant, and the experiment that it is part of.

    Args:
        text: a trial's folder, a file in it, or at least the first four digits of its identity.
        runs: where to look for an identity.
        now: the time, by which it is told what runs.

    Raises:
        ConfigError: no trial is meant by it, or several are.
        StoreError: there is no run directory to look in.
    """
    path = Path(text)
    if path.exists():
        return _in_folder(path if path.is_dir() else path.parent, now)
    every = list(_trials(overview([runs], now)))
    digits = text.lower()
    if _IDENTITY.fullmatch(digits):
        found = [one for one in every if _begins(one[1].identity, digits)]
    else:
        found = [one for one in every if os.path.abspath(one[1].path) == os.path.abspath(path)]  # noqa: PTH100
    if len(found) == 1:
        return found[0]
    if found:
        raise ConfigError(f"{len(found)} trials under {runs} begin with {text}: {_listed(found)}")
    needed = f"a trial's folder, a file in it, or {FEWEST_DIGITS} or more digits of its identity are needed"
    raise ConfigError(f"no trial under {runs} is '{text}'; {needed}; there are: {_listed(every)}")


def _in_folder(folder: Path, now: datetime) -> tuple[ExperimentOverview, Standing]:
    found = list(_trials(overview([folder], now)))
    exact = [one for one in found if one[1].path == folder]
    if len(exact) == 1:
        return exact[0]
    raise ConfigError(f"{folder}: not the folder of a trial, but one above it; there are: {_listed(found)}")


def _trials(experiments: Iterable[ExperimentOverview]) -> Iterable[tuple[ExperimentOverview, Standing]]:
    return ((experiment, trial) for experiment in experiments for trial in experiment.trials)


def _begins(identity: str, digits: str) -> bool:
    """Whether an identity begins so, of which only the first digits may be known."""
    return bool(identity) and (identity.startswith(digits) or digits.startswith(identity))


def _listed(found: Sequence[tuple[ExperimentOverview, Standing]]) -> str:
    shown = [f"{trial.identity[:10]} ({experiment.name}, {trial.label})" for experiment, trial in found[:_MOST_LISTED]]
    more = len(found) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")
