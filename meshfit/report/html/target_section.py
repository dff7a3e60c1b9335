"""The sections of the page: each target of each table, with the meshes of one representative trial per row."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError, MeshfitError
from meshfit.experiment.storage.frame import frame_of
from meshfit.experiment.storage.plan_file import UpChoice, planned_up
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.storage.targets import read_images, read_target
from meshfit.fitting.external.tools import works_from_target
from meshfit.images.folders import IMAGE_REFERENCES
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.point_cloud import PointCloud
from meshfit.report.figures.camera import is_turned
from meshfit.report.figures.cloud_surfels import drawn, measurable
from meshfit.report.figures.colours import shared_limit
from meshfit.report.figures.representative_trial import RepresentativeTrial, TrialIndex, representative
from meshfit.report.figures.trial_meshes import (
    FITTED,
    SOURCE,
    distances_to,
    distinct_meshes,
    read_normalised,
)
from meshfit.report.figures.view_overlay import ShownView, shown_views
from meshfit.report.tables.heads import FRAMES
from meshfit.report.tables.layout import SHORTFALL, row_titles
from meshfit.report.tables.numbers import format_number
from meshfit.report.tables.table import Row, Table
from meshfit.units import count_text

MOST_SECTIONS = 20
"""Largest number of targets with pictures, 3D views, curves and histograms; the tables have all."""

TrialsByRow = Mapping[int, Mapping[int, Result]]
"""Results on one target, by index of the table's row, then by seed."""


@dataclass(frozen=True)
class LoadedTrial:
    """The representative trial of a row, with its meshes in the frame that its numbers refer to.

    Attributes:
        label: the name of the row.
        seed: the seed of the trial.
        value: its value of the first metric, as text; empty if it has none.
        scheme: the scheme.
        row: index of the row.
        source: the source mesh; None for a tool that works from the target alone.
        mesh: the fitted mesh.
        distances: (V,) from each vertex of the fitted mesh to the target; None without a target to measure to.
    """

    label: str
    seed: int
    value: str
    scheme: str
    row: int
    source: Mesh | None
    mesh: Mesh
    distances: Float64[np.ndarray, " V"] | None


@dataclass(frozen=True)
class TargetSection:
    """Everything that the page shows of one target of one table.

    Attributes:
        key: short and unique on the page, for links and data.
        title: the target's title, and the experiment's name or the table's title if there are several tables.
        metric: title of the first metric.
        unit: the frame that states the unit of lengths.
        rows: labels of the table's rows.
        trials_by_row: all results on the target.
        values_by_row: their values of the first metric.
        target: the target; None if it is missing or has changed.
        trials: the loaded trials, one per row that can be read.
        left_out: labels of the rows that there is no room for.
        problems: messages about files that could not be read.
        up: the axis that points up.
        views: views of a target of images to show results in.
        target_name: what the target's picture shows.
    """

    key: str
    title: str
    metric: str
    unit: str
    rows: Sequence[str]
    trials_by_row: TrialsByRow
    values_by_row: Mapping[int, Mapping[int, float]]
    target: Mesh | PointCloud | None
    trials: Sequence[LoadedTrial]
    left_out: Sequence[str]
    problems: Sequence[str]
    up: UpChoice = "auto"
    views: Sequence[ShownView] = ()
    target_name: str = "target"

    @cached_property
    def sources(self) -> list[tuple[str, Mesh]]:
        """The sources that look different, each with its schemes, or with its rows if a scheme has several sources."""
        groups = distinct_meshes([(trial, trial.source) for trial in self.trials if trial.source is not None])
        schemes = [", ".join(dict.fromkeys(trial.scheme for trial in trials)) for trials, _ in groups]
        labels = ["; ".join(trial.label for trial in trials) for trials, _ in groups]
        names = schemes if len(set(schemes)) == len(schemes) else labels
        return [(name, mesh) for name, (_, mesh) in zip(names, groups, strict=True)]

    @cached_property
    def drawn_target(self) -> Mesh | None:
        """The target as it is drawn: points as discs."""
        return None if self.target is None else drawn(self.target)

    @cached_property
    def measured_to(self) -> Mesh | None:
        """The target as distances are measured to it."""
        return None if self.target is None else measurable(self.target)

    @property
    def target_size(self) -> str:
        """The size of the target in words."""
        if self.target is None:
            return ""
        return count_text(self.target.num_faces or self.target.num_verts, "face" if self.target.num_faces else "point")

    @cached_property
    def distances(self) -> list[Float64[np.ndarray, " V"]]:
        """The distances of all trials that have some."""
        return [trial.distances for trial in self.trials if trial.distances is not None]

    @cached_property
    def limit(self) -> float:
        """The end of the colour scale of distances, shared by pictures, viewer and histogram."""
        return shared_limit(self.distances)

    @property
    def first_mesh(self) -> Mesh | None:
        """The mesh that sets the view: the target, or a result without it; None where nothing is shown."""
        if self.drawn_target is None:
            return self.trials[0].mesh if self.trials else None
        return self.drawn_target

    @property
    def is_turned(self) -> bool:
        """Whether z is up because the target seems to stand that way."""
        return self.first_mesh is not None and is_turned(self.first_mesh, self.up)

    @property
    def exceeds_limit(self) -> bool:
        """Whether some distance is beyond the end of the colour scale."""
        return any(float(values.max(initial=0.0)) > self.limit for values in self.distances)


