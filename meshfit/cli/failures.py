"""What failed: by the reason, with the place where it is recorded."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from meshfit.cli.console import err
from meshfit.experiment.progress import Outcome, Phase
from meshfit.experiment.store import FAILURE, RunDirectory

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

FAILED = 1
_MOST_ALIKE = 20


def print_failures(trials: Sequence["Trial"], outcomes: Mapping[int, Outcome], runs: Path) -> int:
    """A table of what failed, by the reason, and where that is recorded; the exit code is returned."""
    store = RunDirectory(runs)
    failed = [i for i, outcome in sorted(outcomes.items()) if outcome.phase is Phase.FAILED]
    if not failed:
        return 0
    err.print(f"[bold red]{len(failed)} of {len(trials)} trials failed[/]")
    width = max(len(trials[i].label) for i in failed)
    for message in dict.fromkeys(outcomes[i].message for i in failed):
        alike = [i for i in failed if outcomes[i].message == message]
        err.print(escape(message), soft_wrap=True)
        for i in alike[:_MOST_ALIKE]:
            record = escape(str(store.folder(trials[i]) / FAILURE))
            err.print(f"  {escape(trials[i].label.ljust(width))}  {record}", soft_wrap=True)
        if len(alike) > _MOST_ALIKE:
            where = escape(str(runs / trials[alike[0]].experiment))
            err.print(f"  and {len(alike) - _MOST_ALIKE} more: meshfit status {where} --all", soft_wrap=True)
    return FAILED
