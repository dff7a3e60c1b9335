"""The settings of a fit. Free of torch, so that configs can be read and checked without it."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag

from meshfit.settings import DEFAULT_KIND, KIND_KEY, Settings

Every = Annotated[int, Field(ge=1)]
Weight = Annotated[float, Field(ge=0)]
Dtype = Literal["float32", "float64"]


class LossWeights(Settings):
    """The weight of each term of the objective; a term of weight 0 is traced and does not act."""

    chamfer: Weight = 1.0
    """Squared distance between matched samples, both directions."""
    normal: Weight = 0.0
    """1 - |cos| between the normals of matched samples, both directions."""
    edge: Weight = 1.0
    """Mean squared edge length."""
    laplacian: Weight = 0.1
    """Mean length of the Laplacian of the verts."""
    consistency: Weight = 0.01
    """Mean of 1 - cos between the normals of neighbouring faces."""


class Schedule(Settings):
    """How the learning rate changes over the steps."""

    name: Literal["constant", "cosine", "step"] = "constant"
    """`constant`; `cosine`, down to `final` of the rate; or `step`, times `factor` after every `every` steps."""
    final: Annotated[float, Field(ge=0, le=1)] = 0.0
    """For `cosine`: the fraction of the rate that is left when all steps are done."""
    every: Annotated[int, Field(ge=1)] = 500
    """For `step`: steps between two reductions."""
    factor: Annotated[float, Field(gt=0, le=1)] = 0.5
    """For `step`: the factor of a reduction."""


class OptimizerSettings(Settings):
    """What turns gradients into steps."""

    name: Literal["sgd", "adam"] = "sgd"
    """`sgd` (with momentum) or `adam`."""
    lr: Annotated[float, Field(gt=0)] = 1.0
    """Learning rate."""
    momentum: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """Momentum of `sgd`; the first beta of `adam`."""
    schedule: Schedule = Schedule()
    """How the learning rate changes over the steps."""


class FirstOrderSettings(Settings):
    """A first-order fit: what is minimised, how, and for how long. Lengths are in the target's normalised frame."""

    method: Literal["first-order"] = "first-order"
    """The engine: `first-order` moves each vertex of the source along the gradient of weighted losses."""
    steps: Annotated[int, Field(ge=0)] = 2000
    """Number of optimiser steps."""
    samples: Annotated[int, Field(ge=1)] = 5000
    """Points drawn afresh at every step, uniformly by area, on the source and as many on the target."""
    losses: LossWeights = LossWeights()
    """Weights of the terms of the objective."""
    laplacian: Literal["uniform", "cotangent"] = "uniform"
    """Weights of the Laplacian term."""
    optimizer: OptimizerSettings = OptimizerSettings()
    """What turns gradients into steps."""
    trace_every: Every = 10
    """Steps between two rows of `trace.csv`; the first and the last step always have one."""
    snapshots: Every | None = None
    """Steps between two snapshots of the surface, for `meshfit animate`; null takes none. No figure depends on it."""


class GaussNewtonSettings(Settings):
    """A Gauss–Newton fit, coarse to fine: how fine it gets, how its connectivity may change, how stiff it is."""

    # Without it, settings are those of the other method.
    model_config = ConfigDict(json_schema_extra={"required": [KIND_KEY]})

    method: Literal["gauss-newton"] = "gauss-newton"
    """The engine: `gauss-newton` solves for the step of all verts at once, level by level of the scheme."""
    connectivity: Literal["remeshed", "fixed"] = "remeshed"
    """`remeshed` puts verts where they are needed; `fixed` keeps the source's faces, refined by the scheme."""
    variables: Literal["verts", "control"] = "verts"
    """What is solved for: the `verts` of the surface, or those of a coarse `control` mesh that the surface is the
    refinement of."""
    limit: bool = False
    """For `control` and the scheme `loop`: fit the limit surface."""
    verts: Annotated[int, Field(ge=100)] = 10242
    """For `remeshed`: the most verts of the result, or of its control mesh. For `fixed`, the rough shape has a quarter
    of them, or as many as the source."""
    levels: Annotated[int, Field(ge=0, le=5)] = 1
    """Levels of the scheme: those that carry the fit from coarse to fine, or that refine the control mesh."""
    coarse_steps: Annotated[int, Field(ge=0)] = 40
    """Steps that find the rough shape."""
    tries: Annotated[int, Field(ge=1, le=10)] = 2
    """How often the rough shape is looked for at most, anew from the source, where parts of it have stayed off the
    target."""
    level_steps: Annotated[int, Field(ge=1)] = 8
    """Steps at each level."""
    last_steps: Annotated[int, Field(ge=0)] = 5
    """Steps at the end, on the finest level."""
    fairness: Annotated[float, Field(gt=0)] = 0.1
    """Weight of smoothness that each level ends with."""
    last_fairness: Annotated[float, Field(gt=0)] = 0.02
    """Weight of smoothness that the last steps end with."""
    trace_every: Every = 1
    """Steps between two rows of `trace.csv`; the first and the last step always have one."""
    snapshots: Every | None = None
    """Steps between two snapshots of the surface, for `meshfit animate`; null takes none. No figure depends on it."""

    @property
    def steps(self) -> int:
        """The number of steps in all."""
        levels = 2 if self.variables == "control" else self.levels + 1
        return self.tries * self.coarse_steps + levels * self.level_steps + self.last_steps


def _method(settings: Any) -> str:  # noqa: ANN401  settings, or what is to become some
    if isinstance(settings, dict):
        return str(settings.get(KIND_KEY, "first-order"))
    return str(getattr(settings, KIND_KEY, DEFAULT_KIND))


FitSettings = Annotated[
    Annotated[FirstOrderSettings, Tag("first-order")] | Annotated[GaussNewtonSettings, Tag("gauss-newton")],
    Discriminator(_method),
]
"""The settings of a fit by one engine or the other; `method` says which, and is `first-order` where it is left out."""

METHODS: dict[str, type[FirstOrderSettings] | type[GaussNewtonSettings]] = {
    "first-order": FirstOrderSettings,
    "gauss-newton": GaussNewtonSettings,
}
