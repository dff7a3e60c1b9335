"""The HTML report: one self-contained page of tables, pictures, 3D views, charts, settings and failures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from meshfit.experiment.status.missing import missing_results
from meshfit.experiment.status.results import scan_with_results
from meshfit.experiment.status.scan import ScannedExperiment
from meshfit.experiment.storage.plan_file import UpChoice, in_planned_order
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.tuning.search_file import Search, read_searches
from meshfit.optional import import_optional
from meshfit.report.figures.colours import DISTANCES, MASK, RESULT
from meshfit.report.html import tables as text
from meshfit.report.html.charts import draw_curves, draw_histogram, draw_search_chart, read_curves, shares_beyond
from meshfit.report.html.environment import template_environment
from meshfit.report.html.images import draw_distances, draw_pictures, draw_views, num_pictures
from meshfit.report.html.target_section import TargetSection, num_left_out, read_sections, short_titles
from meshfit.report.html.viewer import MOST_FACES, compress, viewer_meshes, viewer_scene
from meshfit.report.tables.grouping import distinguish_definitions
from meshfit.report.tables.search import results_of_best, titled_searches
from meshfit.report.tables.style import Style
from meshfit.report.tables.table import Table, build_tables, merge_tables, styled

MOST_TRIALS = 40
"""Largest number of drawn trials; a page with more pictures would be too large to mail."""

Progress = Callable[[str, int, int], None]
"""Called with the current activity, how much of it is done, and its total."""


@dataclass(frozen=True)
class ReportData:
    """The contents of a page, except for meshes and traces.

    Attributes:
        experiments: the status of each experiment.
        results: the complete results, with their `folder`.
        tables: the tables of the results; of experiments that a search made, those of the best points.
        all_tables: the tables of all results.
        searches: the searches, by title.
    """

    experiments: Sequence[ScannedExperiment]
    results: Sequence[Result]
    tables: Sequence[Table]
    all_tables: Sequence[Table]
    searches: Mapping[str, Search]


def require_extra() -> None:
    """Check, before anything is read, that the libraries of the extra `report` are installed.

    Raises:
        ConfigError: one of them is missing.
    """
    for module in ("jinja2", "matplotlib", "pyvista", "PIL.Image"):
        import_optional(module)


def read_report(
    roots: Sequence[Path], metrics: Sequence[str], baseline: str | None, now: datetime, labels: Sequence[str] = ()
) -> ReportData:
    """Read everything in some run directories except meshes and traces.

    Args:
        roots: the run directories.
        metrics: names of metrics; pictures and curves are of the first. Without any, those of the searches if these
            made all experiments, else that of `build_tables`.
        baseline: the scheme that others are compared with; by default the first.
        now: the time, for how long trials have been running.
        labels: names to print, each as NAME=LABEL.

    Raises:
        StoreError: there is no trial in them, or a file cannot be read.
        ConfigError: there is no such metric, or the baseline or something labelled has no results.
        SchemeError: the baseline is not a scheme.
    """
    experiments, complete = scan_with_results(roots, now)
    records = distinguish_definitions(in_planned_order([*complete, *missing_results(experiments, complete)]))
    results = [record for record in records if "missing" not in record]
    searches = read_searches([experiment.folder for experiment in experiments])
    if not metrics and len(searches) == len(experiments):
        objectives = (
            objective for several in searches.values() for search in several for objective in search.objectives
        )
        metrics = list(dict.fromkeys(objective.metric for objective in objectives))
    shown = results_of_best(results) if searches else records
    tables = styled(merge_tables(build_tables(shown, *metrics, baseline=baseline)), Style(), labels)
    every = tables
    if searches and len(shown) < len(results):
        every = [replace(table, style=tables[0].style) for table in merge_tables(build_tables(results, *metrics))]
    return ReportData(experiments, results, tables, every, titled_searches(searches))


def read_page_sections(data: ReportData, progress: Progress, up: UpChoice | None = None) -> list[TargetSection]:
    """Read the meshes of a page; `up` is the axis that points up, by default that of each experiment."""
    reading = partial(progress, "reading meshes")
    return read_sections(data.tables, data.results, MOST_TRIALS, reading, up)


def render_page(data: ReportData, sections: Sequence[TargetSection], now: datetime, progress: Progress) -> str:
    """Return the HTML of the page, from what `read_report` and `read_page_sections` have read.

    Raises:
        ConfigError: a library of the extra `report` is missing.
    """
    count, done = sum(map(_num_drawn, sections)), 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress("drawing", done, count)

    context = {
        "title": " + ".join(experiment.name for experiment in data.experiments),
        "made": f"{now:%Y-%m-%d %H:%M} UTC",
        "experiments": data.experiments,
        "searches": [text.search_table(*titled) | draw_search_chart(*titled) for titled in data.searches.items()],
        "complete": len(data.results),
        "states": text.states_grid(data.experiments),
        "tables": [text.result_table(*titled) for titled in zip(data.tables, short_titles(data.tables), strict=True)],
        "targets": [_draw_section(section, tick) for section in sections],
        "left_out": num_left_out(data.tables, data.results),
        "differing": text.differing_settings(data.tables),
        "shared": text.shared_by_all(data.tables),
        "definitions": text.definitions_grid(data.results),
        "trials": text.trials_grid(data.all_tables, data.results),
        "failures": text.failures_grid(data.experiments),
        "machines": text.machines_grid(data.results) if data.results else None,
        "warnings": text.warnings_of(data.results),
        "colours": DISTANCES,
        "outlines": {"mask": MASK, "result": RESULT},
        "most_faces": MOST_FACES,
        "asset": _asset,
    }
    return str(template_environment().get_template("page.html").render(context))


def _num_drawn(section: TargetSection) -> int:
    """The number of pictures and viewer meshes of a section."""
    return num_pictures(section) + len(section.trials) + (section.target is not None and bool(section.trials))


def _draw_section(section: TargetSection, tick: Callable[[], None]) -> dict[str, Any]:
    """Draw everything that the template shows of a section, calling `tick` after each picture and mesh."""

    def ticked(drawn: Any) -> Any:  # noqa: ANN401  any drawing
        tick()
        return drawn

    curves, problems = read_curves(section.trials_by_row)
    meshes = [ticked(mesh) for mesh in viewer_meshes(section)]
    return {
        "section": section,
        "pictures": [ticked(picture) for picture in draw_pictures(section)],
        "distances": [ticked(picture) for picture in draw_distances(section)],
        "views": [(label, list(map(ticked, pictures))) for label, pictures in draw_views(section)],
        "meshes": meshes,
        "scene": compress(viewer_scene(section, meshes)) if meshes else "",
        "charts": draw_curves(section, curves),
        "num_curves": len(curves),
        "num_trials": sum(map(len, section.trials_by_row.values())),
        "problems": problems,
        "histogram": draw_histogram(section),
        "beyond": shares_beyond(section),
    }


def _asset(name: str) -> str:
    """A style sheet or a script of this package, included by the template as it is."""
    return (resources.files("meshfit.report.html") / "assets" / name).read_text(encoding="utf-8")
