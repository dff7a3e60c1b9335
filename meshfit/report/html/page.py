"""Data as a page carries it: compressed, in base64, for the browser to unpack when it is looked at."""

import base64
import gzip
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import Any

from meshfit.experiment.status.scan import ScannedExperiment, scan_experiments
from meshfit.experiment.storage.plan_file import with_planned_names
from meshfit.experiment.storage.result import read_result
from meshfit.experiment.storage.run_directory import Result
from meshfit.report.extra import needed
from meshfit.report.figures.colours import DISTANCES
from meshfit.report.html import charts
from meshfit.report.html import tables as records
from meshfit.report.html import tables as sheets
from meshfit.report.html.charts import Curves, curves_of, histograms_of
from meshfit.report.html.images import Gallery, gallery_of, pictures_in
from meshfit.report.html.target_section import Keyed, Subjects, Wall, keyed, subjects_of, trials_on, walls_of
from meshfit.report.html.viewer import MOST_FACES, Scene, scene_of
from meshfit.report.tables.grouping import distinguish_definitions
from meshfit.report.tables.table import Table, build_tables, merge_tables


def packed(content: bytes) -> str:
    """Bytes as text; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(content, compresslevel=9, mtime=0)).decode()


def packed_json(content: Any) -> str:  # noqa: ANN401  whatever JSON holds
    """Plain data as text; NaN and infinity, which JSON has not, are refused."""
    return packed(json.dumps(content, separators=(",", ":"), allow_nan=False).encode())


Progress = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""

MOST_EXHIBITS = 40
"""Trials that are drawn; a page with more pictures is neither looked through nor mailed."""


@dataclass(frozen=True)
class Exhibition:
    """A wall with all that was made of it.

    Attributes:
        subjects: its meshes' problems and exhibits.
        gallery: its pictures; None where there is nothing to draw.
        scene: what can be turned; likewise.
        packed: the scene as the page carries it.
        curves: of all its trials.
        chart: the data of its charts.
    """

    subjects: Subjects
    gallery: Gallery | None
    scene: Scene | None
    packed: str
    curves: Curves
    chart: dict[str, Any]

    @property
    def wall(self) -> Wall:
        """The wall."""
        return self.subjects.wall


@dataclass(frozen=True)
class Content:
    """What a page is made of: experiments as they stand, complete results, the sheets of their tables."""

    experiments: Sequence[ScannedExperiment]
    results: Sequence[Result]
    sheets: Sequence[Table]


def require_extra() -> None:
    """Refuse, before anything is read, what could not be written.

    Raises:
        ConfigError: a library of the extra `report` is missing.
    """
    for module in ("jinja2", "plotly", "pyvista", "PIL.Image"):
        needed(module)


def read_content(roots: Sequence[Path], metrics: Sequence[str], baseline: str | None, now: datetime) -> Content:
    """Read all that some run directories say, but for meshes and traces.

    Raises:
        StoreError: no trial in them, or a file that cannot be read.
        ConfigError: no such metric, or a baseline without results.
        SchemeError: the baseline is not a scheme.
    """
    experiments = scan_experiments(roots, now)
    complete = [
        result | {"folder": str(trial.path)}
        for experiment in experiments
        for trial in experiment.trials
        if (result := read_result(trial.path)) is not None
    ]
    results = distinguish_definitions(with_planned_names(complete))
    tables = merge_tables(build_tables(results, *metrics, baseline=baseline))
    return Content(experiments, results, tables)


def page_text(content: Content, now: datetime, progress: Progress) -> str:
    """The HTML of a page.

    Args:
        content: of the page.
        now: when it is made.
        progress: told of each step.

    Raises:
        ConfigError: a library of the extra `report` is missing.
    """
    trials = keyed(content.results)
    walls = walls_of(content.sheets, trials, MOST_EXHIBITS)
    shown = _exhibitions(walls, trials, progress)
    environment = needed("jinja2").Environment(
        loader=needed("jinja2").PackageLoader("meshfit.report.html", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=needed("jinja2").StrictUndefined,
    )
    return str(environment.get_template("page.html").render(_names(content, trials, shown, now)))


def _exhibitions(walls: Sequence[Wall], trials: Sequence[Keyed], progress: Progress) -> list[Exhibition]:
    subjects = []
    for place, wall in enumerate(walls):
        progress("reading meshes", place, len(walls))
        subjects.append(subjects_of(wall))
    count = sum(pictures_in(each) + len(each.shown) + (each.target is not None) for each in subjects if each.shown)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress("drawing", done, count)

    return [_exhibition(each, trials, tick) for each in subjects]


def _exhibition(subjects: Subjects, trials: Sequence[Keyed], tick: Callable[[], None]) -> Exhibition:
    wall = subjects.wall
    by_row = trials_on(wall.sheet, wall.target, trials)
    curves = curves_of(by_row)
    gallery = gallery_of(subjects, tick) if subjects.shown else None
    scene = scene_of(subjects, tick) if subjects.shown else None
    chart = charts.chart_of(wall, curves, by_row) | {"histogram": histograms_of(subjects)}
    return Exhibition(subjects, gallery, scene, packed(scene.content()) if scene else "", curves, chart)


def _names(content: Content, trials: Sequence[Keyed], shown: Sequence[Exhibition], now: datetime) -> dict[str, Any]:
    """What the template may name."""
    return {
        "title": " + ".join(experiment.name for experiment in content.experiments),
        "made": f"{now:%Y-%m-%d %H:%M} UTC",
        "experiments": content.experiments,
        "complete": len(content.results),
        "states": records.states_grid(content.experiments),
        "sheets": [sheets.shown_sheet(sheet) for sheet in content.sheets],
        "exhibitions": shown,
        "differing": records.differing_settings(content.sheets),
        "shared": records.shared_by_all(content.sheets),
        "definitions": records.definitions_grid(content.results),
        "trials": records.trials_grid(content.sheets, trials),
        "failures": records.failures_grid(content.experiments),
        "machines": records.machines_grid(content.results) if content.results else None,
        "warnings": records.warnings_of(content.results),
        "colours": DISTANCES,
        "most_faces": MOST_FACES,
        "charts": packed_json([exhibition.chart for exhibition in shown]) if shown else "",
        "plotly": packed(_plotly()) if shown else "",
        "asset": _asset,
    }


def _plotly() -> bytes:
    return (resources.files("plotly") / "package_data" / "plotly.min.js").read_bytes()


def _asset(name: str) -> str:
    """A style sheet or a script of this package, which the template puts in as it is."""
    return (resources.files("meshfit.report.html") / "assets" / name).read_text(encoding="utf-8")
