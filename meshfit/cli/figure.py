"""`meshfit figure`: a figure of some runs for a paper, with its caption."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import Metric, RunDirs
from meshfit.measuring.metrics import DEFAULT_METRIC
from meshfit.specs import listed


def figure(
    runs: RunDirs,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure to write: .pdf, .svg or .png.", metavar="FILE")
    ],
    metric: Metric = DEFAULT_METRIC,
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
) -> int:
    """Draw a figure of some runs for a paper, with its caption.

    It shows target, sources and results, and the distances from the results to the target. Each target and scheme is
    represented by the trial with the median value of the metric over the seeds. The caption is written next to the
    figure: as plain text, .txt, and as a LaTeX figure environment, .tex.
    Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit figure runs/table1 -o figure.pdf
        meshfit figure runs/accurate -o cow.svg --targets cow --metric distance.mean
    """
    from meshfit.experiment.storage.plan_file import in_planned_order
    from meshfit.experiment.storage.result import read_results
    from meshfit.experiment.storage.run_directory import write_atomically
    from meshfit.report.figures.figure import latex_figure, plain_caption, read_figure_targets, write_figure
    from meshfit.report.figures.layout import require_suffix
    from meshfit.report.figures.representative_trial import select_trials
    from meshfit.report.tables.grouping import distinguish_definitions

    require_suffix(output)
    results = distinguish_definitions(in_planned_order(read_results(runs)))
    selection = select_trials(results, metric, targets=listed(targets or ""), schemes=listed(schemes or ""))
    figure_targets = read_figure_targets(selection)
    write_figure(figure_targets, output, metric)
    written = [output, output.with_suffix(".txt"), output.with_suffix(".tex")]
    write_atomically(written[1], plain_caption(figure_targets, metric))
    write_atomically(written[2], latex_figure(figure_targets, metric, output.name))
    out.print(f"wrote {', '.join(map(str, written))}", soft_wrap=True, markup=False)
    return 0
