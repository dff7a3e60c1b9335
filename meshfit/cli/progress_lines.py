"""Progress without a terminal: lines for a log, at a rate at which they can be read."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from meshfit.cli.console import err
from meshfit.experiment.progress import Outcome, Phase
from meshfit.report.amounts import duration

if TYPE_CHECKING:
    from meshfit.experiment.crews import ProgressBoard
    from meshfit.experiment.plan import Trial

_AT_ONCE = 20
_SECONDS_PER_LINE = 5.0
_SECONDS_BETWEEN_SIGNS = 60.0


class Lines:
    """A line for every trial that ends, or for several if they end faster than that; one a minute if none ends."""

    def __init__(self, trials: Sequence["Trial"], clock: Callable[[], float] = time.monotonic) -> None:
        self._trials, self._clock = trials, clock
        self._started = self._said = self._filled = clock()
        self._before: int | None = None
        self._told: set[int] = set()
        self._allowed = float(_AT_ONCE)

    def update(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome]) -> None:
        """Say what is new."""
        now = self._clock()
        self._allowed = min(float(_AT_ONCE), self._allowed + (now - self._filled) / _SECONDS_PER_LINE)
        self._filled = now
        self._begin(outcomes, board)
        new = [i for i in outcomes if i not in self._told]
        for i in [i for i in new if outcomes[i].phase is Phase.FAILED]:
            self._tell([i], f"{self._trials[i].label}: failed: {outcomes[i].message}")
        self._tell_others([i for i in new if i not in self._told], outcomes)
        if now - self._said >= _SECONDS_BETWEEN_SIGNS:
            self._tell([], self._sign_of_life(board, outcomes, now))

    def _begin(self, outcomes: Mapping[int, Outcome], board: "ProgressBoard") -> None:
        """What was complete before this run began has not been posted to its board."""
        if self._before is None:
            early = [i for i in outcomes if board.phase(i) is Phase.WAITING]
            self._before = len(early)
            if early:
                self._tell(early, "complete already")

    def _tell_others(self, ended: Sequence[int], outcomes: Mapping[int, Outcome]) -> None:
        if len(ended) <= self._allowed:
            for i in ended:
                self._tell([i], f"{self._trials[i].label}: {outcomes[i].phase.name.lower()}")
        elif self._allowed >= 1 or len(outcomes) == len(self._trials):
            self._tell(ended, f"{len(ended)} more are complete")

    def _tell(self, ended: Sequence[int], text: str) -> None:
        self._told |= set(ended)
        self._allowed -= 1
        self._said = self._clock()
        err.print(f"[{len(self._told)}/{len(self._trials)}] {text}", soft_wrap=True, markup=False)

    def _sign_of_life(self, board: "ProgressBoard", outcomes: Mapping[int, Outcome], now: float) -> str:
        waiting = [i for i in range(len(self._trials)) if i not in outcomes]
        running = [i for i in waiting if board.phase(i) in (Phase.FITTING, Phase.MEASURING)]
        parts = sum(board.step(i).done / max(self._trials[i].settings.fit.steps, 1) for i in running)
        done = len(outcomes) - (self._before or 0) + parts
        left = (now - self._started) * (len(waiting) - parts) / done if done else None
        text = f"{len(running)} running, {len(waiting) - len(running)} waiting"
        return text if left is None else f"{text}; about {duration(left)} left"
