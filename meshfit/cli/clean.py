"""`meshfit clean`: remove failed and interrupted trials."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from meshfit.cli.console import out
from meshfit.cli.options import takes_run_dirs
from meshfit.errors import ConfigError
from meshfit.experiment.status.cleaning import clean as clean_trials
from meshfit.experiment.status.scan import scan_experiments
from meshfit.experiment.trial_status import TrialStatus
from meshfit.units import count_text, size_text


@takes_run_dirs
def clean(
    runs: list[Path],
    failed: Annotated[
        bool, typer.Option("--failed", help="Remove the folders of trials that failed, or whose result is damaged.")
    ] = False,
    partial: Annotated[
        bool,
        typer.Option(
            "--partial", help="Remove the folders of interrupted trials, and half-written files of killed processes."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List what would be removed; remove nothing.")] = False,
) -> int:
    """Remove failed and interrupted trials.

    Complete and running trials are never removed. The checkpoints of interrupted trials are removed too, so a rerun
    starts from the beginning; so are copies of targets that no trial uses any more.

    Examples:
        meshfit clean runs --failed --dry-run
        meshfit clean runs/table1 --failed --partial
    """
    if not (failed or partial):
        raise ConfigError("expected --failed, --partial or both")
    statuses = [TrialStatus.FAILED, TrialStatus.DAMAGED] * failed + [TrialStatus.INTERRUPTED] * partial
    cleaned = clean_trials(scan_experiments(runs, datetime.now(UTC)), statuses, runs, dry_run=dry_run)
    for removed in cleaned.removed if dry_run else ():
        trial = removed.trial
        text = f"half-written files of {trial.label}" if removed.names else f"{trial.status.value}: {trial.label}"
        out.print(Text(f"{text}, {size_text(removed.size)}  {trial.path}"), soft_wrap=True)
    for path, size in cleaned.targets.items() if dry_run else ():
        out.print(Text(f"target of no trial, {size_text(size)}  {path}"), soft_wrap=True)
    folders = sum(not removed.names for removed in cleaned.removed)
    files = sum(len(removed.names) for removed in cleaned.removed)
    targets = len(cleaned.targets)
    counts = [count_text(folders, "trial")] if folders or not (files or targets) else []
    counts += [count_text(files, "half-written file")] if files else []
    counts += [count_text(targets, "target") + " of no trial"] if targets else []
    total = size_text(sum(removed.size for removed in cleaned.removed) + sum(cleaned.targets.values()))
    out.print(f"{'would remove' if dry_run else 'removed'} {' and '.join(counts)}, {total}")
    if cleaned.running:
        out.print(f"kept {count_text(len(cleaned.running), 'running trial')}")
    return 0