def read_sections(
    tables: Sequence[Table],
    results: Sequence[Result],
    most: int,
    progress: Callable[[int, int], None],
    up: UpChoice | None = None,
) -> list[TargetSection]:
    """Read the sections of the targets of all tables; files that cannot be read become problems of their section.

    Of more than `MOST_SECTIONS` targets, those in even steps from the smallest to the largest mean of the first metric.

    Args:
        tables: tables of these results.
        results: results with their `folder`.
        most: largest number of loaded trials on the page; each section has at least one.
        progress: called with the number of sections read, and of all.
        up: the axis that points up; by default that of each experiment.
    """
    every = _targets_of(tables, results)
    targets = [every[place] for place in _spread([_mean_value(table, target) for table, _, target, _ in every])]
    room = shares_of([len(trials) for *_, trials in targets], most)
    sections = []
    for place, ((table, title, target, trials), rows) in enumerate(zip(targets, room, strict=True)):
        progress(place, len(targets))
        name = table.targets[target] if len(tables) == 1 else f"{table.targets[target]} · {title}"
        sections.append(_read_section(f"target-{place}", name, table, target, trials, rows, up))
    return sections


def num_left_out(tables: Sequence[Table], results: Sequence[Result]) -> int:
    """Return how many targets with results `read_sections` leaves out."""
    return max(0, len(_targets_of(tables, results)) - MOST_SECTIONS)


def _targets_of(
    tables: Sequence[Table], results: Sequence[Result]
) -> list[tuple[Table, str, str, dict[int, dict[int, Result]]]]:
    """List every target that has results: its table, the table's title, the target and its trials by row."""
    index = TrialIndex(results)
    return [
        (table, title, target, trials)
        for table, title in zip(tables, short_titles(tables), strict=True)
        for target in table.targets
        if (trials := trials_by_row(table, target, index))
    ]


def _mean_value(table: Table, target: str) -> float:
    """The mean of the first metric over all trials of a target; infinite without a value."""
    samples = (table.samples.get((table.metrics[0], target, row), {}) for row in table.rows)
    values = [value for by_seed in samples for value in by_seed.values()]
    return float(np.mean(values)) if values else np.inf


def _spread(values: Sequence[float], most: int = MOST_SECTIONS) -> list[int]:
    """Return the places of at most so many values, in even steps from the smallest to the largest, in their order."""
    if len(values) <= most:
        return list(range(len(values)))
    ranked = sorted(range(len(values)), key=lambda place: values[place])
    return sorted(ranked[round(step * (len(ranked) - 1) / (most - 1))] for step in range(most))


def short_titles(tables: Sequence[Table]) -> list[str]:
    """Return the experiments of tables if these are all different, else their titles, which contain settings."""
    experiments = [table.experiment for table in tables]
    return experiments if len(set(experiments)) == len(tables) else [table.title for table in tables]


