"""`meshfit measure --again`: measure complete trials with other settings, without their fits."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from meshfit.cli import completions
from meshfit.cli.console import EXIT_FAILED, err, out, print_error
from meshfit.errors import ConfigError
from meshfit.units import count_text

_TRIALS = "Complete trials"

Again = Annotated[
    bool,
    typer.Option(
        "--again",
        help="Measure the complete trials of run directories, given in place of meshes, with other settings; no fit.",
        rich_help_panel=_TRIALS,
    ),
]
MeasureChanges = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="With --again: change a setting under measure, such as measure.points=100000. May be repeated.",
        metavar="KEY=VALUE",
        rich_help_panel=_TRIALS,
        autocompletion=completions.settings,
    ),
]
MeasureJobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        min=1,
        help="With --again: trials that are measured in parallel.",
        show_default="one per core",
        metavar="N",
        rich_help_panel=_TRIALS,
    ),
]


def measure_again(
    runs: Sequence[str],
    overrides: Sequence[str],
    options: Mapping[str, Any],
    others: Mapping[str, object],
    *,
    jobs: int | None,
) -> int:
    """Measure the complete trials of run directories again, and say how many.

    Args:
        runs: run directories, or folders in them.
        overrides: `key=value` texts for settings under `measure`.
        options: settings that options of the command give; None for those that are not given.
        others: options that have no effect on trials; those that are not null or false are refused.
        jobs: number of processes; None for one per core.

    Returns:
        The exit code.

    Raises:
        ConfigError: a setting that a measurement does not have, or another option.
        StoreError: no complete trial.
    """
    from rich.progress import track

    from meshfit.experiment.running.device_assignment import available_cores
    from meshfit.experiment.running.measuring_again import measure_trials_again
    from meshfit.experiment.storage.result import read_results
    from meshfit.measuring.settings import MeasureSettings
    from meshfit.settings import override

    if names := [name for name, value in others.items() if value]:
        raise ConfigError(f"{', '.join(names)}: no effect with --again, which measures trials of run directories")
    given = {key: value for key, value in options.items() if value is not None}
    changes = {**_changes(overrides), **given}
    override(MeasureSettings(), changes)
    folders = [Path(result["folder"]) for result in read_results([Path(path) for path in runs])]
    trials = measure_trials_again(folders, changes, jobs or available_cores())
    hidden = not err.is_terminal or len(folders) < 2
    outcomes = list(track(trials, "measuring", len(folders), console=err, transient=True, disable=hidden))
    for outcome in outcomes:
        if outcome.state == "failed":
            named = str(outcome.folder) in outcome.error
            print_error(outcome.error if named else f"{outcome.folder}: {outcome.error}")
    states = [outcome.state for outcome in outcomes]
    kept = f", {states.count('kept')} measured with these settings before" if "kept" in states else ""
    restored = f", {states.count('restored')} have the values of the fit again" if "restored" in states else ""
    text = f"measured {states.count('measured')} of {count_text(len(folders), 'trial')} again{kept}{restored}"
    where = "; `meshfit table` shows the new values, and measurement.json holds them" if "measured" in states else ""
    out.print(f"{text}{where}", soft_wrap=True)
    return EXIT_FAILED if "failed" in states else 0


def require_again(again: bool, given: Mapping[str, object]) -> None:
    """Refuse options that need `--again` without it.

    Raises:
        ConfigError: naming them.
    """
    if names := [name for name, value in given.items() if value and not again]:
        raise ConfigError(f"{', '.join(names)}: for trials of run directories; give --again")


def _changes(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the settings under `measure` that texts set."""
    from meshfit.config.loading import parse_overrides

    changes = parse_overrides(overrides)
    if others := [key for key in changes if key != "measure"]:
        raise ConfigError(f"--set {others[0]}: needs another fit; with --again, only settings under measure can change")
    measure = changes.get("measure", {})
    if not isinstance(measure, dict):
        raise ConfigError("--set measure: expected one of its settings, such as measure.samples=100000")
    return measure
