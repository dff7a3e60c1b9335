"""Which trials the page shows: of each row of a table, on each target, the one whose figure is the median."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from meshfit.errors import MeshError, MeshfitError
from meshfit.experiment.storage.run_directory import Result
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.io.files import load_mesh
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.normalisation import Frame
from meshfit.mesh.targets import file_sha256, load_target, target_path
from meshfit.report.figures.surface_errors import distances_to
from meshfit.report.tables.comparisons import Row
from meshfit.report.tables.grouping import shared_settings, target_key
from meshfit.report.tables.layout import row_labels
from meshfit.report.tables.numbers import format_number
from meshfit.report.tables.table import Table
from meshfit.statistics import median_seed

_UNITS = {
    "tutorial": "its largest |coordinate| is 1",
    "box": "the diagonal of its bounding box is 1",
    "none": "in the unit of its file",
}


@dataclass(frozen=True)
class Keyed:
    """A result, which has its `folder`, and a text that is the same for the same shared settings."""

    key: str
    result: Result


@dataclass(frozen=True)
class Exhibit:
    """A trial that stands for those of its row on its target.

    Attributes:
        place: which row of the sheet it is.
        label: what the row is called.
        seed: of the trial.
        seeds: how many seeds there are.
        figure: its value of the first metric, as text; empty where it has none.
        result: its result.
    """

    place: int
    label: str
    seed: int
    seeds: int
    figure: str
    result: Result

    @property
    def folder(self) -> Path:
        """The folder of the trial."""
        return Path(self.result["folder"])


@dataclass(frozen=True)
class Wall:
    """What there is to see of one target in one sheet.

    Attributes:
        key: short and unique on the page, for links and data.
        sheet: the sheet.
        target: the target.
        title: of the target, and of its sheet where there are several.
        exhibits: one for each row that has results, as many as there is room for.
        left_out: labels of the rows that there is no room for.
    """

    key: str
    sheet: Table
    target: str
    title: str
    exhibits: tuple[Exhibit, ...]
    left_out: tuple[str, ...]

    @property
    def metric(self) -> str:
        """The title of the metric that the exhibits' figures are of."""
        return METRICS[self.sheet.metrics[0]].title

    @property
    def unit(self) -> str:
        """What its lengths are stated in."""
        return _UNITS.get(str(self.sheet.settings.get("normalise")), "in the unit of its frame")


def walls_of(sheets: Sequence[Table], trials: Sequence[Keyed], most: int) -> list[Wall]:
    """The walls of all targets of all sheets, sharing the room that there is.

    Args:
        sheets: of these results.
        trials: those that the sheets are of.
        most: exhibits on the whole page, but at least one on each wall.
    """
    found = [(sheet, target, list(_exhibits(sheet, target, trials))) for sheet in sheets for target in sheet.targets]
    found = [wall for wall in found if wall[2]]
    room = _room([len(exhibits) for *_, exhibits in found], most)
    return [
        Wall(
            key=f"wall-{place}",
            title=f"{sheet.targets[target]} · {sheet.title}" if len(sheets) > 1 else sheet.targets[target],
            sheet=sheet,
            target=target,
            exhibits=tuple(exhibits[:some]),
            left_out=tuple(exhibit.label for exhibit in exhibits[some:]),
        )
        for place, ((sheet, target, exhibits), some) in enumerate(zip(found, room, strict=True))
    ]


def row_title(sheet: Table, row: Row) -> str:
    """What a row is called in one text."""
    return " · ".join(row_labels(sheet, row))


def trials_on(sheet: Table, target: str, trials: Sequence[Keyed]) -> dict[int, dict[int, Result]]:
    """The results of a sheet on a target by place of the row, then by seed; of equal ones the first."""
    rows = {(_key(sheet.variations[row.variation].settings), row.scheme): at for at, row in enumerate(sheet.rows)}
    found: dict[int, dict[int, Result]] = {}
    for trial in trials:
        place = rows.get((trial.key, trial.result["scheme"]))
        if place is not None and target_key(trial.result) == target:
            found.setdefault(place, {}).setdefault(trial.result["seed"], trial.result)
    return {place: dict(sorted(by_seed.items())) for place, by_seed in sorted(found.items())}