def trials_by_row(table: Table, target: str, index: TrialIndex) -> dict[int, dict[int, Result]]:
    """Return the results of a table on one target; rows without results are left out."""
    by_row = {
        place: index.by_seed(table.variations[row.variation].settings, target, row.scheme)
        for place, row in enumerate(table.rows)
    }
    return {place: trials for place, trials in by_row.items() if trials}


def row_title(table: Table, row: Row) -> str:
    """Return the name of a row as one text."""
    return " · ".join(row_titles(table, row))


def shares_of(wanted: Sequence[int], most: int) -> list[int]:
    """Share `most` places: everyone gets all they want if that fits, else an even share, but at least one."""
    if sum(wanted) <= most:
        return list(wanted)
    share = max(1, most // len(wanted))
    return [min(count, share) for count in wanted]


def _read_section(
    key: str, title: str, table: Table, target: str, trials: TrialsByRow, most: int, up: UpChoice | None
) -> TargetSection:
    metric, titles = table.metrics[0], [row_title(table, row) for row in table.rows]
    values = {place: table.samples.get((metric, target, table.rows[place]), {}) for place in trials}
    chosen = {place: representative(by_seed, values[place]) for place, by_seed in trials.items()}
    shown = list(chosen)[:most]
    problems: list[str] = []
    target_mesh = _read_target(chosen[shown[0]], problems)
    measured_to = None if target_mesh is None else measurable(target_mesh)
    views = _read_views([chosen[row] for row in shown], problems)
    whole = METRICS[metric].format == "d"
    schemes = {row: table.scheme_title(chosen[row].scheme) for row in shown}
    loaded = [_load(chosen[row], row, (titles[row], schemes[row]), measured_to, problems, whole=whole) for row in shown]
    return TargetSection(
        key=key,
        title=title,
        metric=table.metric_title(metric),
        unit=FRAMES.get(str(table.settings.get("normalise")), "normalised units"),
        rows=titles,
        trials_by_row=trials,
        values_by_row=values,
        target=target_mesh,
        trials=[trial for trial in loaded if trial is not None],
        left_out=[titles[row] for row in list(chosen)[most:]],
        problems=problems,
        up=up or planned_up(chosen[shown[0]].folder),
        views=views,
        target_name=IMAGE_REFERENCES.get(chosen[shown[0]].result.get("images", {}).get("compared_with"), "target"),
    )


def _read_target(trial: RepresentativeTrial, problems: list[str]) -> Mesh | PointCloud | None:
    try:
        return frame_of(trial.result).normalise(read_target(trial.folder, trial.result))
    except MeshfitError as error:
        problems.append(f"The target is not shown, and distances to it are not drawn: {error}")
        return None


def _read_views(trials: Sequence[RepresentativeTrial], problems: list[str]) -> list[ShownView]:
    """Read the views to show of a target of images, among them the worst of the first trial; none of other targets."""
    first = trials[0]
    try:
        images = read_images(first.folder, first.result)
    except MeshfitError as error:
        problems.append(f"The views are not shown: {error}")
        return []
    worst = [trial.result.get("iou", {}).get("worst_view", "") for trial in trials]
    return [] if images is None else shown_views(images.moved(frame_of(first.result)), worst)


def _load(
    trial: RepresentativeTrial,
    row: int,
    names: tuple[str, str],
    target: Mesh | None,
    problems: list[str],
    *,
    whole: bool,
) -> LoadedTrial | None:
    """Load the meshes of a trial, by the names of row and scheme; if they cannot be read, add a problem."""
    label, scheme = names
    try:
        unused = works_from_target(trial.result["settings"]["fit"].get("tool"))
        source = None if unused else _read_surface(trial, SOURCE)
        mesh = _read_surface(trial, FITTED)
        distances = distances_to(mesh, target) if target is not None else None
    except MeshfitError as error:
        problems.append(f"{label}, seed {trial.seed}, is not shown: {error}")
        return None
    value = "" if trial.value is None else format_number(trial.value, whole=whole)
    value += SHORTFALL if trial.shortfalls and value else ""
    return LoadedTrial(label, trial.seed, value, scheme, row, source, mesh, distances)


def _read_surface(trial: RepresentativeTrial, name: str) -> Mesh:
    mesh = read_normalised(trial.folder / name, trial.result)
    if not mesh.num_faces:
        raise MeshError(f"{trial.folder / name}: no faces")
    return mesh
