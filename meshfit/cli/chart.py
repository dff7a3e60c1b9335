"""`meshfit chart`: the numbers of some runs as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import DEFAULT_METRIC, RunDirs


def chart(
    runs: RunDirs,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The chart to write: .pdf, .svg or .png.", metavar="FILE")
    ],
    metric: Annotated[
        str,
        typer.Option("--metric", help="What is drawn.", metavar="NAME", autocompletion=completions.metrics),
    ] = DEFAULT_METRIC,
) -> int:
    """Draw the numbers of some runs as a chart.

    Schemes stand under their kind, with a mark for each target: the mean over its seeds. Bars are geometric means over
    the targets; there is a panel for each setting of a sweep. Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit chart runs/zoo -o zoo.pdf

        meshfit chart runs/zoo -o mean.png --metric distance.mean
    """
    from meshfit.experiment.plan_file import with_planned_names
    from meshfit.experiment.store import read_results
    from meshfit.report.chart import write_chart
    from meshfit.report.own_schemes import told_apart
    from meshfit.report.table import build_tables
    from meshfit.report.typeset import require_suffix

    require_suffix(output)
    write_chart(build_tables(told_apart(with_planned_names(read_results(runs))), metric), output)
    out.print(f"wrote {output}", soft_wrap=True, markup=False)
    return 0
