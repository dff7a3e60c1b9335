"""`meshfit report`: one HTML page of some runs, to be opened anywhere and mailed."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from meshfit.cli.console import err, out
from meshfit.cli.options import DEFAULT_METRIC, Baseline, Metrics, Quiet, RunDirs

_LINES = 4


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
    from meshfit.report.html.page import page_text, read_content, require_extra
    from meshfit.units import size_text

    require_extra()
    now = datetime.now(UTC)
    with _shown_progress(quiet=quiet) as progress:
        progress("reading results", 0, 1)
        content = read_content(runs, metrics or [DEFAULT_METRIC], baseline, now)
        make_folder(output)
        text = page_text(content, now, progress).encode()
    write_atomically(output / "index.html", text)
    out.print(f"wrote {output / 'index.html'}: {size_text(len(text))}", soft_wrap=True, markup=False)
    return 0


@contextmanager
def _shown_progress(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar on a terminal; elsewhere a line at a time, and only a few of them."""
    if quiet:
        yield lambda *_: None
    elif err.is_terminal:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
        with Progress(*columns, console=err, transient=True) as bars:
            task = bars.add_task("", total=None)
            yield lambda what, done, total: bars.update(task, description=what, completed=done, total=total)
    else:
        yield _Lines().say


class _Lines:
    """Plain lines: at the beginning of each part of the work, and some on the way."""

    def __init__(self) -> None:
        self._said = ("", 0)

    def say(self, what: str, done: int, total: int) -> None:
        quarter = done * _LINES // max(total, 1)
        if (what, quarter) != self._said:
            self._said = what, quarter
            err.print(f"{what}: {done} of {total}", soft_wrap=True, markup=False)
