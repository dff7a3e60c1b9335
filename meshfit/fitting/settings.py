"""The settings of a fit. Free of torch, so that configs can be read and checked without it."""

from typing import Annotated, Literal

from pydantic import Field

from meshfit.settings import Settings

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


class FitSettings(Settings):
    """A fit: what is minimised, how, and for how long. Lengths are in the normalised frame of the target."""

    method: Literal["first-order"] = "first-order"
    """The engine: `first-order` moves each vertex of the source along the gradient."""
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
    trace_every: Annotated[int, Field(ge=1)] = 10
    """Steps between two rows of `trace.csv`; the first and the last step always have one."""
