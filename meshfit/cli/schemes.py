"""`meshfit schemes`: the table of schemes, or one of them with its masks and what is computed of it."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import AsJson, DefinedIn
from meshfit.subdivision.scheme import SchemeEntry

if TYPE_CHECKING:
    from meshfit.subdivision.analysis.analyse import Analysis
    from meshfit.subdivision.choose import Catalogue
    from meshfit.subdivision.mask_rows import MaskRow
    from meshfit.subdivision.scheme import Scheme

_WIDEST = 24


def schemes(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A scheme, as in interp-loop:alpha=0.5, or a file that defines one, to show its masks.",
            metavar="[SCHEME]",
            autocompletion=completions.schemes,
        ),
    ] = None,
    config: DefinedIn = None,
    analysed: Annotated[
        bool,
        typer.Option(
            "--analyse",
            help="Compute how smooth its limit is, on regular meshes and at valences 3 to 12.",
        ),
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw this analysis: a .png, .pdf or .svg to write.", metavar="FILE"),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List the subdivision schemes, or show or analyse one.

    An analysis computes, from the operators that a scheme makes: polynomials that it reproduces and generates, the
    smoothness of its limit on regular meshes, and eigenvalues and the characteristic map at extraordinary vertices.
    Its figure needs the extra: pip install 'meshfit[report]'.

    Examples:
        meshfit schemes

        meshfit schemes interp-loop:alpha=0.5

        meshfit schemes four-point  # of curves

        meshfit schemes my-scheme.yaml

        meshfit schemes butterfly --analyse --plot butterfly.png
    """
    if analysed or plot is not None:
        _stay_on_one_thread()
    from meshfit.config.load import defined_in
    from meshfit.config.scheme_files import adopted
    from meshfit.errors import ConfigError
    from meshfit.subdivision.catalogue import catalogue_of

    specs, own = adopted([] if name is None else [name], defined_in(config))
    catalogue = catalogue_of(own)
    if specs:
        return _one(specs[0], catalogue, plot, analysed=analysed, as_json=as_json)
    if analysed or plot is not None:
        option = "--analyse" if analysed else "--plot"
        raise ConfigError(f"{option} is for one scheme: name it, as in `meshfit schemes loop {option}`")
    if as_json:
        typer.echo(json.dumps([_plain(key, entry) for key, entry in catalogue.items()], indent=2))
        return 0
    table = Table(box=None, pad_edge=False)
    table.add_column("scheme", style="bold", overflow="fold", min_width=min(_WIDEST, max(map(len, catalogue))))
    for column in ("kind", "continuity", "source"):
        table.add_column(column, overflow="fold")
    domain = None
    for key, entry in catalogue.items():
        if entry.domain != domain:
            domain = entry.domain
            table.add_row(f"[not bold]on {domain}[/]")
        table.add_row(_with_parameters(key, entry), entry.kind, entry.continuity, entry.source)
    out.print(table)
    out.print("\nParameters follow a colon: [bold]interp-loop:alpha=0.5[/]. Masks: [bold]meshfit schemes NAME[/].")
    return 0


def _one(text: str, catalogue: "Catalogue", plot: Path | None, *, analysed: bool, as_json: bool) -> int:
    from meshfit.cli.analysis_view import plain_analysis, print_analysis, print_verdict
    from meshfit.subdivision.choose import canonical, entry_of, scheme_of, spec_of
    from meshfit.subdivision.describe import describe

    scheme = scheme_of(text, catalogue)
    name, title = spec_of(text).name, canonical(text, catalogue)
    entry = entry_of(name, catalogue)
    analysis = _analysis(scheme, title, plot) if analysed or plot is not None else None
    rows = list(describe(scheme))
    if as_json:
        found = _plain(name, entry) | {"masks": [{"where": row.where, "weights": row.weights} for row in rows]}
        typer.echo(json.dumps(found | ({"analysis": plain_analysis(analysis)} if analysis else {}), indent=2))
        return 0
    if analysis is not None:
        print_verdict(analysis)
    _print_masks(title, entry, scheme, rows)
    if analysis is not None and analysed:
        print_analysis(analysis)
    if plot is not None:
        out.print(f"wrote {plot}", soft_wrap=True, markup=False)
    return 0


def _analysis(scheme: "Scheme", title: str, plot: Path | None) -> "Analysis":
    from meshfit.subdivision.analysis.analyse import analyse

    if plot is None:
        return analyse(scheme)
    from meshfit.report.analysis_plate import write_analysis
    from meshfit.report.typeset import require_suffix

    require_suffix(plot)
    analysis = analyse(scheme)
    write_analysis(scheme, analysis, title, plot)
    return analysis


def _print_masks(title: str, entry: SchemeEntry, scheme: "Scheme", rows: "list[MaskRow]") -> None:
    out.print(f"[bold]{escape(title)}[/]  {entry.title}, {entry.kind}")
    facts = Table(box=None, pad_edge=False, show_header=False)
    facts.add_column(style="bold")
    facts.add_column()
    for key, value in (
        ("refines", entry.domain),
        ("split", scheme.split.value),
        ("continuity", entry.continuity),
        ("source", entry.source),
    ):
        facts.add_row(key, value)
    for key, parameter in entry.parameters.items():
        allowed = (
            " or ".join(map(str, parameter.allowed))
            if isinstance(parameter.default, str)
            else "{} … {}".format(*parameter.allowed)
        )
        facts.add_row(key, f"{parameter.meaning} ({allowed}; default {parameter.default})")
    for row in rows:
        facts.add_row(row.where, row.weights)
    out.print(facts)


def _stay_on_one_thread() -> None:
    """Before numpy is imported: an analysis has small matrices, for which threads wait longer than they work."""
    from meshfit.experiment.interrupts import ONE_THREAD

    for name, count in ONE_THREAD.items():
        os.environ.setdefault(name, count)


def _with_parameters(name: str, entry: SchemeEntry) -> str:
    return name + (f"\n  [not bold]:{', '.join(entry.parameters)}[/]" if entry.parameters else "")


def _plain(name: str, entry: SchemeEntry) -> dict[str, object]:
    parameters = {
        key: {"default": parameter.default, "allowed": list(parameter.allowed), "meaning": parameter.meaning}
        for key, parameter in entry.parameters.items()
    }
    facts = {"name": name, "title": entry.title, "domain": entry.domain, "kind": entry.kind}
    return facts | {"continuity": entry.continuity, "source": entry.source, "parameters": parameters}
