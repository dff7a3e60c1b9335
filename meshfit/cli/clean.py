"""`meshfit clean`: remove what failed or was interrupted."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from meshfit.cli.console import out
from meshfit.cli.options import RunDirs
from meshfit.errors import ConfigError

if TYPE_CHECKING:
    from meshfit.experiment.status.cleaning import Cleaned, Removed


def clean(
    runs: RunDirs,
    failed: Annotated[bool, typer.Option("--failed", help="Remove the folders of trials that failed.")] = False,
    partial: Annotated[
        bool,
        typer.Option(
            "--partial", help="Remove the folders of interrupted trials, and files that a kill left half written."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List what would be removed; remove nothing.")] = False,
) -> int:
    """Remove what failed or was interrupted.

    Complete trials and those that run now are left as they are. Of interrupted trials the checkpoints go too:
    what is run again starts over.

    Examples:
        meshfit clean runs --failed --dry-run

        meshfit clean runs/table1 --failed --partial
    """
    if not (failed or partial):
        raise ConfigError("found neither --failed nor --partial; one of them or both are needed")
    from meshfit.experiment.status.cleaning import clean as cleaned
    from meshfit.experiment.status.scan import scan_experiments
    from meshfit.experiment.trial_status import TrialStatus

    states = [state for state, wanted in ((TrialStatus.FAILED, failed), (TrialStatus.INTERRUPTED, partial)) if wanted]
    found = cleaned(scan_experiments(runs, datetime.now(UTC)), states, runs, dry_run=dry_run)
    _print(found, dry_run=dry_run)
    return 0


def _print(cleaned: "Cleaned", *, dry_run: bool) -> None:
    from meshfit.units import count_text, size_text

    if dry_run:
        for removed in cleaned.removed:
            out.print(Text(f"{_what(removed)}, {size_text(removed.size)}  {removed.trial.path}"), soft_wrap=True)
    folders = sum(not removed.names for removed in cleaned.removed)
    files = sum(len(removed.names) for removed in cleaned.removed)
    gone = [count_text(folders, "trial")] if folders or not files else []
    gone += [count_text(files, "half-written file")] if files else []
    total = size_text(sum(removed.size for removed in cleaned.removed))
    out.print(f"{'would remove' if dry_run else 'removed'} {' and '.join(gone)}, {total}")
    if cleaned.running:
        out.print(f"left {count_text(len(cleaned.running), 'trial')} that run" + "s" * (len(cleaned.running) == 1))


def _what(removed: "Removed") -> str:
    trial = removed.trial
    return f"half-written files of {trial.label}" if removed.names else f"{trial.status.value}: {trial.label}"
