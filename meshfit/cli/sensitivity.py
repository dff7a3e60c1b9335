"""`meshfit sensitivity`: show which settings move a metric, and by how much."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli.console import out
from meshfit.cli.options import OUTPUT, AnalysedMetric, Baseline, Quiet, takes_run_dirs
from meshfit.cli.progress import show_parts

if TYPE_CHECKING:
    from meshfit.report.tables.sensitivity import Sensitivity

_WIDTH_WITH_ENDS = 100


@takes_run_dirs
def sensitivity(
    runs: list[Path],
    metric: AnalysedMetric = None,
    baseline: Baseline = None,
    format: Annotated[  # noqa: A002  the name of the option
        Literal["rich", "md", "csv", "json"],
        typer.Option(
            "--format",
            "-f",
            help="`rich` for a terminal, `md` for Markdown, `csv` or `json` for programs.",
            metavar="FORMAT",
            rich_help_panel=OUTPUT,
        ),
    ] = "rich",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Chart to write: .pdf, .svg or .png.",
            metavar="FILE",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Show which settings move a metric, and by how much.

    The runs are those of a sweep, best a sampled one. Each setting has its rank correlation with the metric (for
    categories, the share of the variance of ranks between them), the change of the metric from the low to the high
    third of its values, and Sobol' indices: the share of the variance that the setting explains alone (first-order)
    and with all its interactions (total). These come from a Gaussian process fitted to the runs, and are shown only
    if it predicts runs that it has not seen. With --baseline, the metric is that of each scheme against this one.
    Intervals are 95 %. Requires the extra: pip install 'meshfit[tune]'.

    Examples:
        meshfit sensitivity runs/my --metric hausdorff.symmetric
        meshfit sensitivity runs/my --metric distance.mean -o sensitivity.png
        meshfit sensitivity runs/my --baseline loop
        meshfit sensitivity runs/my -f md > sensitivity.md
        meshfit sensitivity runs/my -f csv > sensitivity.csv
    """
    from meshfit.config.sweeps import short_names
    from meshfit.experiment.status.scan import scan_experiments
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.measuring.metrics import DEFAULT_METRIC, require_metric
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.sensitivity import MOST_PANELS, write_sensitivity_chart
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.sensitivity import (
        absent_trials,
        read_sensitivity,
        sensitivity_csv,
        sensitivity_json,
        sensitivity_markdown,
        shortened,
    )

    if output is not None:
        require_suffix(output)
    require_metric(metric or DEFAULT_METRIC)
    results = distinguish_definitions(in_planned_order(read_results(runs)))
    absent = absent_trials(scan_experiments(runs, datetime.now(UTC)))
    with show_parts(quiet=quiet) as progress:
        found = read_sensitivity(results, metric or DEFAULT_METRIC, baseline, absent, progress)
    names = {effect.factor.name for analysis in found.groups.values() for effect in analysis.effects}
    keys = short_names(sorted({key for name in names for key in name.split(" = ")}))
    short = shortened(found, {name: " = ".join(keys[key] for key in name.split(" = ")) for name in names})
    if format == "md":
        typer.echo(sensitivity_markdown(short), nl=False)
    elif format == "csv":
        typer.echo(sensitivity_csv(found), nl=False)
    elif format == "json":
        typer.echo(sensitivity_json(found), nl=False)
    else:
        _print(short)
    if output is not None:
        write_sensitivity_chart(short, output)
        if format == "rich":
            if (more := len(found.groups) - MOST_PANELS) > 0:
                out.print(f"the chart shows {MOST_PANELS} of {more + MOST_PANELS} panels; -f csv has all")
            out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0


def _print(found: "Sensitivity") -> None:
    from rich.table import Table
    from rich.text import Text

    from meshfit.report.tables.sensitivity import (
        analysis_lines,
        effect_cells,
        effect_heads,
        final_lines,
        group_title,
        sensitivity_title,
    )

    out.print(sensitivity_title(found), markup=False, soft_wrap=True)
    for name, analysis in found.groups.items():
        out.print(f"\n{group_title(name, analysis)}", markup=False, soft_wrap=True)
        grid = Table(box=None, pad_edge=False)
        ends = bool(analysis.why_not) or out.width >= _WIDTH_WITH_ENDS
        for heading in effect_heads(analysis, ends=ends):
            is_name = heading == "setting"
            grid.add_column(heading, justify="left" if is_name else "right", no_wrap=not is_name)
        for effect in analysis.effects:
            grid.add_row(*map(Text, effect_cells(found, analysis, effect, ends=ends)))
        out.print(grid)
        for line in analysis_lines(analysis):
            out.print(line, markup=False, soft_wrap=True)
    out.print()
    for line in final_lines(found):
        out.print(line, markup=False, soft_wrap=True)
