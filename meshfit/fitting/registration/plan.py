"""The steps of a registration, and the settings of each. Importing it does not import torch."""

from dataclasses import dataclass, replace
from typing import Literal

Prior = Literal["rigid", "near-rigid", "soft"]
Register = Literal["off", "auto", "rigid", "near-rigid", "soft"]
Kind = Literal["pose", "graph", "unfold", "vertices"]
Range = tuple[float, float]


@dataclass(frozen=True)
class Level:
    """A deformation graph and the steps on it. Ranges are from the first step to the last, geometric between.

    Attributes:
        nodes: number of nodes.
        steps: number of steps.
        points: number of vertices and of points of the target, at most, among which the nearest are sought.
        samples: number of them that are paired in each step.
        width: of robust weights, relative to the target's diagonal.
        stiffness: weight of the graph's edges.
        point_weight: weight of residuals along the surface relative to those across it.
        normal_length: distance that opposite normals are worth, halved, relative to the diagonal.
    """

    nodes: int
    steps: int
    points: int
    samples: int
    width: Range
    stiffness: Range
    point_weight: Range
    normal_length: float


LEVELS = (
    Level(60, 40, 5000, 800, (0.3, 0.06), (3.0, 0.02), (0.5, 0.05), 0.25),
    Level(150, 12, 10_000, 1500, (0.08, 0.03), (0.05, 0.03), (0.2, 0.05), 0.08),
    Level(500, 10, 20_000, 3000, (0.03, 0.012), (0.05, 0.02), (0.05, 0.02), 0.05),
)
"""From coarse to fine; found on pairs of figures and animals with known correspondence."""

# Nodes that have scales of their own are tied more firmly, or thin parts crumple.
_SOFT_LEVELS = (LEVELS[0], replace(LEVELS[1], stiffness=(0.5, 0.1)), replace(LEVELS[2], stiffness=(0.1, 0.05)))

VERTEX_STEPS = 8
"""Number of steps of all vertices."""


AS_SET = "as set"
"""Why a source was registered as it was, without `auto`."""


@dataclass(frozen=True)
class Registered:
    """The registration of the source of a fit, and the reason for it.

    Attributes:
        register: `rigid`, `near-rigid`, or `off` where `auto` found nothing to register.
        reason: in words; `as set` without `auto`.
    """

    register: Register
    reason: str

    @property
    def is_set(self) -> bool:
        """Whether the settings say so."""
        return self.reason == AS_SET

    @property
    def line(self) -> str:
        """One line for logs."""
        return f"registration: {self.register}, {self.reason}"


@dataclass(frozen=True)
class PlannedStep:
    """A step of a registration.

    Attributes:
        stage: name in progress messages.
        kind: `pose` finds the pose and fits the coarsest graph; `graph` is a step on a finer one; `unfold` takes faces
            apart that cross; `vertices` is a step of all vertices.
        level: number of the graph.
        number: of the step in its stage.
        cost: about the work, relative to that of a step of all vertices.
    """

    stage: str
    kind: Kind
    level: int = 0
    number: int = 0
    cost: float = 1.0


def levels_of(prior: Prior) -> tuple[Level, ...]:
    """Return the levels of a registration, from coarse to fine; their numbers of steps are those of `LEVELS`."""
    return _SOFT_LEVELS if prior == "soft" else LEVELS


def planned_steps(prior: Prior) -> list[PlannedStep]:
    """Return the steps of a registration."""
    pose = PlannedStep("pose", "pose", cost=10.0)
    if prior == "rigid":
        return [pose]
    graphs = [
        PlannedStep(f"graph of {level.nodes} nodes", "graph", index, number, 0.3 * index)
        for index, level in enumerate(LEVELS)
        for number in range(level.steps)
        if index
    ]
    vertices = [PlannedStep("vertices", "vertices", number=number) for number in range(VERTEX_STEPS)]
    unfold = PlannedStep("unfolding", "unfold", cost=2.0)
    return [pose, *graphs, unfold, *vertices, unfold]
