"""Types of the keyword arguments of `fit` and `fit_batch`, which are the keys of the settings of both engines."""

from typing import Literal, TypedDict


class Losses(TypedDict, total=False):
    """Weights of loss terms; see `LossWeights`."""

    chamfer: float
    normal: float
    edge: float
    laplacian: float
    consistency: float
    silhouette: float | None
    depth: float | None
    normals: float | None


class ScheduleKeys(TypedDict, total=False):
    """Change of the learning rate; see `Schedule`."""

    name: Literal["constant", "cosine", "step"]
    final: float
    every: int
    factor: float


class OptimizerKeys(TypedDict, total=False):
    """The optimiser; see `OptimizerSettings`."""

    name: Literal["sgd", "adam"]
    lr: float
    momentum: float
    schedule: ScheduleKeys


class ViewKeys(TypedDict, total=False):
    """Settings of the losses on images; see `ViewSettings`."""

    blur: float
    per_step: int
    silhouette: Literal["iou", "squared"]


class FitKeys(TypedDict, total=False):
    """Keys of `FirstOrderSettings` and `GaussNewtonSettings`; None leaves a key as it is."""

    method: Literal["first-order", "gauss-newton"] | None
    trace_every: int | None
    snapshots: int | None
    steps: int | None
    samples: int | None
    losses: Losses | None
    laplacian: Literal["uniform", "cotangent"] | None
    optimizer: OptimizerKeys | None
    views: ViewKeys | None
    connectivity: Literal["remeshed", "fixed"] | None
    variables: Literal["verts", "control"] | None
    limit: bool | None
    verts: int | None
    decimate_from: float | None
    levels: int | None
    coarse_steps: int | None
    tries: int | None
    level_steps: int | None
    last_steps: int | None
    start_fairness: float | None
    fairness: float | None
    last_fairness: float | None
    noise: Literal["auto"] | float | None
    robust: Literal["auto", "off"] | None
    direction: Literal["both", "to-target", "to-source"] | None
    register: Literal["off", "auto", "rigid", "near-rigid", "soft"] | None
    symmetric: bool | None
    offset: float | None
