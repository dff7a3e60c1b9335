"""Warnings of trials, printed as soon as they are in a trial's log: those of loading before the first step."""

import re
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from meshfit.cli.console import flush_warnings, warn_once
from meshfit.experiment.storage.run_directory import LOG, RunDirectory
from meshfit.experiment.trial_status import Outcome
from meshfit.paths import file_stem
from meshfit.report.tables.grouping import without_numbers

if TYPE_CHECKING:
    from pathlib import Path

    from meshfit.experiment.plan import Trial
    from meshfit.experiment.running.backends import ProgressReader
    from meshfit.experiment.running.scheduler import Watcher

_SECONDS_BETWEEN_READS = 0.3
_LINE = re.compile(r"^\S+  (?:(?P<measuring>measuring)|(?P<started>started on .*)|warning: (?P<warning>.*))$")


class EarlyWarnings:
    """Reader of the logs of running trials. Each warning is printed once per target and source.

    Those of measuring are left out, as tables and verdicts have them.

    Attributes:
        shown: the target and the text, without numbers, of each warning that was printed.
    """

    def __init__(
        self, trials: Sequence["Trial"], store: RunDirectory, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._trials, self._clock, self._due = trials, clock, 0.0
        self._logs = [store.folder(trial) / LOG for trial in trials]
        self._read = [_size(path) for path in self._logs]
        self._measuring, self._ended = set[int](), set[int]()
        self._known = set[tuple[str, str, str]]()
        self.shown = set[tuple[str, str]]()

    def watching(self, watch: "Watcher") -> "Watcher":
        """Return a watcher that prints new warnings, and then does what another one does."""

        def both(progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> None:
            self.update(progress, outcomes)
            watch(progress, outcomes)

        return both

    def update(self, progress: "ProgressReader", outcomes: Mapping[int, Outcome]) -> None:
        """Print the warnings that trials have got since the last call."""
        ended = [i for i in outcomes if i not in self._ended]
        if not ended and self._clock() < self._due:
            return
        self._due = self._clock() + _SECONDS_BETWEEN_READS
        running = [i for i in range(len(self._trials)) if i not in outcomes and progress[i].status.is_running]
        for i in [*ended, *running]:
            self._update(i)
        flush_warnings()
        self._ended.update(ended)

    def _update(self, i: int) -> None:
        size = _size(self._logs[i])
        if size < self._read[i]:  # a worker that returns files begins a new log
            self._read[i] = 0
        if size <= self._read[i]:
            return
        with self._logs[i].open("rb") as log:
            log.seek(self._read[i])
            content = log.read()
        whole = content[: content.rfind(b"\n") + 1]  # a line may be half-written
        self._read[i] += len(whole)
        for line in whole.decode("utf-8", "replace").splitlines():
            found = _LINE.match(line)
            if found is None:
                continue
            if found["measuring"]:
                self._measuring.add(i)
            elif found["started"]:
                self._measuring.discard(i)
            elif i not in self._measuring:
                self._show(self._trials[i], found["warning"])

    def _show(self, trial: "Trial", text: str) -> None:
        target, plain = trial.target_label, without_numbers(text)
        key = target, trial.settings.source.model_dump_json(), plain
        if key in self._known:
            return
        self._known.add(key)
        self.shown.add((target, plain))
        names_it = file_stem(text.partition(": ")[0]) == target
        warn_once(text if names_it or len(self._trials) == 1 else f"{target}: {text}")


def _size(path: "Path") -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
