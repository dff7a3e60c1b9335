"""`meshfit chart`: a chart of the results of some runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshfit.cli.console import out
from meshfit.cli.options import Labels, Metric, takes_run_dirs

if TYPE_CHECKING:
    from meshfit.experiment.tuning.search_file import Search
    from meshfit.report.tables.table import Table


@takes_run_dirs
def chart(
    runs: list[Path],
    output: Annotated[Path, typer.Option("--output", "-o", help="Chart to write: .pdf, .svg or .png.", metavar="FILE")],
    metric: Metric = None,
    labels: Labels = None,
) -> int:
    """Draw the results of some runs as a chart, and print the means.

    Schemes are grouped by kind, with one mark per target: the mean over its seeds, with its 95 % interval. Bars are
    geometric means over the targets. A sweep gives one panel per setting. Of a search by `meshfit tune`, the chart
    shows the best value so far or the Pareto front, and the values by each setting; the best settings are printed.
    Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit chart runs/zoo -o zoo.pdf
        meshfit chart runs/zoo -o mean.png --metric distance.mean
        meshfit chart runs/my-tune -o search.png
        meshfit chart runs/zoo -o zoo.pdf --label interp-loop="Interp. Loop"
    """
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.report.figures.chart import write_chart
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.search import searches_to_draw
    from meshfit.report.tables.style import Style
    from meshfit.report.tables.table import build_tables, styled

    require_suffix(output)
    results = read_results(runs)
    if searches := searches_to_draw(results, metric):
        _draw_searches(searches, output, labels or ())
        return 0
    tables = build_tables(distinguish_definitions(in_planned_order(results)), *filter(None, [metric]))
    tables = styled(tables, Style(), labels or ())
    write_chart(tables, output)
    _print_means(tables)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0


def _draw_searches(searches: "dict[str, Search]", output: Path, labels: "Sequence[str]") -> None:
    """Draw searches, and print their best settings."""
    from meshfit.cli.tune import print_best
    from meshfit.config.sweeps import short_names
    from meshfit.report.figures.search import write_search_chart
    from meshfit.report.tables.style import parse_labels

    metrics = [objective.metric for search in searches.values() for objective in search.objectives]
    settings = {key: name for search in searches.values() for key, name in short_names(list(search.ranges)).items()}
    given = parse_labels(labels, [*metrics, *settings, *settings.values()])
    keys = {name: key for key, name in settings.items()}
    write_search_chart(searches, output, {keys.get(name, name): label for name, label in given.items()})
    for search in searches.values():
        print_best(search)
        out.print()
    out.print(f"wrote {output}", soft_wrap=True, markup=False)


def _print_means(tables: "Sequence[Table]") -> None:
    """Print the geometric means that the bars show."""
    from rich.table import Table as Grid
    from rich.text import Text

    from meshfit.report.figures.chart import geometric_means

    columns = [
        (table.style.label(table.variations[0].variant) or table.title, geometric_means(table)) for table in tables
    ]
    schemes = list(dict.fromkeys(scheme for _, means in columns for scheme in means))
    if not schemes:
        return
    grid = Grid(box=None, pad_edge=False)
    grid.add_column("scheme")
    for name, _ in columns:
        grid.add_column(Text(name), justify="right")
    for scheme in schemes:
        cells = (f"{means[scheme]:.4g}" if scheme in means else "" for _, means in columns)
        grid.add_row(Text(tables[0].scheme_title(scheme)), *cells)
    title = tables[0].metric_title(tables[0].metrics[0])
    out.print(f"{title}: geometric means over the targets", markup=False)
    out.print(grid)
