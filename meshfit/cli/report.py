"""`meshfit report`: one self-contained HTML page of some runs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.cli.options import Baseline, Labels, Metrics, Partial, Quiet, UpAxis, say_turned, takes_run_dirs
from meshfit.cli.progress import show_parts
from meshfit.cli.table import exit_code_of

_OUTPUT = "Folder to write index.html into, or a file that ends in .html."


@takes_run_dirs
def report(
    runs: list[Path],
    output: Annotated[Path, typer.Option("--output", "-o", help=_OUTPUT, metavar="DIR|FILE")],
    metrics: Metrics = None,
    baseline: Baseline = None,
    labels: Labels = None,
    up: UpAxis = None,
    partial: Partial = False,
    quiet: Quiet = False,
) -> int:
    """Write some runs as one self-contained HTML page.

    The page has tables, pictures, 3D views, curves, settings, failures and versions. It is a single file that
    loads nothing from the network and can be mailed. Trials of the latest plan that have no result make the exit
    code 1. Requires the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit report runs/table1 -o report
        meshfit report runs -o table1.html --metric distance.mean
        meshfit report runs/table1 -o report --label interp-loop="Interp. Loop"
    """
    from meshfit.experiment.storage.run_directory import make_folder, write_atomically
    from meshfit.report.html.page import read_page_sections, read_report, render_page, require_extra
    from meshfit.units import size_text

    require_extra()
    now = datetime.now(UTC)
    with show_parts(quiet=quiet) as progress:
        progress("reading results", 0, 1)
        data = read_report(runs, metrics or [], baseline, now, labels or ())
        page = output if output.suffix.lower() in (".html", ".htm") and not output.is_dir() else output / "index.html"
        make_folder(page.parent)
        sections = read_page_sections(data, progress, up)
        text = render_page(data, sections, now, progress).encode()
    write_atomically(page, text)
    say_turned([section.title for section in sections if section.is_turned])
    out.print(f"wrote {page}: {size_text(len(text))}", soft_wrap=True, markup=False)
    return 0 if partial else exit_code_of(data.tables)