def keyed(results: Sequence[Result]) -> list[Keyed]:
    """Results with their keys."""
    return [Keyed(_key(shared_settings(result)), result) for result in results]


def _key(settings: Mapping[str, object]) -> str:
    return json.dumps(settings, sort_keys=True)


def _exhibits(sheet: Table, target: str, trials: Sequence[Keyed]) -> Iterator[Exhibit]:
    metric = sheet.metrics[0]
    for place, there in trials_on(sheet, target, trials).items():
        sample = sheet.samples.get((metric, target, sheet.rows[place]), {})
        seed = median_seed(sample) if sample else min(there)
        figure = format_number(sample[seed], whole=METRICS[metric].format == "d") if sample else ""
        yield Exhibit(place, row_title(sheet, sheet.rows[place]), seed, len(there), figure, there[seed])


def _room(wanted: Sequence[int], most: int) -> list[int]:
    """How many each wall gets: all that it wants, or an even share of what there is, and one at the least."""
    if sum(wanted) <= most:
        return list(wanted)
    share = max(1, most // len(wanted))
    return [min(count, share) for count in wanted]


@dataclass(frozen=True)
class Subject:
    """The meshes of one exhibit, in the frame that its numbers are stated in.

    Attributes:
        exhibit: which one.
        source: the source mesh.
        result: the fitted mesh.
        distances: (V,) from each vert of the result to the target; None where there is no target to measure to.
    """

    exhibit: Exhibit
    source: Mesh
    result: Mesh
    distances: Float64[np.ndarray, " V"] | None


@dataclass(frozen=True)
class Subjects:
    """What a wall can be drawn of.

    Attributes:
        wall: which one.
        target: the target; None where it is gone, or is no longer what it was.
        shown: the exhibits whose meshes could be read.
        problems: what could not be read, and why, a line each.
    """

    wall: Wall
    target: Mesh | None
    shown: tuple[Subject, ...]
    problems: tuple[str, ...]


def subjects_of(wall: Wall) -> Subjects:
    """Read the meshes of a wall; what cannot be read is told, and the rest is kept."""
    problems: list[str] = []
    target = _target(wall.exhibits[0].result, problems)
    shown = tuple(_subjects(wall, target, problems))
    return Subjects(wall, target, shown, tuple(problems))


def _target(result: Result, problems: list[str]) -> Mesh | None:
    name = result["settings"]["targets"][0]
    try:
        path, known = target_path(name), result.get("inputs", {}).get("target")
        if path is not None and known is not None and path.is_file() and file_sha256(path) != known:
            raise MeshError(f"{path}: not the file that the trial was fitted to: it has changed since")
        return _frame(result).normalise(load_target(name))
    except MeshfitError as error:
        problems.append(f"The target is not shown, and distances to it are not drawn: {error}")
        return None


def _subjects(wall: Wall, target: Mesh | None, problems: list[str]) -> Iterator[Subject]:
    for exhibit in wall.exhibits:
        try:
            source, result = _fitted(exhibit)
            distances = distances_to(result, target) if target is not None else None
        except MeshfitError as error:
            problems.append(f"{exhibit.label}, seed {exhibit.seed}, is not shown: {error}")
            continue
        yield Subject(exhibit, source, result, distances)


def _fitted(exhibit: Exhibit) -> tuple[Mesh, Mesh]:
    source, result = (load_mesh(exhibit.folder / name) for name in ("source.ply", "result.ply"))
    if not result.num_faces:
        raise MeshError(f"{exhibit.folder / 'result.ply'}: no faces")
    if exhibit.result["settings"].get("write_frame") == "target":
        frame = _frame(exhibit.result)
        return frame.normalise(source), frame.normalise(result)
    return source, result


def _frame(result: Result) -> Frame:
    found = result["frame"]
    return Frame(tuple(found["centre"]), found["scale"])
