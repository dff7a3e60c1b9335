"""`meshfit figure`: a figure of some runs for a paper, with its caption."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import OUTPUT, Labels, Metric, UpAxis, say_turned, takes_run_dirs
from meshfit.specs import listed


@takes_run_dirs
def figure(
    runs: list[Path],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure to write: .pdf, .svg or .png.", metavar="FILE")
    ],
    metric: Metric = None,
    targets: Annotated[
        str | None,
        typer.Option(
            "--targets",
            help="Only these targets, in this order, separated by commas.",
            metavar="A,B",
            autocompletion=completions.listed_targets,
        ),
    ] = None,
    schemes: Annotated[
        str | None,
        typer.Option("--schemes", help="Only these schemes, in this order, separated by commas.", metavar="A,B"),
    ] = None,
    width: Annotated[
        Literal["single", "double"],
        typer.Option(
            "--width",
            help="`single` for one column of a paper, 3.33 inches; `double` for both, 7 inches.",
            metavar="WIDTH",
            rich_help_panel=OUTPUT,
        ),
    ] = "double",
    columns: Annotated[
        int | None,
        typer.Option(
            "--columns",
            min=1,
            help="Targets side by side.",
            show_default="as many as make pictures largest",
            metavar="N",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    sources: Annotated[
        Literal["none", "once", "all"],
        typer.Option(
            "--sources",
            help="Show the sources `once`, with the first target that starts from them, with `all` targets, or `none`.",
            metavar="SOURCES",
            rich_help_panel=OUTPUT,
        ),
    ] = "once",
    labels: Labels = None,
    up: UpAxis = None,
) -> int:
    """Draw a figure of some runs for a paper, with its caption.

    It shows target, sources and results, and the distances from the results to the target. Each target and scheme is
    represented by the trial with the median value of the metric over the seeds. The caption is written next to the
    figure: as plain text, .txt, and as a LaTeX figure environment, .tex. The figure fills the width of a page or of a
    column, with text that is legible at that size.
    Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit figure runs/table1 -o figure.pdf
        meshfit figure runs/accurate -o cow.svg --targets cow --metric distance.mean
        meshfit figure runs/table1 -o figure.pdf --width single --label interp-loop="Interp. Loop"
    """
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.figures.figure import (
        FigureStyle,
        details,
        latex_figure,
        plain_caption,
        read_figure_targets,
        turned_targets,
        write_figure,
    )
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.representative_trial import select_trials
    from meshfit.report.tables.grouping import distinguish_definitions
    from meshfit.report.tables.style import parse_labels
    from meshfit.report.tables.table import default_metric

    require_suffix(output)
    results = distinguish_definitions(in_planned_order(read_results(runs)))
    metric = metric or default_metric(results)
    selection = select_trials(results, metric, targets=listed(targets or ""), schemes=listed(schemes or ""))
    known = [name for group in selection for name in (group.target, *(trial.scheme for trial in group.trials))]
    style = FigureStyle(width, columns, sources, parse_labels(labels or (), [*known, metric]))
    figure_targets = read_figure_targets(selection, up)
    write_figure(figure_targets, output, metric, style)
    written = [output, output.with_suffix(".txt"), output.with_suffix(".tex")]
    about = "\n".join(details(figure_targets, metric, style))
    write_atomically(written[1], f"{plain_caption(figure_targets, metric, style)}\n{about}\n")
    write_atomically(written[2], latex_figure(figure_targets, metric, output.name, style))
    say_turned(turned_targets(figure_targets))
    out.print(f"wrote {', '.join(map(str, written))}", soft_wrap=True, markup=False)
    return 0
