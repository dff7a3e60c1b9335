"""Tables on stdout, and what can be refused of them before anything is run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from meshfit.cli.console import out
from meshfit.cli.options import DEFAULT_METRIC
from meshfit.errors import ConfigError
from meshfit.experiment.store import Result

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial


def show_tables(
    results: Sequence[Result],
    metrics: Sequence[str] | None,
    *,
    baseline: str | None = None,
    format_name: str = "rich",
    planned: bool = False,
) -> None:
    """Print the tables of some results to stdout."""
    from meshfit.report.formats import FORMATS
    from meshfit.report.formats.rich_text import SheetsView
    from meshfit.report.gather import target_key
    from meshfit.report.sheet import arrange
    from meshfit.report.table import build_tables

    # The config's order, which is the order that trials were planned in.
    schemes = dict.fromkeys(result["scheme"] for result in results) if planned else ()
    targets = dict.fromkeys(map(target_key, results)) if planned else ()
    order = {"schemes": list(schemes), "targets": list(targets)}
    wanted = dict.fromkeys(metrics or [DEFAULT_METRIC])
    tables = [table for metric in wanted for table in build_tables(results, metric, baseline=baseline, **order)]
    sheets = arrange(tables, planned=planned)
    if format_name == "rich":
        out.print(SheetsView(sheets))
    else:
        typer.echo(FORMATS[format_name](sheets), nl=False)


def check_display(trials: Sequence["Trial"], metrics: Sequence[str] | None, baseline: str | None) -> None:
    """Refuse, before anything is run, what could not be shown once it has been.

    Raises:
        ConfigError: no such metric, or a baseline that is not among the planned schemes.
        SchemeError: the baseline is not a scheme.
    """
    from meshfit.report.own_schemes import canonical_among, told_apart
    from meshfit.report.table import require_metric
    from meshfit.specs import suggest

    for metric in metrics or ():
        require_metric(metric)
    if baseline is None:
        return
    results = told_apart([{"scheme": trial.scheme, "settings": trial.plain_settings} for trial in trials])
    planned, wanted = dict.fromkeys(result["scheme"] for result in results), canonical_among(results, baseline)
    if wanted not in planned:
        raise ConfigError(f"baseline '{baseline}' is not among the schemes: {suggest(wanted, planned)}")
