"""`meshfit report`: one HTML page of some runs, to be opened anywhere and mailed."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.cli.options import Baseline, Metrics, Quiet, RunDirs
from meshfit.cli.progress import show_parts
from meshfit.measuring.metrics import DEFAULT_METRIC


def report(
    runs: RunDirs,
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write index.html into.", metavar="DIR")],
    metrics: Metrics = None,
    baseline: Baseline = None,
    quiet: Quiet = False,
) -> int:
    """Write a page of some runs that can be mailed.

    It has tables, pictures, 3D views, curves, settings, failures and versions, in a single file, index.html, that needs
    no network. Needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit report runs/table1 -o report

        meshfit report runs -o report --metric distance.mean
    """
    from meshfit.experiment.storage.run_directory import make_folder, write_atomically
    from meshfit.report.html.page import read_report, render_page, require_extra
    from meshfit.units import size_text

    require_extra()
    now = datetime.now(UTC)
    with show_parts(quiet=quiet) as progress:
        progress("reading results", 0, 1)
        data = read_report(runs, metrics or [DEFAULT_METRIC], baseline, now)
        make_folder(output)
        text = render_page(data, now, progress).encode()
    write_atomically(output / "index.html", text)
    out.print(f"wrote {output / 'index.html'}: {size_text(len(text))}", soft_wrap=True, markup=False)
    return 0
