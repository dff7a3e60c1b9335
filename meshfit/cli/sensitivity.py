"""`meshfit sensitivity`: show which settings move a metric, and by how much."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from meshfit.cli.console import out
from meshfit.cli.options import OUTPUT, AnalysedMetric, Baseline, RunDirs

if TYPE_CHECKING:
    from meshfit.report.tables.sensitivity import Sensitivity
    from meshfit.sensitivity import Analysis, Effect, Estimate

_WIDTH_WITH_ENDS = 100


def sensitivity(
    runs: RunDirs,
    metric: AnalysedMetric = None,
    baseline: Baseline = None,
    format: Annotated[  # noqa: A002  the name of the option
        Literal["rich", "csv", "json"],
        typer.Option(
            "--format",
            "-f",
            help="`rich` for a terminal, `csv` or `json` for programs.",
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
        meshfit sensitivity runs/my -f csv > sensitivity.csv
    """
    from meshfit.config.sweeps import short_names
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.measuring.metrics import DEFAULT_METRIC
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.sensitivity import write_sensitivity_chart
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.sensitivity import read_sensitivity, sensitivity_csv, sensitivity_json, shortened

    if output is not None:
        require_suffix(output)
    results = distinguish_definitions(in_planned_order(read_results(runs)))
    found = read_sensitivity(results, metric or DEFAULT_METRIC, baseline)
    names = {effect.factor.name for analysis in found.groups.values() for effect in analysis.effects}
    keys = short_names(sorted({key for name in names for key in name.split(" = ")}))
    short = shortened(found, {name: " = ".join(keys[key] for key in name.split(" = ")) for name in names})
    if format == "csv":
        typer.echo(sensitivity_csv(found), nl=False)
    elif format == "json":
        typer.echo(sensitivity_json(found), nl=False)
    else:
        _print(short)
    if output is not None:
        write_sensitivity_chart(short, output)
        if format == "rich":
            out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0


def _print(found: "Sensitivity") -> None:
    from rich.table import Table
    from rich.text import Text

    from meshfit.sensitivity import LEAST_Q2

    of = f"{found.metric}, each scheme against {found.compared}" if found.compared else found.metric
    out.print(f"{of}{' (logarithm)' if found.is_log else ''}", markup=False, soft_wrap=True)
    for name, analysis in found.groups.items():
        q2 = f", Q² {analysis.q2:.2f}" if analysis.q2 is not None and not analysis.why_not else ""
        out.print(f"\n{name}: {analysis.points} points{q2}", markup=False, soft_wrap=True)
        grid = Table(box=None, pad_edge=False)
        ends = ["from", "to"] if analysis.why_not or out.width >= _WIDTH_WITH_ENDS else []
        shares = [] if analysis.why_not else ["first-order", "total"]
        for heading in ("setting", "rank", *ends, "change", *shares):
            is_name = heading == "setting"
            grid.add_column(heading, justify="left" if is_name else "right", no_wrap=not is_name)
        for effect in analysis.effects:
            grid.add_row(*map(Text, _cells(found, analysis, effect, ends=bool(ends))))
        out.print(grid)
        for line in _lines(analysis):
            out.print(line, markup=False, soft_wrap=True)
    out.print(
        "\nrank: Spearman's ρ, or η² of ranks for categories; * significant at 5 %. first-order, total: shares of the "
        f"variance, by a Gaussian process with Q² of {LEAST_Q2} or more. [95 % intervals]",
        markup=False,
        soft_wrap=True,
    )
    for note in found.notes:
        out.print(note, markup=False, soft_wrap=True)


def _cells(found: "Sensitivity", analysis: "Analysis", effect: "Effect", *, ends: bool) -> list[str]:
    symbol = "η²" if effect.factor.categories else "ρ"
    rank = f"{symbol} {_interval(effect.rank)}{'*' if effect.moves else ' '}"
    cells = [effect.factor.name, rank, *(effect.ends if ends else ()), found.change_text(effect)]
    return cells if analysis.why_not else [*cells, _interval(effect.first), _interval(effect.total)]


def _interval(estimate: "Estimate | None") -> str:
    if estimate is None:
        return ""
    return f"{estimate.value:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]".replace("-", "−")


def _lines(analysis: "Analysis") -> Iterator[str]:
    if analysis.why_not:
        yield f"No Sobol' indices: {analysis.why_not}."
    if analysis.interactions:
        pairs = (f"{' × '.join(pair.names)} {_interval(pair.share)}" for pair in analysis.interactions[:5])
        yield f"Together: {'; '.join(pairs)}"
    for first, second, value in analysis.confounded:
        yield f"{first} and {second} vary together (ρ {value:.2f}): their effects cannot be told apart.".replace(
            "-", "−"
        )
