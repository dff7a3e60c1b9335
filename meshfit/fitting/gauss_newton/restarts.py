"""Restarts of a fit: repeated searches for the rough shape, and when they end."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from meshfit.fitting.gauss_newton.correspondences import Correspondences
from meshfit.fitting.gauss_newton.fit_state import FitState
from meshfit.fitting.gauss_newton.schedule import Stage
from meshfit.fitting.gauss_newton.step_limiting import unsound_faces
from meshfit.fitting.settings import GaussNewtonSettings

# From this share of matched points on, a restart gains nothing: the points of membranes and of pinched-off parts are
# among the unmatched. Nor does it where the last one left more than the second number of what was unmatched before.
_ENOUGH, _WORTHWHILE = 0.992, 0.75
# Share of the target's points among all that are matched, on the rough shape: 4 of 13 per vertex.
_OF_TARGET = 4 / 13
# Share of unsound faces above which a surface that cannot be remeshed gets few steps, which are slow and mend nothing.
_UNSOUND = 0.02
# From this share on, a search for the rough shape ends once its fairness is lowest; and a level ends at a step before
# which the distance is more than the second number times that of the step before.
_COMPLETE, _STILL = 0.999, 0.97


@dataclass
class Restarts:
    """Outcome of the searches for a rough shape so far. A part that one leaves off the target, another may reach.

    No other is made once what can be matched is, or where the last one left hardly less unmatched than the best.

    Attributes:
        best: state at the end of the best search.
        share: its share of points that are reached; -1 before the end of the first search.
        matched: share of matched points in the last step.
        reached: share of those that can be matched.
        distance: distance before the last step.
        settled: whether no further restart is necessary, or none promises more.
        hopeless: whether no step can make the surface sound, so that there is one step per stage, and no search.
        still: whether the last step of the present stage hardly changed the surface, so that its others are left out.
    """

    best: FitState | None = None
    share: float = -1.0
    matched: float = 0.0
    reached: float = 0.0
    distance: float = 0.0
    settled: bool = False
    still: bool = False
    hopeless: bool = False

    @classmethod
    def unneeded(cls, distance: float) -> "Restarts":
        """Return no searches at all, for a source at this distance from the target, which is small."""
        return cls(None, 1.0, 1.0, 1.0, distance, settled=True)

    def record(self, stage: Stage, number: int, pairs: Correspondences) -> None:
        """Take note of a step, and of whether the rest of its stage, or of its search, is unnecessary."""
        distance, matched = pairs.distance, pairs.matched
        softest = stage.weights[number][0] <= stage.weights[-1][0]
        if stage.attempt is not None:
            self.still = stage.settles and number == len(stage.weights) - 1 and pairs.reached >= _COMPLETE
        else:
            slow = number > 0 and distance > _STILL * self.distance and matched <= self.matched + 1 - _COMPLETE
            self.still = stage.settles and softest and slow
        self.still |= self.hopeless
        self.matched, self.reached, self.distance = matched, pairs.reached, distance

    def end_search(self, state: FitState, hidden: Callable[[], float]) -> FitState:
        """Record the state at the end of a search, and return the best state so far.

        Args:
            state: the state.
            hidden: returns the share of the target that no surface can match.
        """
        self.still = False
        if self.settled:
            return self.best or state
        promising = self.best is None or 1 - self.reached < _WORTHWHILE * (1 - self.share)
        if self.best is None or self.reached > self.share:
            self.best, self.share = state, self.reached
        self.settled = not promising or self.share >= _ENOUGH or self.share + _OF_TARGET * hidden() >= _ENOUGH
        return self.best

    def saved(self) -> dict[str, Any]:
        """Return everything as numbers and tensors, for `restored`."""
        best = None if self.best is None else self.best.saved()
        shares = {"share": self.share, "matched": self.matched, "reached": self.reached}
        flags = {"settled": self.settled, "still": self.still, "hopeless": self.hopeless}
        return {"best": best, "distance": self.distance} | flags | shares

    @classmethod
    def restored(cls, saved: dict[str, Any], dtype: torch.dtype, device: torch.device) -> "Restarts":
        """Return the restarts that `saved` returned."""
        best = None if saved["best"] is None else FitState.restored(saved["best"], dtype, device)
        flags = {key: saved.get(key, False) for key in ("settled", "still", "hopeless")}
        share, matched, reached = (saved[key] for key in ("share", "matched", "reached"))
        return cls(best, share, matched, reached, saved["distance"], **flags)


def restarts_for(state: FitState, settings: GaussNewtonSettings, distance: float) -> Restarts:
    """Return the searches for a rough shape from a source that is far from the target."""
    if not _is_hopeless(state, settings):
        return Restarts()
    return replace(Restarts.unneeded(distance), hopeless=True)


def _is_hopeless(state: FitState, settings: GaussNewtonSettings) -> bool:
    """Return whether a surface crosses itself all over, with too many pieces or handles to be remeshed as wanted."""
    if settings.connectivity == "fixed" or state.least_verts <= settings.verts:
        return False
    return float(unsound_faces(state.shape).double().mean()) > _UNSOUND
