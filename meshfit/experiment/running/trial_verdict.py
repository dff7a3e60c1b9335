"""The verdict on a trial: its result checked against its source and target, by its settings."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshfit.config.experiment import ExperimentSettings
from meshfit.fitting.external.tools import works_from_target
from meshfit.fitting.settings import ExternalSettings, FirstOrderSettings, GaussNewtonSettings
from meshfit.measuring.distance import Distance
from meshfit.measuring.mask_overlap import MaskOverlap
from meshfit.measuring.shortfalls import FAR, FAR_ON_AVERAGE, shortfalls
from meshfit.measuring.verdict import FARTHER, Facts, Verdict, verdict_on
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.nearest import nearest_point_query
from meshfit.mesh.offset import lifted
from meshfit.mesh.point_cloud import PointCloud
from meshfit.mesh.proximity import point_distances
from meshfit.mesh.sampling import sample_surface

_POINTS = 5000


class TrialVerdict(NamedTuple):
    """Shortfalls of a result in words, and the verdict on it."""

    shortfalls: list[str]
    verdict: Verdict


def judge(
    meshes: tuple[Mesh, Mesh, Mesh | PointCloud],
    settings: ExperimentSettings,
    distance: Distance,
    masks: MaskOverlap | None,
    *,
    of_fit: Sequence[str],
    compared_with: str,
) -> TrialVerdict:
    """Check the result of a trial.

    Args:
        meshes: the result, the source as it was placed, and what the result is compared with, in the normalised frame.
        settings: of the trial, with those of the measurement.
        distance: distances of the result from what it is compared with.
        masks: overlap of its masks with those of images; None without images.
        of_fit: what the fit did not reach, in words.
        compared_with: of images `truth`, `depth` or `hull`; empty for others.
    """
    result, source, reference = meshes
    fit = settings.fit
    offset = getattr(fit, "offset", 0.0)
    filled = source if settings.source.mesh == "closed" else None
    is_guess = compared_with == "hull"  # for want of a truth: a good result is off it
    short = list(of_fit)
    if not is_guess:
        far = FAR_ON_AVERAGE if isinstance(fit, FirstOrderSettings) else FAR
        surface: Surface = "outer" if "outer" in (settings.target.surface, settings.measure.surface) else "all"
        wanted = lifted(reference, offset) if offset else reference
        short += shortfalls(result, wanted, far, surface=surface, filled=filled)
    if masks is not None:
        short += masks.shortfalls
    counts = filled is None and not offset and not is_guess
    facts = _facts(meshes, settings, distance if counts else None, short)
    verdict = verdict_on(result, source, reference, facts)
    return TrialVerdict(list(dict.fromkeys([*verdict.findings, *short])), verdict)


def _facts(
    meshes: tuple[Mesh, Mesh, Mesh | PointCloud],
    settings: ExperimentSettings,
    distance: Distance | None,
    short: Sequence[str],
) -> Facts:
    """Return what a verdict needs to know; without a distance, a good result may be far from the target."""
    (result, source, reference), fit = meshes, settings.fit
    asked = settings.source.wanted_verts
    if isinstance(fit, GaussNewtonSettings):
        asked = fit.verts if fit.connectivity == "remeshed" else None
    before, after = (_mean_distance(mesh, reference) for mesh in (source, result))
    if after > FARTHER * before:  # to samples, so that what is nearer than their spacing is not seen
        before, after = (_mean_distance(mesh, reference, exact=True) for mesh in (source, result))
    tool = fit.tool if isinstance(fit, ExternalSettings) else None
    first_order = isinstance(fit, FirstOrderSettings)
    return Facts(
        distance=distance,
        mean_distances=None if distance is None else (before, after),
        asked_verts=None if isinstance(fit, ExternalSettings) else asked,
        is_placed=works_from_target(tool) or (isinstance(fit, GaussNewtonSettings) and fit.prior is not None),
        remedy="; raise fit.samples, or lower fit.optimizer.lr" if first_order else "",
        shortfalls=short,
    )


def _mean_distance(mesh: Mesh, target: Mesh | PointCloud, *, exact: bool = False) -> float:
    """Return the mean distance of samples of two surfaces, both ways, from each other, or exactly from the surfaces.

    Of a cloud, it is the distance of its points from the surface.
    """
    if isinstance(target, PointCloud):
        some = target.verts[:: max(1, target.num_verts // _POINTS)]
        return float(point_distances(mesh, some).mean())
    generator = np.random.default_rng(0)
    first, second = (sample_surface(each, _POINTS, generator).points for each in (mesh, target))
    if exact:
        return float(np.mean([point_distances(target, first).mean(), point_distances(mesh, second).mean()]))
    ways = ((first, second), (second, first))
    return float(np.mean([np.linalg.norm(p - q[nearest_point_query(q)(p)], axis=1).mean() for p, q in ways]))
