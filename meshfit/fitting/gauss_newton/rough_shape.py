"""The best of several tries at the rough shape: parts that stay off the target in one seldom do in all."""

from dataclasses import dataclass
from typing import Any

import torch

from meshfit.fitting.gauss_newton.moving_surface import MovingSurface

# From this share of points on that have found others facing alike, there is nothing to gain from another try: webs
# and strangled parts are among those that find none.
_ENOUGH = 0.992


@dataclass
class RoughShape:
    """What is known of the tries that have been made.

    Attributes:
        best: the surface of the best try.
        share: of its points that found others facing alike; -1 where no try has ended.
        matched: that share in the last step.
        distance: that the last step began with.
    """

    best: MovingSurface | None = None
    share: float = -1.0
    matched: float = 0.0
    distance: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether no further try is needed."""
        return self.share >= _ENOUGH

    def best_of(self, surface: MovingSurface) -> MovingSurface:
        """The best surface so far, this one included, with which a try ends."""
        if self.best is None or (not self.settled and self.matched > self.share):
            self.best, self.share = surface, self.matched
        return self.best

    def state(self) -> dict[str, Any]:
        """What `restored` makes it from."""
        best = None if self.best is None else self.best.state()
        return {"best": best, "share": self.share, "matched": self.matched, "distance": self.distance}

    @classmethod
    def restored(cls, state: dict[str, Any], dtype: torch.dtype, device: torch.device) -> "RoughShape":
        """What `state` was taken of."""
        best = None if state["best"] is None else MovingSurface.restored(state["best"], dtype, device)
        return cls(best, state["share"], state["matched"], state["distance"])
